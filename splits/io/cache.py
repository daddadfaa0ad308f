"""Cache on disk: datasets in files named by the digest of all that determines them.

It holds the simulated points of experiments, the blocks of tables and snowpacks, and the scattering
by grains.  Results are the same with and without it, and an interrupted run resumes from it.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.progress import warn_once
from splits.io.netcdf import load, save

DIGEST_ATTRIBUTE = "cache_digest"


def compute_digest(*parts: Any) -> str:
    """Return the SHA-256 (first 32 hex digits) of numbers, texts, arrays, and nested lists of them.

    Types, lengths and shapes are part of it, so that different inputs have different digests.
    Mappings are taken in the order of their keys, and named tuples with the names of their classes.
    """
    digest = hashlib.sha256()

    def add(part: Any) -> None:
        if isinstance(part, np.ndarray) and part.dtype.kind != "O":
            digest.update(f"array {part.dtype.str} {part.shape} ".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        elif isinstance(part, np.ndarray | np.generic):
            add(part.tolist())
        elif isinstance(part, Mapping):
            add(("mapping", sorted(part.items(), key=lambda item: str(item[0]))))
        elif isinstance(part, Sequence) and not isinstance(part, str | bytes):
            name = type(part).__name__ if hasattr(part, "_fields") else ""
            digest.update(f"list {name} {len(part)} ".encode())
            for one in part:
                add(one)
        elif isinstance(part, str | bytes | bool | int | float | None):
            text = part if isinstance(part, bytes) else str(part).encode()
            digest.update(f"{type(part).__name__} {len(text)} ".encode() + text)
        else:
            raise TypeError(f"a {type(part).__name__} has no digest")

    add(parts)
    return digest.hexdigest()[:32]


class Cache:
    """Folder of datasets, which several processes may share.

    Parameters
    ----------
    folder : Path or None
        Need not exist; with None, nothing is kept.
    prefix : str
        Beginning of the names of the files.
    max_bytes : float
        Size of all files above which those that are unused for the longest time are removed.
    is_optional : bool
        Whether a dataset that cannot be written is only logged.
    """

    def __init__(
        self, folder: Path | None, prefix: str, *, max_bytes: float = math.inf,
        is_optional: bool = False,
    ) -> None:  # fmt: skip
        self.folder, self.prefix = folder, prefix
        self.max_bytes, self.is_optional = max_bytes, is_optional
        self._used: set[Path] = set()

    def find_path(self, digest: str) -> Path:
        """Return the file of a digest, which need not exist."""
        assert self.folder is not None
        return self.folder / f"{self.prefix}_{digest}.nc"

    def get(self, key_parts: Sequence[Any], make: Callable[[], xr.Dataset]) -> xr.Dataset:
        """Return the dataset of a key, which is made and written if its file is missing or damaged.

        It is always read from its file: attributes then have the same types in a resumed run.

        Parameters
        ----------
        key_parts : sequence
            All that determines the dataset, see `compute_digest`.
        make : callable
            Returns the dataset.

        Raises
        ------
        OSError
            If the dataset cannot be written, unless the cache is optional.
        """
        if self.folder is None:
            return make()
        digest = compute_digest(*key_parts)
        path = self.find_path(digest)
        self._used.add(path)
        try:
            return self._read(path, digest)
        except FileNotFoundError:
            pass
        except (ValueError, OSError) as error:
            warn_once(f"{path}: made again ({error})")
        made = make()
        try:
            save(made.assign_attrs({DIGEST_ATTRIBUTE: digest}), path)
        except OSError as error:
            if not self.is_optional:
                raise
            warn_once(f"{path}: not kept for the next call ({error.strerror or error})")
            return made
        self._limit_size(path)
        return self._read(path, digest)

    def delete(self) -> None:
        """Delete the files that were used, and the folder and its parent if they are then empty."""
        for path in self._used:
            path.unlink(missing_ok=True)
        for folder in (self.folder, self.folder.parent) if self.folder else ():
            with suppress(OSError):
                folder.rmdir()

    def _read(self, path: Path, digest: str) -> xr.Dataset:
        dataset = load(path)
        if dataset.attrs.pop(DIGEST_ATTRIBUTE, "") != digest:
            raise ValueError("a file of another key")
        if self.max_bytes < math.inf:
            with suppress(OSError):
                os.utime(path)
        return dataset

    def _limit_size(self, newest: Path) -> None:
        ages = []
        for path in newest.parent.glob(f"{self.prefix}_*.nc") if self.max_bytes < math.inf else ():
            with suppress(OSError):
                ages.append((path.stat().st_mtime, path.stat().st_size, path))
        total = sum(size for _, size, _ in ages)
        for _, size, path in sorted(ages):
            if total <= self.max_bytes or path == newest:
                break
            path.unlink(missing_ok=True)
            total -= size


NO_CACHE = Cache(None, "")
"""Cache that keeps nothing."""
