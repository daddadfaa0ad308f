"""A block of a table: what one ensemble of paths tells of all points that it serves."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.progress import ProgressCallback
from splits.instruments.spectral_run import SIDE_QUANTITIES, SpectralRequest
from splits.io.netcdf import load, make_provenance, save
from splits.simulation.path_tally import PathSharingMedia
from splits.simulation.tally import N_BATCHES
from splits.simulation.truncated_medium import TruncatedMedium
from splits.tables.plan import PathGroup

DIGEST_ATTRIBUTE = "table_digest"


class TableRequest(NamedTuple):
    """How a table is to be measured.

    Attributes
    ----------
    spectral_request : Run
        But for the incidence, which is each ensemble's own.
    quantities : tuple of str
        Of `SIDE_QUANTITIES`.
    covariance : bool
        Whether deviations by batch of rays are kept.
    """

    spectral_request: SpectralRequest
    quantities: tuple[str, ...]
    covariance: bool


class TruncationCache:
    """Cuts of deep packs, which do not depend on the incidence: each family's is kept."""

    def __init__(self) -> None:
        self._path_sharing: PathSharingMedia | None = None
        self._truncation: TruncatedMedium | None = None

    def get(
        self, spectral_request: SpectralRequest, path_sharing: PathSharingMedia
    ) -> TruncatedMedium | None:
        """Return the cut of a family; that of the last one asked for is at hand."""
        if path_sharing is not self._path_sharing:
            self._path_sharing, self._truncation = (
                path_sharing,
                spectral_request.truncate(path_sharing),
            )
        return self._truncation


def compute_block(
    path_group: PathGroup,
    request: TableRequest,
    truncations: TruncationCache,
    digest: str,
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Return a block: values and errors over ``point`` and ``wavelength``.

    Parameters
    ----------
    path_group : Ensemble
    request : TableRequest
    truncations : TruncationCache
    digest : str
        Of all that decides the table's numbers.
    progress : callable, optional
    """
    begun = time.perf_counter()
    run = request.spectral_request._replace(incidence=path_group.incidence)
    cut = truncations.get(run, path_group.path_sharing)
    found = run.estimate_truncated(cut, path_group.path_sharing, progress=progress).estimate
    shape = (len(path_group.path_sharing.media), run.wavelengths.size)
    variables: dict[str, Any] = {}
    for side in request.quantities:
        row = SIDE_QUANTITIES.index(side)
        for name, table in ((side, found.mean), (f"{side}_stderr", found.stderr)):
            values = table[row].reshape(shape)[path_group.media_indices]
            variables[name] = (("point", "wavelength"), values.astype(np.float32))
        if request.covariance:
            groups = found.batch_deviations[:, row].reshape(N_BATCHES, *shape)[
                :, path_group.media_indices
            ]
            variables[f"{side}_batches"] = (
                ("batch", "point", "wavelength"), groups.astype(np.float32),
            )  # fmt: skip
    facts = {
        **make_provenance("block of a table"),
        DIGEST_ATTRIBUTE: digest,
        "ensemble": path_group.number,
        "rays": found.n_rays,
        "max_stderr_reached": float(found.stderr.max()),
        "interpolation_error_bound": float(found.interpolation_error.max()),
        "kernel": found.kernel,
        "stop_reason": "converged" if found.converged else "max_rays",
        "wall_time_s": round(time.perf_counter() - begun, 3),
    }
    places = ("point", path_group.positions, {"long_name": "place in the table"})
    return xr.Dataset(variables, {"point": places, "wavelength": run.wavelengths}, facts)


def make_block_path(folder: Path, number: int, digest: str) -> Path:
    """Return where a block is kept; one of another digest has another place."""
    return folder / f"block_{number:06d}_{digest[:16]}.nc"


def load_block(folder: Path, number: int, digest: str) -> xr.Dataset | None:
    """Return a block that was kept, None where there is none, or one that is of no use."""
    path = make_block_path(folder, number, digest)
    if not path.exists():
        return None
    try:
        block = load(path)
    except ValueError:
        # Damaged, or of another program: it is measured again, and written over.
        return None
    return block if block.attrs.get(DIGEST_ATTRIBUTE) == digest else None


def save_block(block: xr.Dataset, folder: Path) -> None:
    """Write a block, whole or not at all."""
    save(
        block, make_block_path(folder, int(block.attrs["ensemble"]), block.attrs[DIGEST_ATTRIBUTE])
    )
