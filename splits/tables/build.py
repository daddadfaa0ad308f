"""Computation of tables over a grid of parameters: spectra, directions, and returns of a pulse."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Sequence
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
    RayCount,
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
from splits.instruments.delay_record import (
    AcceptanceAngle,
    DelayEdges,
    FootprintRadius,
    Pulse,
    check_granular_layers,
    check_record,
    describe_record,
    limit_depths,
    make_receiver,
)
from splits.instruments.goniophotometer import MAX_CONVERGED_POLAR_DEG
from splits.instruments.solver import DISCRETE_ORDINATES, MONTE_CARLO
from splits.instruments.spectrophotometer import SpectralRequest
from splits.instruments.time_of_flight import FLAG_NAME, simulate_delays
from splits.io.cache import Cache
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.media.medium import Medium
from splits.simulation.run_options import RunOptions
from splits.simulation.shared_paths import (
    PathSharingMedia,
    compute_absorption_signature,
    compute_path_signature,
)
from splits.tables.axes import (
    INCIDENCE,
    MIXED_QUANTITIES,
    RETURN_QUANTITIES,
    VIEW_QUANTITIES,
    Grid,
    GridIncidence,
    MakeMedium,
    ParameterGrid,
)
from splits.tables.blocks import (
    PathGroup,
    TablePlan,
    assemble_blocks,
    average_nodes,
    choose_table_solver,
    compute_block,
    make_point_medium,
    prepare_media,
)
from splits.tables.comparison import list_comparison_grids, rename_comparison
from splits.tables.interpolation import AxisInterpolation
from splits.tables.table import Table

BLOCK_PREFIX = "block"
"""Beginning of the names of files of blocks."""
PATH_ERROR_RATIO = 2.0
"""Error of paths in comparisons, relative to that of the table."""
SEED_STEP = 2**32
"""Difference between the seeds of successive wavelengths of a table of returns."""
RETURN_TITLE = "Table of returns"


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
    delay_s: DelayEdges | None = None,
    rays: RayCount | None = None,
    acceptance_deg: AcceptanceAngle = None,
    footprint_radius_m: FootprintRadius = None,
    seed: Seed = 1,
    max_rays: MaxRays = 20_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> Table:
    """Compute a table over a grid of parameters, which interpolates between its nodes.

    It contains spectra; with the axes ``polar_deg`` and ``azimuth_deg`` reflectance factors in
    directions of observation, as of `splits.goniophotometer`; or with `delay_s` the return of an
    instantaneous pulse of light, as of `splits.time_of_flight`.

    Points that differ only in absorption, in the ground or, for semi-infinite media, in grain size
    share one ensemble of paths.  These points are identified from the media.  All points of a table
    of returns use the same random numbers, so that it is a smooth function of the parameters; each
    wavelength has paths of its own.

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
    delay_s : array_like, optional
        Delays (s) between the bins of a table of returns, as for `splits.time_of_flight`.  For
        `splits.retrieve_return`, bins should be narrower than the pulse and the bins of the
        measurement.
    rays : int, optional
        Number of rays at each point and wavelength of a table of returns, by default 100 000.
    acceptance_deg, footprint_radius_m
        Receiver of a table of returns, as for `splits.time_of_flight`.
    seed : int
        Non-negative; a table and synthetic measurements must have different seeds.
    max_rays, threads, kernel
        As for `splits.spectrophotometer`; `max_rays` applies to each ensemble.
    progress : callable or bool, optional
        As for `splits.spectrophotometer`, for the whole table.

    Returns
    -------
    Table
        Its ``dataset`` has values and standard errors (float32) over the axes of the grid and
        ``wavelength``; ``reflectance`` has no directions of observation.  With bands, ``band_…``
        are the means over ``band`` in place of ``wavelength``, weighted by the response.  A table
        of returns has, of reflected light, ``return_rate`` (s⁻¹) over ``delay_s``, and of the light
        within the record ``fraction`` and ``mean_delay`` (s), which is NaN where ``moments_flag``
        is 1.

    Raises
    ------
    ValueError
        For a value outside its range; the message names the point of the grid.  For an argument of
        spectra together with `delay_s`, or of returns without it.

    Examples
    --------
    >>> import splits
    >>> table = splits.build_table(
    ...     splits.Snow.natural,
    ...     {"optical_radius_um": [50, 100, 200], "incidence_deg": [0, 60]},
    ...     [500, 1030],
    ...     max_stderr=0.02,
    ... )
    >>> table
    Table of reflectance
      optical_radius_um: 3 from 50.0 to 200.0
      incidence_deg: 2 from 0.0 to 60.0
      wavelength: 2 from 500.0 to 1030.0
    >>> float(table.interp(optical_radius_um=70, incidence_deg=30).reflectance[1].round(1))
    0.7
    >>> returns = splits.build_table(
    ...     splits.Snow.natural,
    ...     {"specific_surface_area_m2_kg": [10, 20, 40], "density_kg_m3": [200, 400]},
    ...     1064,
    ...     delay_s=[0, 2e-11, 5e-11, 1e-10, 2e-10, 1e-9],
    ...     rays=1000,
    ... )
    >>> dict(returns.dataset.return_rate.sizes)
    {'specific_surface_area_m2_kg': 3, 'density_kg_m3': 2, 'wavelength': 1, 'delay_s': 5}
    """
    start_time = time.perf_counter()
    run = RunOptions.start(seed, threads, kernel)
    named = {} if bands is None else check_bands(bands)
    if wavelength_nm is None and not named:
        raise invalid("wavelength_nm", None, "given, or bands")
    wavelengths = np.asarray(
        choose_band_wavelengths(named) if wavelength_nm is None else wavelength_nm
    )
    axes = ParameterGrid(grid)
    of_returns = {
        "rays": (rays, None), "acceptance_deg": (acceptance_deg, None),
        "footprint_radius_m": (footprint_radius_m, None),
    }  # fmt: skip
    of_spectra = {
        "max_stderr": (max_stderr, 0.003), "solver": (solver, "auto"), "folder": (folder, None),
        "quantities": (quantities, None), "covariance": (covariance, False),
        "bands": (bands, None), "max_rays": (max_rays, 20_000_000),
    }  # fmt: skip
    for name, (value, default) in (of_returns if delay_s is None else of_spectra).items():
        if value is not default and value != default:
            preposition = "without" if delay_s is None else "with"
            raise invalid(name, value, f"left out {preposition} delay_s")
    if delay_s is not None:
        return _build_return_table(
            make, axes, wavelengths, incidence_deg, np.asarray(delay_s), rays or 100_000,
            acceptance_deg, footprint_radius_m, run, progress,
        )  # fmt: skip
    request = SpectralRequest(wavelengths, 0.0, max_stderr, max_rays, run)
    matrix = SpectralOperator.from_bands(named, wavelengths) if named else None
    plan = TablePlan.from_grid(
        make, axes, request, incidence_deg, quantities, covariance=covariance
    )
    plan = plan._replace(
        solver=choose_table_solver(
            solver, plan.list_media(), wavelengths, covariance, max_stderr,
            has_views=plan.views is not None,
        )
    )  # fmt: skip
    block_folder = None if folder is None else expand_path(folder, "folder")
    table = assemble_blocks(plan, iterate_blocks(plan, plan.path_groups, block_folder, progress))
    table = add_comparisons(table, make, axes, plan, block_folder)
    if matrix is not None:
        table = average_nodes(table, named, matrix)
    return Table(table.assign_attrs(wall_time_s=round(time.perf_counter() - start_time, 3)))


def _build_return_table(
    make: Callable[..., Medium], axes: ParameterGrid, wavelengths: np.ndarray,
    incidence_deg: float | str, delay_s: np.ndarray, rays: int, acceptance_deg: float | None,
    footprint_radius_m: float | None, run: RunOptions, progress: ProgressCallback,
) -> Table:  # fmt: skip
    """Return a table of the returns of a pulse, see `build_table`."""
    start_time = time.perf_counter()
    pulse = Pulse.from_argument(None)
    edges, end = check_record(delay_s, None, pulse)
    angles = axes.get(INCIDENCE, (incidence_deg,))
    beams = dict(zip(angles, axes.get_incidences(incidence_deg), strict=True))
    points = []
    for parameters in axes.iterate_points():
        incidence = beams[parameters.pop(INCIDENCE, incidence_deg)]
        receiver = make_receiver(incidence, acceptance_deg, footprint_radius_m)
        medium = make_point_medium(make, parameters, check_granular_layers)
        points.append((medium, incidence, receiver))
    names = [f"{name}{suffix}" for name in RETURN_QUANTITIES for suffix in ("", "_stderr")]
    spectra = []
    for number, (medium, incidence, receiver) in enumerate(points):
        show = report_whole_table(progress, start_time, number, len(points) - number - 1)
        parts = []
        for step, wavelength in enumerate(wavelengths):
            own_run = run._replace(progress=show, seed=(run.seed + step * SEED_STEP) % 2**63)
            part = simulate_delays(
                medium, np.array([wavelength]), incidence, rays, receiver, edges, end, pulse,
                own_run, limit_depths(None, medium),
            )  # fmt: skip
            parts.append(part[[*names, FLAG_NAME]].sel(side="reflected", drop=True))
        joined = xr.concat(parts, "wavelength", data_vars="minimal").drop_attrs(deep=False)
        spectra.append(joined.assign_coords(delay_bounds=part.delay_bounds))
    variables = {}
    for name, variable in spectra[0].data_vars.items():
        values = np.stack([one[name].values for one in spectra])
        values = values.reshape(*axes.shape, *variable.shape)
        variables[name] = ((*axes, *variable.dims), values, variable.attrs)
    table = xr.Dataset(variables, {**axes.to_coordinates(), **spectra[0].coords})
    attributes = {
        "title": RETURN_TITLE,
        "path_sharing_axes": "none",
        "medium": points[0][0].kind,
        **({} if INCIDENCE in axes else {INCIDENCE: incidence_deg}),
        **describe_record(None, acceptance_deg, footprint_radius_m),
        "rays": rays,
        "seed": run.seed,
        "threads": run.threads,
        "wall_time_s": round(time.perf_counter() - start_time, 3),
        **make_provenance("table"),
    }
    return Table(table.assign_attrs(to_netcdf_attributes(attributes)))


def add_comparisons(
    table: xr.Dataset,
    make_medium: Callable[..., Medium],
    grid: ParameterGrid,
    plan: TablePlan,
    folder: Path | None,
) -> xr.Dataset:
    """Return a table with spectra between its nodes; warn where interpolation has a large error.

    Parameters
    ----------
    table : xarray.Dataset
    make_medium, grid
        As for `TablePlan.from_grid`.
    plan : TablePlan
        Of the table.
    folder : path or None
        Folder of blocks.
    """
    by_ordinates = plan.solver == DISCRETE_ORDINATES
    axes = tuple(grid) if by_ordinates else plan.path_sharing_axes
    request = plan.request
    if not by_ordinates:
        request = request._replace(max_stderr=PATH_ERROR_RATIO * request.max_stderr)
    incidence = 0.0 if INCIDENCE in grid else plan.path_groups[0].incidence
    has_direction = any(name in VIEW_QUANTITIES for name in plan.quantities)
    found = [(0.0, 0.0, 0.0, 0, "", "")]
    for name, one in list_comparison_grids(grid, axes, by_ordinates=by_ordinates).items():
        kept = [q for q in plan.quantities if name in table[q].dims]
        if not kept:
            continue
        part = TablePlan.from_grid(make_medium, one, request, incidence, kept)
        part = part._replace(solver=plan.solver)
        compared = assemble_blocks(part, iterate_blocks(part, part.path_groups, folder))[kept]
        for quantity in kept:
            is_of_beam = plan.views is None or quantity in MIXED_QUANTITIES
            if is_of_beam and quantity != "anisotropy_factor":
                axis = AxisInterpolation(
                    name, table[name].values, request.wavelengths.size,
                    has_direction=has_direction,
                    comparison=compared[quantity].transpose(name, ..., "wavelength"),
                )  # fmt: skip
                interval = axis.find_largest_difference(MAX_CONVERGED_POLAR_DEG)
                found += [] if interval is None else [(*interval, name, quantity)]
        table = table.assign(rename_comparison(compared, name).data_vars)
    largest, low, high, column, name, quantity = max(found)
    max_stderr = plan.request.max_stderr
    noise = 0.0 if by_ordinates else PATH_ERROR_RATIO * max_stderr
    if largest > np.hypot(max_stderr, noise):
        warnings.warn(
            f"interpolation of {quantity} along {name} between {low:g} and {high:g} has an error "
            f"of {largest:.2g} at {request.wavelengths[column]:g} nm, above max_stderr = "
            f"{max_stderr:g}: add nodes there, or accept the error that Table.interp states",
            stacklevel=4,
        )
    return table


def list_block_inputs(group: PathGroup, plan: TablePlan) -> list[Any]:
    """Return all that determines the values of a block, as the key of a cache."""
    request, path_sharing = plan.request, group.path_sharing
    wavelengths, run = request.wavelengths, request.run
    signature, unit = compute_path_signature(path_sharing.media[0])
    # All incidences determine the number of streams of discrete ordinates.
    solver = (
        [request.max_rays, run.seed, run.kernel] if plan.solver == MONTE_CARLO else group.incidences
    )
    return [
        hash_physics_sources(), group.incidence, request.max_stderr, plan.solver,
        solver, plan.quantities, plan.covariance, plan.views, signature,
        wavelengths, group.positions, group.media_indices, unit * path_sharing.size_ratios,
        [compute_absorption_signature(medium, wavelengths) for medium in path_sharing.media],
    ]  # fmt: skip


def iterate_blocks(
    plan: TablePlan,
    groups: Sequence[PathGroup],
    folder: Path | None,
    progress: ProgressCallback = None,
) -> Iterator[xr.Dataset]:
    """Yield the blocks of a table, loaded from a folder or computed and stored there.

    Parameters
    ----------
    plan : TablePlan
    groups : sequence of PathGroup
        All or some path groups of the plan.
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
            prepared = group.path_sharing, prepare_media(group, plan)
        report = report_whole_table(progress, start_time, n_done, len(groups) - number - 1)
        block = compute_block(group, plan, prepared[1], report)
        n_done += 1
        return block

    for number, group in enumerate(groups):
        yield cache.get(list_block_inputs(group, plan), partial(compute, number))
