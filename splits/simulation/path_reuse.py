"""Detection of media that share paths: of the same scene, except for the scale of its lengths.

The refractive indices of grains and pores, impurities, and the albedo of a reflecting ground may
differ, because a scene does not contain them.  Particles and their matrix must be the same.

Where all lengths of a medium are s times those of another (grains, the distances between them, the
depths of boundaries), light takes the same paths in both, s times as long.  A semi-infinite medium
has no depth that fixes the scale.  The scenes themselves are compared, so that sets of media that
share paths are found whichever parameters differ.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.kernels.base.scene import NO_GROUND
from splits.media.medium import Medium
from splits.simulation.scene import (
    build_scene,
    compute_material_constants,
    compute_optical_constants,
)
from splits.simulation.spectral_rows import PathSharingMedia

MAX_SHARED_ROWS = 200_000
"""Largest number of rows (wavelengths of different media) of one tally: this limits its memory."""
_COMPARED_BITS = 36
"""Binary digits to which numbers of two scenes must agree."""


class MediaGroup(NamedTuple):
    """Media that share paths, by their positions among all media.

    Attributes
    ----------
    path_sharing : PathSharingMedia
        Each distinct medium once.
    positions : int, shape (members,)
    media_indices : int, shape (members,)
        Of the media in `path_sharing`.
    """

    path_sharing: PathSharingMedia
    positions: np.ndarray
    media_indices: np.ndarray


def group_by_shared_paths(
    media: Sequence[Medium], wavelength_nm: np.ndarray, max_rows: int = MAX_SHARED_ROWS
) -> list[MediaGroup]:
    """Return media in sets that share paths, each in order of size.

    Parameters
    ----------
    media : sequence of Medium
    wavelength_nm : float, shape (wavelengths,)
    max_rows : int
        Largest number of rows of one tally.
    """
    by_signature: dict[bytes, list[tuple[float, int]]] = {}
    for position, medium in enumerate(media):
        key, unit = compute_path_signature(medium)
        by_signature.setdefault(key, []).append((unit, position))
    max_media = max(1, max_rows // wavelength_nm.size)
    groups = []
    for members in by_signature.values():
        # Positions of each distinct medium, in order of size.
        positions: dict[tuple[float, bytes], list[int]] = {}
        for unit, position in sorted(members):
            absorption_key = compute_absorption_signature(media[position], wavelength_nm)
            positions.setdefault((unit, absorption_key), []).append(position)
        distinct = list(positions.items())
        for first in range(0, len(distinct), max_media):
            part = distinct[first : first + max_media]
            smallest = part[0][0][0]
            path_sharing = PathSharingMedia(
                tuple(media[one[0]] for _, one in part),
                np.array([unit / smallest for (unit, _), _ in part]),
            )
            media_indices = [number for number, (_, one) in enumerate(part) for _ in one]
            all_positions = [position for _, one in part for position in one]
            groups.append(
                MediaGroup(path_sharing, np.array(all_positions), np.array(media_indices))
            )
    return groups


def check_path_sharing(media: Mapping[str, Medium]) -> None:
    """Check that media share paths and have the same size.

    Raises
    ------
    ValueError
        Names the first medium that cannot share the paths of the first one.
    """
    (first, base), *others = media.items()
    signature, unit = compute_path_signature(base)
    for name, medium in others:
        other_signature, other_unit = compute_path_signature(medium)
        if other_signature != signature or not math.isclose(other_unit, unit):
            raise invalid(
                f"medium[{name!r}]", medium.kind,
                f"a medium that shares the paths of medium[{first!r}]",
                "only refractive indices of grains and pores, impurities, and the albedo of a "
                "reflecting ground may differ",
            )  # fmt: skip


def compute_absorption_signature(medium: Medium, wavelength_nm: np.ndarray) -> bytes:
    """Return a hash of the optical constants of a medium and of a ground at finite depth."""
    has_ground = not medium.is_semi_infinite
    compute = compute_optical_constants if has_ground else compute_material_constants
    constants = compute(medium, wavelength_nm)
    return hashlib.sha256(constants.indices.tobytes() + constants.absorption.tobytes()).digest()


def compute_path_signature(medium: Medium) -> tuple[bytes, float]:
    """Return a hash common to media that share paths, and the length unit of this one (m).

    It covers every field of the scene, with lengths in that unit, except the ground below an
    infinite layer: no light reaches it.

    Parameters
    ----------
    medium : Medium
    """
    scene = build_scene(medium, 0.0, False)
    layers, types = scene.layers, scene.types
    # A rough surface has a length scale of its own.
    unit = float(1.0 / layers.collision_coefficient[0]) if scene.height_fields is None else 1.0
    scaled_scene = scene._replace(
        layers=layers._replace(
            boundaries=layers.boundaries / unit,
            collision_coefficient=unit * layers.collision_coefficient,
        ),
        types=types and types._replace(inverse_semi_major=unit * types.inverse_semi_major),
        ground_column=NO_GROUND if medium.is_semi_infinite else scene.ground_column,
    )
    # The matrix of particles has one index at all wavelengths and appears in no interface.
    matrices = [layer.refractive_index for layer in medium.scene_layers if not layer.has_grains]
    interfaces = zip(*medium.list_interfaces(), strict=True)
    parts = (type(medium).__name__, len(medium.list_materials()), scaled_scene)
    encoded = map(_encode, (*parts, matrices, *interfaces))
    return hashlib.sha256(b"".join(itertools.chain.from_iterable(encoded))).digest(), unit


def _encode(value: Any) -> Iterator[bytes]:
    """Yield the class and the fields of a named tuple, numbers with their last digits rounded."""
    if hasattr(value, "_fields"):
        yield type(value).__name__.encode()
        for item in value:
            yield from _encode(item)
        return
    table = np.asarray(value)
    yield repr(table.shape).encode()
    is_numeric = table.dtype.kind in "biuf"
    yield _round_significands(table).tobytes() if is_numeric else repr(table.tolist()).encode()


def _round_significands(values: np.ndarray) -> np.ndarray:
    """Return numbers with their last digits rounded.

    A small offset is added, because scaled lengths are often whole numbers, where rounding is
    discontinuous.
    """
    mantissa, exponent = np.frexp(values * (1.0 + 1e-6 * 2.0 ** (-_COMPARED_BITS / 2)))
    whole = np.where(np.isfinite(values), np.round(mantissa * 2.0**_COMPARED_BITS), values)
    return np.stack([whole, exponent.astype(float)])
