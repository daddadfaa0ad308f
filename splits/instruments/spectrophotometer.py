"""Virtual spectrophotometer: directional-hemispherical reflectance and transmittance."""

from __future__ import annotations

import time
from collections.abc import Callable
from numbers import Integral
from typing import Any

import numpy as np
import xarray as xr

from splits.checks import in_range, one_of, refuse
from splits.dataset import attributes, provenance
from splits.instruments.estimators import ESTIMATORS
from splits.instruments.runner import KERNELS, Progress, Runner
from splits.media.granular import GranularMedium
from splits.transport import sources_digest

WAVELENGTH_RANGE_NM = (200.0, 100_000.0)
QUANTITIES = {
    "reflectance": "hemispherical reflectance",
    "transmittance": "hemispherical transmittance",
    "absorptance": "absorptance",
}


def check_wavelengths(wavelength_nm: Any) -> np.ndarray:
    """Return wavelengths (nm) as a strictly increasing array, or refuse them."""
    try:
        values = np.atleast_1d(np.asarray(list(np.atleast_1d(wavelength_nm)), dtype=float))
    except (TypeError, ValueError):
        raise refuse("wavelength_nm", wavelength_nm, "numbers in nanometres") from None
    low, high = WAVELENGTH_RANGE_NM
    if values.size == 0:
        raise refuse("wavelength_nm", [], "at least one wavelength in nanometres")
    for value in values:
        in_range("wavelength_nm", float(value), low, high, "nm")
    if not (np.diff(values) > 0).all():
        raise refuse("wavelength_nm", values.tolist(), "strictly increasing")
    return values


def check_incidence(incidence_deg: Any) -> float | str:
    """Return the angle of incidence in [0, 89.9999] degrees, or "diffuse", or refuse it."""
    if isinstance(incidence_deg, str):
        return one_of("incidence_deg", incidence_deg, ["diffuse"])
    return in_range("incidence_deg", incidence_deg, 0.0, 89.9999, "degrees")


def spectrophotometer(
    medium: GranularMedium,
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
    medium : GranularMedium
        For example `splits.Snow`.
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
        ``…_stderr`` over ``wavelength``; the three add up to 1.  All inputs stand in the
        attributes.

    Raises
    ------
    ValueError
        For a value outside its range.

    References
    ----------
    SPLITSnow section 4.1, Eq 8: reflectance is the share of rays that leave upwards, n/N (the
    printed 1/π belongs to a radiance, not to a share of rays).
    """
    wavelengths = check_wavelengths(wavelength_nm)
    incidence = check_incidence(incidence_deg)
    max_stderr = in_range("max_stderr", max_stderr, 1e-6, 0.5)
    one_of("estimator", estimator, ESTIMATORS)
    one_of("kernel", kernel, KERNELS)
    for key, value, low in (("seed", seed, 0), ("max_rays", max_rays, 1)):
        if isinstance(value, bool) or not isinstance(value, Integral) or not low <= value < 2**63:
            raise refuse(key, value, f"a whole number of at least {low}")
    if threads is not None and (not isinstance(threads, Integral) or threads < 1):
        raise refuse("threads", threads, "a whole number of at least 1")

    begun = time.perf_counter()
    runner = Runner(medium, incidence, int(seed), threads, estimator == "analog", kernel, progress)
    result = ESTIMATORS[estimator](runner, medium, wavelengths, max_stderr, int(max_rays))

    illumination = "hemispherical" if incidence == "diffuse" else "directional"
    variables: dict[str, Any] = {}
    for row, (name, label) in enumerate(QUANTITIES.items()):
        long_name = label if name == "absorptance" else f"{illumination}-{label}"
        variables[name] = (
            "wavelength",
            result.mean[row],
            {"long_name": long_name, "units": "1", "ancillary_variables": f"{name}_stderr"},
        )
        variables[f"{name}_stderr"] = (
            "wavelength",
            result.stderr[row],
            {"long_name": f"standard error of {long_name}", "units": "1"},
        )
    coordinate = (
        "wavelength",
        wavelengths,
        {
            "long_name": "wavelength in vacuum",
            "units": "nm",
            "standard_name": "radiation_wavelength",
        },
    )
    facts = {
        "title": f"Virtual spectrophotometer: {medium.kind}",
        "instrument": "spectrophotometer",
        "medium": medium.kind,
        **{f"{medium.kind}_{key}": value for key, value in medium.describe().items()},
        "incidence_deg": incidence,
        "estimator": estimator,
        "max_stderr": max_stderr,
        "stopped_by": "error" if result.converged else "rays",
        "max_stderr_reached": float(result.stderr.max()),
        "interpolation_error_bound": float(result.bias.max()),
        "max_rays": int(max_rays),
        "rays": result.rays,
        "ensembles": result.ensembles,
        "seed": int(seed),
        "threads": runner.threads,
        "kernel": result.kernel,
        "wall_time_s": round(time.perf_counter() - begun, 3),
        "physics_sources_sha256": sources_digest(),
        **provenance(),
    }
    return xr.Dataset(variables, {"wavelength": coordinate}, attributes(facts))
