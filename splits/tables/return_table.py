"""Computation of tables of the return of a light pulse over a grid of parameters."""

from __future__ import annotations

import time

import numpy as np
import xarray as xr

from splits.core.inputs import Kernel, RayCount, Seed, Threads, Wavelengths
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback, report_whole_table
from splits.instruments.delay_record import (
    DEFAULT_EDGES_S,
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
from splits.instruments.time_of_flight import FLAG_NAME, simulate_delays
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.simulation.run_options import RunOptions
from splits.tables.axes import INCIDENCE, Grid, GridIncidence, MakeMedium, ParameterGrid
from splits.tables.plan import make_point_medium

RETURN_QUANTITIES = ("return_rate", "fraction", "mean_delay")
"""Quantities of a table of returns."""
SEED_STEP = 2**32
"""Difference between the seeds of successive wavelengths."""
TITLE = "Table of returns"


@declare_function
def build_return_table(
    make: MakeMedium,
    grid: Grid,
    wavelength_nm: Wavelengths,
    incidence_deg: GridIncidence = 0.0,
    *,
    rays: RayCount = 100_000,
    delay_s: DelayEdges = DEFAULT_EDGES_S,
    acceptance_deg: AcceptanceAngle = None,
    footprint_radius_m: FootprintRadius = None,
    seed: Seed = 1,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Compute the return of an instantaneous pulse of light over a grid of parameters.

    All points of the grid use the same random numbers, so that the table is a smooth function of
    the parameters; each wavelength has paths of its own.

    Parameters
    ----------
    make : callable
        Function that returns the medium of a point for its parameters as keywords, such as
        `splits.Snow.natural` or a user's function.
    grid : mapping
        Increasing numbers by parameter.  ``incidence_deg`` may be one of the parameters.
    wavelength_nm, incidence_deg
        As for `splits.time_of_flight`.
    rays : int
        Number of rays at each point and wavelength.
    delay_s, acceptance_deg, footprint_radius_m
        As for `splits.time_of_flight`.  For `splits.retrieve_return`, bins should be narrower than
        the pulse and the bins of the measurement.
    seed : int
        Non-negative; a table and synthetic measurements must have different seeds.
    threads, kernel
        As for `splits.time_of_flight`.
    progress : callable or bool, optional
        As for `splits.build_table`.

    Returns
    -------
    xarray.Dataset
        Over the axes of the grid and ``wavelength``, of reflected light: ``return_rate`` (s⁻¹) over
        ``delay_s``, and of the light within the record ``fraction`` and ``mean_delay`` (s), as of
        `splits.time_of_flight`, with standard errors ``…_stderr``.  ``mean_delay`` is NaN where
        ``moments_flag`` is 1.

    Raises
    ------
    ValueError
        For a value outside its range; the message names the point of the grid.

    Examples
    --------
    >>> import splits
    >>> table = splits.build_return_table(
    ...     splits.Snow.natural,
    ...     {"specific_surface_area_m2_kg": [10, 20, 40], "density_kg_m3": [200, 400]},
    ...     1064,
    ...     rays=1000,
    ...     delay_s=[0, 2e-11, 5e-11, 1e-10, 2e-10, 1e-9],
    ... )
    >>> dict(table.return_rate.sizes)
    {'specific_surface_area_m2_kg': 3, 'density_kg_m3': 2, 'wavelength': 1, 'delay_s': 5}
    """
    start_time = time.perf_counter()
    axes = ParameterGrid(grid)
    wavelengths = np.asarray(wavelength_nm)
    run = RunOptions.start(seed, threads, kernel)
    pulse = Pulse.from_argument(None)
    edges, end = check_record(np.asarray(delay_s), None, pulse)
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
        "title": TITLE,
        "medium": points[0][0].kind,
        **({} if INCIDENCE in axes else {INCIDENCE: incidence_deg}),
        **describe_record(None, acceptance_deg, footprint_radius_m),
        "rays": rays,
        "seed": run.seed,
        "threads": run.threads,
        "wall_time_s": round(time.perf_counter() - start_time, 3),
        **make_provenance("build_return_table"),
    }
    return table.assign_attrs(to_netcdf_attributes(attributes))
