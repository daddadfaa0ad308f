"""Hemispherical-directional reflectance factor under a sky."""

from __future__ import annotations

import xarray as xr

from splits.core.inputs import (
    Azimuths,
    Kernel,
    MaxRays,
    PolarAngles,
    RelativeError,
    Seed,
    Solver,
    Threads,
    Wavelengths,
)
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import make_variable
from splits.core.validation import invalid
from splits.illumination.bands import Bands, check_bands, choose_band_wavelengths
from splits.illumination.sky import SkyInput
from splits.instruments.goniophotometer import AZIMUTH_DEG, POLAR_DEG, goniophotometer
from splits.instruments.sky_mixing import (
    as_sky,
    average_over_bands,
    choose_wavelengths,
    make_sky_attributes,
    mix_direct_and_diffuse,
)
from splits.instruments.solver import MONTE_CARLO
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate


@declare_function
def hdrf(
    medium: Medium,
    sky: SkyInput,
    wavelength_nm: Wavelengths | None = None,
    *,
    relative_stderr: RelativeError = 0.02,
    solver: Solver = "auto",
    polar_deg: PolarAngles = POLAR_DEG,
    azimuth_deg: Azimuths = AZIMUTH_DEG,
    bands: Bands = None,
    seed: Seed = 1,
    max_rays: MaxRays = 1_000_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the hemispherical-directional reflectance factor of a medium under a sky.

    Parameters
    ----------
    medium : Medium
    sky : Sky, str or mapping
        See `splits.sky`.
    wavelength_nm : array_like, optional
        Strictly increasing vacuum wavelengths (nm) within the spectrum of the sky, at least two
        with `bands`; by default those of `bands`, at most 5 nm apart.
    relative_stderr : float
        Largest standard error relative to the value, separately for direct sunlight and for diffuse
        light, see `splits.goniophotometer`.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.goniophotometer`.
    polar_deg, azimuth_deg : array_like
        Directions of view, see `splits.goniophotometer`; azimuth 0 is forward, away from the sun.
    bands : mapping or str, optional
        As for `splits.albedo`.
    seed : int
        Non-negative; diffuse light uses the next one.
    max_rays, threads, kernel
        As for `splits.goniophotometer`.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress`.

    Returns
    -------
    xarray.Dataset
        ``reflectance_factor`` and its error ``reflectance_factor_stderr`` over ``wavelength``,
        ``polar_deg`` and ``azimuth_deg``: the radiance over that of a white Lambertian surface in
        the same light.  The specular reflection of sunlight at a smooth boundary is excluded.  With
        bands, ``band_reflectance_factor`` is its mean over ``band`` in place of ``wavelength``,
        weighted by irradiance times response, and ``irradiance_covered`` the fraction of the band's
        light within the wavelengths.

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
    named = {} if bands is None else check_bands(bands)
    if wavelength_nm is None:
        if not named:
            raise invalid("wavelength_nm", None, "given, or bands")
        sky_spectrum.check_bands(named, sky_spectrum.wavelength_nm)
        wavelength_nm = choose_band_wavelengths(named, *sky_spectrum.wavelength_nm[[0, -1]])
    wavelengths = choose_wavelengths(wavelength_nm, sky_spectrum, 2 if named else 1)
    sky_spectrum.check_bands(named, wavelengths)
    run = RunOptions.start(seed, threads, kernel, progress)

    def simulate_component(incidence: float | str, number: int) -> xr.Dataset:
        return goniophotometer(
            medium, wavelengths, incidence, relative_stderr=relative_stderr, solver=solver,
            polar_deg=polar_deg, azimuth_deg=azimuth_deg, seed=run.seed + number,
            max_rays=max_rays, threads=threads, kernel=kernel, progress=progress,
        )  # fmt: skip

    name = "reflectance_factor"
    mixed = mix_direct_and_diffuse(sky_spectrum, wavelengths, simulate_component, [name])
    term = "hemispherical-directional reflectance factor under this sky"
    dims = ("wavelength", "polar_deg", "azimuth_deg")
    mean, stderr = (mixed[key].transpose(*dims).values for key in (name, f"{name}_stderr"))
    mixed = mixed.assign(make_variable(name, dims, mean, stderr, term))
    mixed = mixed.assign_coords(wavelength=make_wavelength_coordinate(wavelengths))
    mixed.attrs = {
        **run.make_attributes("Reflectance factor under a sky", "hdrf", medium),
        **make_sky_attributes(sky_spectrum, named),
        "relative_stderr": relative_stderr,
        **mixed.attrs,
    }
    if not named:
        return mixed
    means = average_over_bands(mixed, name, sky_spectrum, named, "reflectance factor")
    return mixed.assign_coords(band=list(named)).assign(means)
