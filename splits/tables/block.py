"""Block of a table: the spectra of all points that share an ensemble of paths."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.progress import ProgressCallback
from splits.instruments.solver import DISCRETE_ORDINATES, MONTE_CARLO
from splits.instruments.spectrophotometer import SpectralRequest
from splits.io.netcdf import load, make_provenance, save
from splits.kernels.tallies.exits import N_BATCHES
from splits.simulation.deep_medium import TruncatedMedium
from splits.simulation.spectral_tally import SIDE_QUANTITIES
from splits.tables.block_directions import (
    make_view_variables,
    solve_directions,
    trace_directions,
)
from splits.tables.media_cache import MediaCache
from splits.tables.ordinates import solve_group
from splits.tables.plan import PathGroup
from splits.tables.views import ViewGrid

DIGEST_ATTRIBUTE = "table_digest"


class TableRequest(NamedTuple):
    """Request for a table.

    Attributes
    ----------
    spectral_request : SpectralRequest
        Request for spectra; each ensemble sets its own incidence.
    quantities : tuple of str
        See `splits.tables.views.check_quantities`.
    covariance : bool
        Whether deviations by batch of rays are stored.
    solver : {"monte_carlo", "discrete_ordinates"}
    views : ViewGrid or None
        Directions of observation.
    """

    spectral_request: SpectralRequest
    quantities: tuple[str, ...]
    covariance: bool
    solver: str = MONTE_CARLO
    views: ViewGrid | None = None


def compute_block(
    path_group: PathGroup,
    request: TableRequest,
    cache: MediaCache,
    digest: str,
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Compute a block: values and standard errors over ``point``, views and ``wavelength``.

    Parameters
    ----------
    path_group : PathGroup
    request : TableRequest
    cache : MediaCache
    digest : str
        Digest of all inputs of the block, see `splits.tables.build.compute_block_digest`.
    progress : callable, optional
    """
    start_time = time.perf_counter()
    run = request.spectral_request.run._replace(progress=progress)
    spectral_request = request.spectral_request._replace(incidence=path_group.incidence, run=run)
    compute = _compute_spectra if request.views is None else _compute_directions
    variables, described = compute(path_group, request, spectral_request, cache)
    attrs = {
        **make_provenance("block of a table"),
        DIGEST_ATTRIBUTE: digest,
        "ensemble": path_group.number,
        **described,
        "wall_time_s": round(time.perf_counter() - start_time, 3),
    }
    point_coordinate = ("point", path_group.positions, {"long_name": "flat index in the table"})
    return xr.Dataset(
        variables, {"point": point_coordinate, "wavelength": spectral_request.wavelengths}, attrs
    )


def _compute_directions(
    path_group: PathGroup, request: TableRequest, spectral_request: SpectralRequest,
    cache: MediaCache,
) -> tuple[dict[str, Any], dict[str, Any]]:  # fmt: skip
    """Return the variables of a block with directions of observation, and its attributes."""
    views = request.views
    assert views is not None
    if request.solver == DISCRETE_ORDINATES:
        estimate, attrs = solve_directions(path_group, spectral_request, views, cache)
    else:
        truncation = _truncate(path_group, spectral_request, cache)
        estimate, attrs = trace_directions(path_group, spectral_request, views, truncation)
    variables = make_view_variables(
        estimate, path_group, views, spectral_request.wavelengths.size, request.quantities
    )
    return variables, attrs | {"interpolation_error_bound": 0.0}


def _compute_spectra(
    path_group: PathGroup, request: TableRequest, spectral_request: SpectralRequest,
    cache: MediaCache,
) -> tuple[dict[str, Any], dict[str, Any]]:  # fmt: skip
    """Return the variables of a block of spectra, and its attributes."""
    if request.solver == DISCRETE_ORDINATES:
        estimate = solve_group(path_group, spectral_request, cache)
    else:
        truncation = _truncate(path_group, spectral_request, cache)
        estimate = spectral_request.simulate(path_group.path_sharing, truncation)
    shape = (len(path_group.path_sharing.media), spectral_request.wavelengths.size)
    variables: dict[str, Any] = {}
    for side in request.quantities:
        row = SIDE_QUANTITIES.index(side)
        for name, array in ((side, estimate.mean), (f"{side}_stderr", estimate.stderr)):
            values = array[row].reshape(shape)[path_group.media_indices]
            variables[name] = (("point", "wavelength"), values.astype(np.float32))
        if request.covariance:
            deviations = estimate.batch_deviations[:, row].reshape(N_BATCHES, *shape)[
                :, path_group.media_indices
            ]
            variables[f"{side}_batches"] = (
                ("batch", "point", "wavelength"), deviations.astype(np.float32),
            )  # fmt: skip
    return variables, {
        **estimate.rays,
        "max_stderr_reached": float(estimate.stderr.max()),
        "interpolation_error_bound": float(estimate.interpolation_error.max()),
        "stop_reason": estimate.get_stop_reason(
            spectral_request.max_stderr, spectral_request.max_rays
        ),
    }


def _truncate(
    path_group: PathGroup, spectral_request: SpectralRequest, cache: MediaCache
) -> TruncatedMedium | None:
    """Return the truncation of semi-infinite media, which does not depend on the incidence."""
    media = path_group.path_sharing
    return cache.get(media, lambda: spectral_request.truncate(media))


def make_block_path(folder: Path, number: int, digest: str) -> Path:
    """Return the path of a block file, which depends on the digest."""
    return folder / f"block_{number:06d}_{digest[:16]}.nc"


def load_block(folder: Path, number: int, digest: str) -> xr.Dataset | None:
    """Return a stored block, or None if it is missing, damaged or of another digest."""
    path = make_block_path(folder, number, digest)
    if not path.exists():
        return None
    try:
        block = load(path)
    except ValueError:
        # A damaged or foreign file is computed again and overwritten.
        return None
    return block if block.attrs.get(DIGEST_ATTRIBUTE) == digest else None


def save_block(block: xr.Dataset, folder: Path) -> None:
    """Write a block to its file atomically."""
    save(
        block, make_block_path(folder, int(block.attrs["ensemble"]), block.attrs[DIGEST_ATTRIBUTE])
    )
