"""Tables of spectra over a grid of parameters."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.atomic import check_writable
from splits.core.paths import expand_path
from splits.core.progress import Progress, ProgressCallback, with_progress
from splits.core.provenance import hash_physics_sources
from splits.core.validation import check_choice, invalid, reject_unknown_arguments
from splits.instruments.spectral_run import SIDE_QUANTITIES, SpectralRequest
from splits.media.medium import Medium
from splits.simulation.path_reuse import compute_absorption_signature, compute_path_signature
from splits.tables.assembly import allocate_arrays, assemble_dataset, insert_block
from splits.tables.axes import ParameterGrid
from splits.tables.block import (
    TableRequest,
    TruncationCache,
    compute_block,
    load_block,
    save_block,
)
from splits.tables.plan import PathGroup, TablePlan


@reject_unknown_arguments
@with_progress
def build_table(
    make: Callable[..., Medium],
    grid: Mapping[str, Any],
    wavelength_nm: Any,
    incidence_deg: float | str = 0.0,
    max_stderr: float = 0.003,
    seed: int = 1,
    *,
    quantities: Sequence[str] = ("reflectance",),
    covariance: bool = False,
    folder: str | Path | None = None,
    max_rays: int = 20_000_000,
    threads: int | None = None,
    kernel: str = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Measure spectra over a grid of parameters, from as few paths as serve them all.

    Points that differ only in what absorbs, in the ground, or, in packs without end, in size share
    one ensemble of paths; which these are is found from the media themselves.

    Parameters
    ----------
    make : callable
        Takes the parameters of a point as keywords and returns its medium: `splits.Snow.natural`,
        or a function of your own.
    grid : mapping
        From parameters to their values: increasing numbers, or texts.  ``incidence_deg`` may be
        one of them: degrees, or "diffuse".
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm).
    incidence_deg : float or "diffuse"
        Where the grid has no such axis.
    max_stderr, seed, max_rays, threads, kernel
        As for `splits.spectrophotometer`; the error is reached in every cell, and `max_rays` is
        the limit of an ensemble.
    quantities : sequence of str
        Of "reflectance" and "transmittance".
    covariance : bool
        Whether ``…_batches`` are kept, 32 deviations by batch of rays for each value: sums of
        products are covariances of cells that share paths.
    folder : path, optional
        Keeps what has been measured, ensemble by ensemble.  A run that was broken off goes on
        from there, and gives the same numbers.
    progress : callable or bool, optional
        As for `splits.spectrophotometer`, of the whole table.

    Returns
    -------
    xarray.Dataset
        Values and errors, float32, over the axes of the grid and ``wavelength``.

    Raises
    ------
    ValueError
        For a value outside its range; names the point of the grid that cannot be.

    Examples
    --------
    >>> import splits
    >>> found = splits.build_table(
    ...     splits.Snow.natural,
    ...     {"optical_radius_um": [50, 100, 200], "incidence_deg": [0, 60]},
    ...     [500, 1030],
    ...     max_stderr=0.02,
    ... )
    >>> dict(found.reflectance.sizes)
    {'optical_radius_um': 3, 'incidence_deg': 2, 'wavelength': 2}
    """
    begun = time.perf_counter()
    run = SpectralRequest.from_arguments(
        wavelength_nm, 0.0, max_stderr, seed, max_rays, threads, kernel
    )
    order = TableRequest(run, _check_quantities(quantities), bool(covariance))
    plan = TablePlan.from_grid(
        make, ParameterGrid.from_mapping(grid), run.wavelengths, incidence_deg
    )
    place = None if folder is None else expand_path(folder, "folder")
    found = allocate_arrays(plan, order)
    facts = []
    for block in iterate_blocks(order, plan.path_groups, place, progress):
        insert_block(found, block)
        facts.append(block.attrs)
    return assemble_dataset(found, plan, order, facts, time.perf_counter() - begun)


def _check_quantities(quantities: Sequence[str]) -> tuple[str, ...]:
    """Return quantities of a table, or refuse them."""
    if isinstance(quantities, str) or not quantities or len(set(quantities)) < len(quantities):
        raise invalid("quantities", quantities, f"a list of {' and '.join(SIDE_QUANTITIES)}")
    return tuple(check_choice("quantities", name, SIDE_QUANTITIES) for name in quantities)


def compute_block_digest(path_group: PathGroup, request: TableRequest) -> str:
    """Return the SHA-256 of all that decides a block's numbers."""
    digest = hashlib.sha256(hash_physics_sources().encode())
    run = request.spectral_request._replace(incidence=path_group.incidence, threads=0)
    digest.update(repr(run._replace(wavelengths=np.zeros(0))).encode())
    digest.update(repr([request.quantities, request.covariance]).encode())
    likely, unit = compute_path_signature(path_group.path_sharing.media[0])
    digest.update(likely)
    sizes = unit * path_group.path_sharing.size_ratios
    for row in (run.wavelengths, path_group.positions, path_group.media_indices, sizes):
        digest.update(np.ascontiguousarray(row).tobytes())
    for medium in path_group.path_sharing.media:
        digest.update(compute_absorption_signature(medium, run.wavelengths))
    return digest.hexdigest()


def iterate_blocks(
    request: TableRequest,
    path_groups: Sequence[PathGroup],
    folder: Path | None,
    progress: ProgressCallback = None,
) -> Iterator[xr.Dataset]:
    """Yield blocks of a table, those kept in a folder as they are, others measured and kept.

    Parameters
    ----------
    request : TableRequest
    path_groups : sequence of Ensemble
        Of a plan, all or some.
    folder : path or None
    progress : callable, optional
        Told of the whole.
    """
    if folder is not None:
        check_writable(folder / "block.nc")
    begun, cuts, measured = time.perf_counter(), TruncationCache(), 0
    for number, ensemble in enumerate(path_groups):
        digest = compute_block_digest(ensemble, request)
        block = None if folder is None else load_block(folder, ensemble.number, digest)
        if block is None:
            left = len(path_groups) - number - 1
            show = (
                _report_whole_table(progress, begun, measured, left) if callable(progress) else None
            )
            block = compute_block(ensemble, request, cuts, digest, show)
            measured += 1
            if folder is not None:
                save_block(block, folder)
        yield block


def _report_whole_table(
    report: Callable[[Progress], None], start_time: float, n_done: int, n_left: int
) -> Callable[[Progress], None]:
    """Return what tells of the whole table where one ensemble has got to."""

    def show(one: Progress) -> None:
        spent = time.perf_counter() - start_time
        each = (spent + one.seconds_left) / (n_done + 1)
        report(Progress(one.rays, one.stderr, one.target, spent, one.seconds_left + n_left * each))

    return show
