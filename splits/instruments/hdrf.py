"""The reflectance factor of a sample under a sky, by direction of view."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import xarray as xr

from splits.core.progress import ProgressCallback
from splits.core.validation import reject_unknown_arguments
from splits.illumination.sky import Sky
from splits.instruments.goniophotometer import AZIMUTH_DEG, POLAR_DEG, goniophotometer
from splits.instruments.sky_mixing import (
    as_sky,
    choose_wavelengths,
    make_sky_attributes,
    mix_direct_and_diffuse,
)
from splits.media.medium import Medium
from splits.simulation.arguments import check_integer, check_threads
from splits.simulation.attributes import make_run_attributes, make_wavelength_coordinate


@reject_unknown_arguments
def hdrf(
    medium: Medium,
    sky: Sky | str | Mapping[str, Any],
    wavelength_nm: Any,
    relative_stderr: float = 0.02,
    seed: int = 1,
    *,
    polar_deg: Any = POLAR_DEG,
    azimuth_deg: Any = AZIMUTH_DEG,
    threads: int | None = None,
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Measure the hemispherical-directional reflectance factor of a medium under a sky.

    Parameters
    ----------
    medium : GranularMedium or TurbidMedium
    sky : Sky, str or mapping
        See `splits.sky`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm) that the sky has.
    relative_stderr : float
        Largest standard error wanted as a part of the value, under the sun and under diffuse light
        each, see `splits.goniophotometer`.
    seed : int
        Non-negative; diffuse light takes the next.
    polar_deg, azimuth_deg : array_like
        Directions of view, see `splits.goniophotometer`; azimuth 0 is forward, away from the sun.
    threads : int, optional
        Default: every CPU this process may use.
    progress : callable or bool, optional
        True shows a bar; a function is called now and then with a `Progress`.

    Returns
    -------
    xarray.Dataset
        ``reflectance_factor`` and its error ``reflectance_factor_stderr`` over ``wavelength``,
        ``polar`` and ``azimuth``: the radiance over that of a white Lambertian surface in the same
        light.  Sunlight that is reflected as a beam, by a smooth face, is left out.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths that the sky does not have.

    References
    ----------
    Schaepman-Strub et al. (2006), Remote Sensing of Environment 103, 27-42, section 2.
    """
    begun = time.perf_counter()
    light = as_sky(sky)
    w = choose_wavelengths(wavelength_nm, light, 1)
    seed, threads = check_integer("seed", seed, 0), check_threads(threads)

    def run(incidence: float | str, number: int) -> xr.Dataset:
        return goniophotometer(
            medium, w, incidence, seed=seed + number, relative_stderr=relative_stderr,
            polar_deg=polar_deg, azimuth_deg=azimuth_deg, threads=threads, progress=progress,
        )  # fmt: skip

    name = "reflectance_factor"
    found = mix_direct_and_diffuse(light, w, run, [name])
    term = "hemispherical-directional reflectance factor under this sky"
    error = {"long_name": f"standard error of {term}", "units": "1"}
    about = {"long_name": term, "units": "1", "ancillary_variables": f"{name}_stderr"}
    found[name].attrs, found[f"{name}_stderr"].attrs = about, error
    facts = make_run_attributes(
        "Reflectance factor under a sky", "hdrf", medium, begun, seed, threads
    )
    asked_for = {"relative_stderr": relative_stderr}
    found = found.assign_coords(wavelength=make_wavelength_coordinate(w))
    return found.assign_attrs(facts | make_sky_attributes(light) | asked_for)
