"""Computation of tables of spectra over a grid of parameters."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import xarray as xr

from splits.core.atomic import check_writable
from splits.core.declarations import Quantity
from splits.core.inputs import (
    Kernel,
    MaxRays,
    Seed,
    Solver,
    StandardError,
    Threads,
    Wavelengths,
)
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback, report_whole_table
from splits.core.provenance import hash_physics_sources
from splits.core.validation import expand_path, invalid
from splits.illumination.bands import (
    Bands,
    SpectralOperator,
    check_bands,
    choose_band_wavelengths,
)
from splits.instruments.goniophotometer import MAX_CONVERGED_POLAR_DEG
from splits.instruments.solver import MONTE_CARLO
from splits.instruments.spectrophotometer import SpectralRequest
from splits.io.cache import Cache
from splits.simulation.run_options import RunOptions
from splits.simulation.shared_paths import (
    PathSharingMedia,
    compute_absorption_signature,
    compute_path_signature,
)
from splits.tables.assembly import (
    assemble_blocks,
    average_nodes,
)
from splits.tables.axes import (
    VIEW_AXES,
    Grid,
    GridIncidence,
    MakeMedium,
    ParameterGrid,
    ViewGrid,
    check_quantities,
    has_diffuse,
)
from splits.tables.block import TableRequest, compute_block, prepare_media
from splits.tables.comparison import PATH_ERROR_RATIO, add_comparisons
from splits.tables.plan import PathGroup, TablePlan, choose_table_solver
from splits.tables.table_interpolation import TableInterpolation

BLOCK_PREFIX = "block"
"""Beginning of the names of files of blocks."""


Covariance = Annotated[
    bool, Quantity("whether the table contains the contributions of batches of rays to the errors")
]


@declare_function
def build_table(
    make: MakeMedium,
    grid: Grid,
    wavelength_nm: Wavelengths | None = None,
    incidence_deg: GridIncidence = 0.0,
    *,
    max_stderr: StandardError = 0.003,
    solver: Solver = "auto",
    quantities: Sequence[str] | None = None,
    covariance: Covariance = False,
    bands: Bands = None,
    folder: str | Path | None = None,
    seed: Seed = 1,
    max_rays: MaxRays = 20_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Compute a table of spectra over a grid of parameters; `splits.Table` interpolates in it.

    Points that differ only in absorption, in the ground or, for semi-infinite media, in grain size
    share one ensemble of paths.  These points are identified from the media.

    Parameters
    ----------
    make : callable
        Function that returns the medium of a point for its parameters as keywords, such as
        `splits.Snow.natural` or a user's function.
    grid : mapping
        Values by parameter: increasing numbers, or text.  ``incidence_deg`` may be one of the
        parameters, in degrees or "diffuse".  ``polar_deg`` (from the normal, 0 to below 90 degrees)
        and ``azimuth_deg`` (from the direction in which the beam travels, 0 to 180 degrees) are
        directions of observation.
    wavelength_nm : array_like, optional
        Vacuum wavelengths (nm), strictly increasing; by default those of `bands`, at most 5 nm
        apart.
    incidence_deg : float or "diffuse"
        Angle of incidence (degrees), unless it is an axis of the grid.
    max_stderr : float
        Largest standard error of every node of the table, as for `splits.spectrophotometer`.  With
        directions, it applies to reflectance factors up to polar angles of
        `splits.instruments.goniophotometer.MAX_CONVERGED_POLAR_DEG`.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.spectrophotometer`, for all points of the table.
    quantities : sequence of str, optional
        Quantities of the table: "reflectance" (default) and "transmittance".  With directions:
        "reflectance", "reflectance_factor" (π·BRDF) and "anisotropy_factor" (the quotient of both),
        all three by default and from the same paths or solution, and "diffuse_reflectance",
        "diffuse_reflectance_factor" and "diffuse_anisotropy_factor", the same under isotropic
        light, which have no axes of incidence and azimuth.  Reflectances include light that a
        smooth surface reflects; the factors are those of scattered light.
    covariance : bool
        Whether to store ``…_batches``, 32 deviations by batch of rays for each value.  Sums of
        products over batches are the covariances of values that share paths.
    bands : mapping or str, optional
        Bands within the wavelengths, as for `splits.albedo`.
    folder : path, optional
        Folder in which each ensemble is stored when it is complete.  An interrupted run resumes
        from there with the same results.
    seed, max_rays, threads, kernel
        As for `splits.spectrophotometer`; `max_rays` applies to each ensemble.
    progress : callable or bool, optional
        As for `splits.spectrophotometer`, for the whole table.

    Returns
    -------
    xarray.Dataset
        Values and standard errors (float32) over the axes of the grid and ``wavelength``;
        ``reflectance`` has no directions of observation.  With bands, ``band_…`` are the means over
        ``band`` in place of ``wavelength``, weighted by the response.

    Raises
    ------
    ValueError
        For a value outside its range; the message names the point of the grid.

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
    start_time = time.perf_counter()
    run = RunOptions.start(seed, threads, kernel)
    named = {} if bands is None else check_bands(bands)
    if wavelength_nm is None and not named:
        raise invalid("wavelength_nm", None, "given, or bands")
    wavelengths = choose_band_wavelengths(named) if wavelength_nm is None else wavelength_nm
    spectral_request = SpectralRequest(np.asarray(wavelengths), 0.0, max_stderr, max_rays, run)
    matrix = SpectralOperator.from_bands(named, spectral_request.wavelengths) if named else None
    axes = ParameterGrid(grid)
    views = ViewGrid.from_grid(axes)
    selected = check_quantities(quantities, views, covariance)
    plan = TablePlan.from_grid(
        make, axes.drop(*VIEW_AXES), spectral_request.wavelengths, incidence_deg,
        has_views=views is not None, with_diffuse=has_diffuse(selected),
    )  # fmt: skip
    chosen = choose_table_solver(
        solver, plan.list_media(), spectral_request.wavelengths, covariance, max_stderr,
        has_views=views is not None,
    )  # fmt: skip
    request = TableRequest(spectral_request, selected, covariance, chosen, views)
    block_folder = None if folder is None else expand_path(folder, "folder")
    table = compute_table(plan, request, block_folder, progress)
    compared = add_comparisons(
        table, make, axes, plan, request, partial(compute_table, folder=block_folder)
    )
    warn_of_wide_intervals(compared)
    if matrix is not None:
        compared = average_nodes(compared, named, matrix)
    return compared.assign_attrs(wall_time_s=round(time.perf_counter() - start_time, 3))


def compute_table(
    plan: TablePlan,
    request: TableRequest,
    folder: Path | None = None,
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Return the table of a plan, without comparisons."""
    blocks = iterate_blocks(request, plan.path_groups, folder, progress)
    return assemble_blocks(plan, request, blocks)


def warn_of_wide_intervals(table: xr.Dataset) -> None:
    """Warn of the interval whose error of interpolation exceeds the requested error most."""
    interpolation, max_stderr = TableInterpolation(table), float(table.attrs["max_stderr"])
    noise = PATH_ERROR_RATIO * max_stderr if table.attrs["solver"] == MONTE_CARLO else 0.0
    found = [
        (*interval, name, quantity)
        for quantity in interpolation.quantities
        if not quantity.endswith("anisotropy_factor")
        for name, axis in interpolation.prepare(quantity).items()
        if (interval := axis.find_largest_difference(MAX_CONVERGED_POLAR_DEG)) is not None
    ]
    largest, low, high, column, name, quantity = max(found, default=(0.0, 0.0, 0.0, 0, "", ""))
    if largest > np.hypot(max_stderr, noise):
        warnings.warn(
            f"interpolation of {quantity} along {name} between {low:g} and {high:g} has an error "
            f"of {largest:.2g} at {table.wavelength.values[column]:g} nm, above max_stderr = "
            f"{max_stderr:g}: add nodes there, or accept the error that Table.interp states",
            stacklevel=4,
        )


def list_block_inputs(group: PathGroup, request: TableRequest) -> list[Any]:
    """Return all that determines the values of a block, as the key of a cache."""
    spectral_request, path_sharing = request.spectral_request, group.path_sharing
    wavelengths, run = spectral_request.wavelengths, spectral_request.run
    signature, unit = compute_path_signature(path_sharing.media[0])
    # All incidences determine the number of streams of discrete ordinates.
    solver = (
        [spectral_request.max_rays, run.seed, run.kernel]
        if request.solver == MONTE_CARLO
        else group.incidences
    )
    return [
        hash_physics_sources(), group.incidence, spectral_request.max_stderr, request.solver,
        solver, request.quantities, request.covariance, request.views, signature,
        wavelengths, group.positions, group.media_indices, unit * path_sharing.size_ratios,
        [compute_absorption_signature(medium, wavelengths) for medium in path_sharing.media],
    ]  # fmt: skip


def iterate_blocks(
    request: TableRequest,
    groups: Sequence[PathGroup],
    folder: Path | None,
    progress: ProgressCallback = None,
) -> Iterator[xr.Dataset]:
    """Yield the blocks of a table, loaded from a folder or computed and stored there.

    Parameters
    ----------
    request : TableRequest
    groups : sequence of PathGroup
        All or some path groups of a plan.
    folder : path or None
    progress : callable, optional
        Callback for the progress of the whole table.
    """
    if folder is not None:
        check_writable(folder / "block.nc")
    cache, start_time, n_done = Cache(folder, BLOCK_PREFIX), time.perf_counter(), 0
    prepared: tuple[PathSharingMedia | None, Any] = (None, None)

    def compute(number: int) -> xr.Dataset:
        nonlocal n_done, prepared
        group = groups[number]
        # The incidences of the same media follow each other.
        if prepared[0] is not group.path_sharing:
            prepared = group.path_sharing, prepare_media(group, request)
        report = report_whole_table(progress, start_time, n_done, len(groups) - number - 1)
        block = compute_block(group, request, prepared[1], report)
        n_done += 1
        return block

    for number, group in enumerate(groups):
        yield cache.get(list_block_inputs(group, request), partial(compute, number))
