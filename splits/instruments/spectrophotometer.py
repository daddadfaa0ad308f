"""Virtual spectrophotometer: directional-hemispherical reflectance and transmittance."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import xarray as xr

from splits.checks import in_range, known_arguments, one_of
from splits.instruments.arguments import (
    check_incidence,
    check_medium,
    check_threads,
    check_wavelengths,
    check_whole,
)
from splits.instruments.deep_packs import cut_of
from splits.instruments.estimators import ESTIMATORS, Estimate
from splits.instruments.labels import run_facts, wavelength_axis
from splits.instruments.runner import Progress, Runner
from splits.instruments.tracers import KERNELS
from splits.media.turbid import Medium
from splits.uncertainty import Variable, deviations, quantity

QUANTITIES = {
    "reflectance": "hemispherical reflectance",
    "transmittance": "hemispherical transmittance",
    "absorptance": "absorptance",
}


@known_arguments
def spectrophotometer(
    medium: Medium,
    wavelength_nm: Any,
    incidence_deg: float | str = 0.0,
    max_stderr: float = 0.002,
    seed: int = 1,
    *,
    estimator: str = "spectral",
    max_rays: int = 20_000_000,
    threads: int | None = None,
    kernel: str = "auto",
    progress: Callable[[Progress], None] | None = None,
) -> xr.Dataset:
    """Measure hemispherical reflectance, transmittance and absorptance of a medium.

    Parameters
    ----------
    medium : GranularMedium or TurbidMedium
        For example `splits.Snow` or `splits.Layer`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), 200 to 100 000 and within the tables of the
        medium's refractive indices.
    incidence_deg : float or "diffuse"
        Polar angle of a collimated beam, 0 to 89.9999 degrees, or equal radiance from everywhere.
    max_stderr : float
        Largest standard error wanted for any quantity at any wavelength, 1e-6 to 0.5.
    seed : int
        Non-negative; the same seed gives the same numbers bit for bit on any number of threads.
    estimator : {"spectral", "analog"}
        Paths shared by all wavelengths, or the papers' algorithm as a reference: one wavelength
        at a time, absorption by coin toss.
    max_rays : int
        The run stops once this many are traced (the first round is traced in any case);
        attribute ``stopped_by`` says whether the error or the rays came first.
    threads : int, optional
        Default: every CPU this process may use.
    kernel : {"auto", "lanes", "scalar"}
        Many rays side by side in single precision where that serves the sample, or the plain
        reference kernel in double precision.
    progress : callable, optional
        Called now and then with a `Progress`.

    Returns
    -------
    xarray.Dataset
        ``reflectance``, ``transmittance``, ``absorptance`` and their standard errors
        ``…_stderr`` over ``wavelength``; the three add up to 1.  ``reflectance_groups`` and
        ``transmittance_groups`` over ``group`` and ``wavelength`` tell how errors go together,
        see `splits.analysis.errors`; absorptance's are minus their sum.  All inputs stand in
        the attributes.  Of packs so deep that they are cut (`splits.instruments.deep_packs`), the
        attribute ``traced_to_m`` says where, and ``optically_deep_m`` from which depth on they
        are as bright as without end; what theory may miss of the rest is in the errors.

    Raises
    ------
    ValueError
        For a value outside its range.

    References
    ----------
    SPLITSnow section 4.1, Eq 8: reflectance is the share of rays that leave upwards, n/N (the
    printed 1/π belongs to a radiance, not to a share of rays).
    """
    check_medium(medium, endless=estimator == "spectral")
    wavelengths = check_wavelengths(wavelength_nm)
    incidence = check_incidence(incidence_deg)
    max_stderr = in_range("max_stderr", max_stderr, 1e-6, 0.5)
    one_of("estimator", estimator, ESTIMATORS)
    one_of("kernel", kernel, KERNELS)
    seed = check_whole("seed", seed, 0)
    max_rays = check_whole("max_rays", max_rays, 1)
    threads = check_threads(threads)

    begun = time.perf_counter()
    analog = estimator == "analog"
    cut = None if analog else cut_of(medium, wavelengths, max_stderr, seed, threads)
    traced = medium if cut is None else cut.medium

    def estimate(goal: float) -> Estimate:
        runner = Runner(traced, incidence, seed, threads, analog, kernel, progress)
        return ESTIMATORS[estimator](runner, traced, wavelengths, goal, max_rays)

    result = estimate(max_stderr) if cut is None else cut.reached(estimate, max_stderr)

    illumination = "hemispherical" if incidence == "diffuse" else "directional"
    variables: dict[str, Variable] = {}
    for row, (name, label) in enumerate(QUANTITIES.items()):
        long_name = label if name == "absorptance" else f"{illumination}-{label}"
        variables |= quantity(name, "wavelength", result.mean[row], result.stderr[row], long_name)
        if name != "absorptance":
            variables |= deviations(name, "wavelength", result.groups[:, row], long_name)
    facts = {
        **run_facts("Virtual spectrophotometer", "spectrophotometer", medium, begun, seed, threads),
        "incidence_deg": incidence,
        "estimator": estimator,
        "max_stderr": max_stderr,
        "stopped_by": "error" if result.converged else "rays",
        "max_stderr_reached": float(result.stderr.max()),
        "interpolation_error_bound": float(result.bias.max()),
        "max_rays": max_rays,
        "rays": result.rays,
        "ensembles": result.ensembles,
        "kernel": result.kernel,
    }
    if cut is not None:
        facts |= {"traced_to_m": cut.depth_m, "optically_deep_m": cut.enough_m}
    return xr.Dataset(variables, {"wavelength": wavelength_axis(wavelengths)}, facts)
