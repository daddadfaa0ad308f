"""Kept results of paths through single grains, in the folder of compiled kernels.

The name of a file is a digest of all that determines its content: the grains, the optical constants
at the wavelengths, the number of rays and the sources of the package.  The file begins with a
checksum of this digest and of the numbers, so that a damaged or foreign one is not used.
"""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path

import numpy as np

from splits.core.atomic import atomic_write
from splits.core.provenance import hash_physics_sources
from splits.discrete_ordinates.grains import GrainTracing, TracedGrains
from splits.kernels.compiler.cache_folder import find_cache_folder, warn_once
from splits.media.medium import GranularMedium

GRAINS_SUFFIX = ".grains"
MAX_CACHE_BYTES = 2**29
"""Size of all files above which the ones that are unused for the longest time are removed."""
_CHECKSUM_BYTES = 32


def load_grains(
    layer: GranularMedium, wavelength_nm: np.ndarray, rays: int, threads: int
) -> TracedGrains:
    """Return the moments of the grains of a layer, from the cache or from paths.

    Parameters
    ----------
    layer : GranularMedium
        Its depth, density and ground have no effect.
    wavelength_nm : float, shape (wavelengths,)
    rays : int
        See `splits.discrete_ordinates.grains.choose_rays`.
    threads : int
    """
    tracing = GrainTracing.from_layer(layer, wavelength_nm, rays)
    digest = compute_grains_digest(tracing)
    folder = find_cache_folder()
    if folder is None:
        return tracing.trace(digest, threads)
    path = folder / f"{digest}{GRAINS_SUFFIX}"
    grains = _read_grains(path, tracing, digest)
    if grains is None:
        grains = tracing.trace(digest, threads)
        _write_grains(path, grains)
    return grains


def compute_grains_digest(tracing: GrainTracing) -> str:
    """Return the SHA-256 (first 32 hex digits) of all that determines moments of grains."""
    scene, nodes = tracing.scene, tracing.nodes
    digest = hashlib.sha256(
        f"{hash_physics_sources()} {tracing.rays} {scene.rules} {type(scene.types)}".encode()
    )
    arrays = (
        *scene.types, scene.layers.type_cdf, scene.layers.wet_fraction, *tracing.constants,
        nodes.index, nodes.weights, nodes.interpolation_bound,
    )  # fmt: skip
    for array in arrays:
        digest.update(f"{array.dtype} {array.shape} ".encode() + array.tobytes())
    return digest.hexdigest()[:32]


def _read_grains(path: Path, tracing: GrainTracing, digest: str) -> TracedGrains | None:
    """Return the moments in a file, None if there is none or if it is not intact."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        warn_once(f"{path}: grains are traced again ({error.strerror or error})")
        return None
    checksum, numbers = content[:_CHECKSUM_BYTES], content[_CHECKSUM_BYTES:]
    if checksum != _compute_checksum(digest, numbers):
        warn_once(f"{path}: damaged, grains are traced again")
        return None
    with suppress(OSError):
        os.utime(path)
    values, shapes = np.frombuffer(numbers), tracing.compute_shapes()
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]
    parts = np.split(values, ends)
    moments, displacements, bound = (
        part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)
    )
    return TracedGrains(moments, displacements, bound, digest)


def _write_grains(path: Path, grains: TracedGrains) -> None:
    """Write moments to a file; without space or permission they are not kept."""
    numbers = np.concatenate([values.ravel() for values in grains[:3]]).tobytes()
    try:
        with atomic_write(path) as temporary:
            temporary.write_bytes(_compute_checksum(grains.digest, numbers) + numbers)
        _limit_size(path)
    except OSError as error:
        warn_once(f"{path}: grains are not kept for the next call ({error.strerror or error})")


def _compute_checksum(digest: str, numbers: bytes) -> bytes:
    return hashlib.sha256(digest.encode() + numbers).digest()


def _limit_size(newest: Path) -> None:
    """Remove the files that are unused for the longest time, above the size of all files."""
    ages = []
    for path in newest.parent.glob(f"*{GRAINS_SUFFIX}"):
        with suppress(OSError):
            status = path.stat()
            ages.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in ages)
    for _, size, path in sorted(ages):
        if total <= MAX_CACHE_BYTES or path == newest:
            break
        path.unlink(missing_ok=True)
        total -= size
