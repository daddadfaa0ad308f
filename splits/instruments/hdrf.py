"""Hemispherical-directional reflectance factor under a sky."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import make_variable
from splits.illumination.sky import Sky
from splits.instruments.goniophotometer import AZIMUTH_DEG, POLAR_DEG, goniophotometer
from splits.instruments.sky_mixing import (
    as_sky,
    choose_wavelengths,
    make_sky_attributes,
    mix_direct_and_diffuse,
)
from splits.instruments.solver import MONTE_CARLO
from splits.media.checks import check_medium
from splits.media.medium import Medium
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate


@reject_unknown_arguments
def hdrf(
    medium: Medium,
    sky: Sky | str | Mapping[str, Any],
    wavelength_nm: Any,
    relative_stderr: float = 0.02,
    seed: int = 1,
    *,
    solver: str = "auto",
    polar_deg: Any = POLAR_DEG,
    azimuth_deg: Any = AZIMUTH_DEG,
    threads: int | None = None,
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the hemispherical-directional reflectance factor of a medium under a sky.

    Parameters
    ----------
    medium : Medium
    sky : Sky, str or mapping
        See `splits.sky`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm) within the spectrum of the sky.
    relative_stderr : float
        Largest standard error relative to the value, separately for direct sunlight and for diffuse
        light, see `splits.goniophotometer`.
    seed : int
        Non-negative; diffuse light uses the next one.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.goniophotometer`.
    polar_deg, azimuth_deg : array_like
        Directions of view, see `splits.goniophotometer`; azimuth 0 is forward, away from the sun.
    threads : int, optional
        Default: every CPU that this process may use.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress`.

    Returns
    -------
    xarray.Dataset
        ``reflectance_factor`` and its error ``reflectance_factor_stderr`` over ``wavelength``,
        ``polar`` and ``azimuth``: the radiance over that of a white Lambertian surface in the same
        light.  The specular reflection of sunlight at a smooth boundary is excluded.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths outside the spectrum of the sky.

    References
    ----------
    Schaepman-Strub et al. (2006), Remote Sensing of Environment 103, 27-42, section 2.
    """
    check_medium(medium, allow_semi_infinite=solver != MONTE_CARLO)
    sky_spectrum = as_sky(sky)
    wavelengths = choose_wavelengths(wavelength_nm, sky_spectrum, 1)
    run = RunOptions.from_arguments(seed, threads, progress=progress)

    def simulate_component(incidence: float | str, number: int) -> xr.Dataset:
        return goniophotometer(
            medium, wavelengths, incidence, seed=run.seed + number, solver=solver,
            relative_stderr=relative_stderr, polar_deg=polar_deg, azimuth_deg=azimuth_deg,
            threads=threads, progress=progress,
        )  # fmt: skip

    name = "reflectance_factor"
    mixed = mix_direct_and_diffuse(sky_spectrum, wavelengths, simulate_component, [name])
    term = "hemispherical-directional reflectance factor under this sky"
    dims = ("wavelength", "polar", "azimuth")
    mean, stderr = (mixed[key].transpose(*dims).values for key in (name, f"{name}_stderr"))
    mixed = mixed.assign(make_variable(name, dims, mean, stderr, term))
    attributes = run.make_attributes("Reflectance factor under a sky", "hdrf", medium)
    requested = {"relative_stderr": relative_stderr, **mixed.attrs}
    mixed = mixed.assign_coords(wavelength=make_wavelength_coordinate(wavelengths))
    return mixed.assign_attrs(attributes | make_sky_attributes(sky_spectrum) | requested)
