"""Albedo and hemispherical-directional reflectance factor under a sky."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

from splits.core.inputs import (
    Azimuths,
    Kernel,
    MaxRays,
    PolarAngles,
    RelativeError,
    Seed,
    Solver,
    StandardError,
    Threads,
    Wavelengths,
)
from splits.core.keywords import instrument
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import make_deviation_variable, make_variable
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
from splits.instruments.snow_packs import compute_pack_albedo
from splits.instruments.solver import MONTE_CARLO
from splits.instruments.spectrophotometer import spectrophotometer
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.media.snow_packs import SnowPacks
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate

# --------------------------------------------------------------------------------------------------
# Spectral and band albedo under a sky, with correlated errors propagated.


@instrument
def albedo(
    medium: Medium | Mapping[str, Medium] | SnowPacks,
    sky: SkyInput,
    wavelength_nm: Wavelengths | None = None,
    *,
    max_stderr: StandardError = 0.005,
    solver: Solver = "auto",
    bands: Bands = None,
    seed: Seed = 1,
    max_rays: MaxRays = 20_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the albedo of a medium under a sky (blue-sky albedo).

    Parameters
    ----------
    medium : Medium, mapping or SnowPacks
        For example `splits.Snow`, or a mapping from names to media that share paths, as for
        `splits.spectrophotometer`.  The errors of differences between these media are much smaller
        than those of their albedos (`splits.core.uncertainty.compute_difference`).  Or
        `splits.SnowPacks`, the snowpacks of a season, by discrete ordinates.
    sky : Sky, str, mapping or function
        See `splits.sky`.  Over `splits.SnowPacks` with ``sun_zenith_deg``, a name or a table
        applies to the zenith angle of each snowpack, and so does a function that returns a sky for
        a zenith angle (degrees); a `Sky` is the same for all (`splits.instruments.snow_packs`).
    wavelength_nm : array_like, optional
        Strictly increasing vacuum wavelengths (nm), at least two; by default every 10 nm from
        the first of the sky to 2495.
    max_stderr : float
        Largest standard error of the reflectance at any wavelength, separately for direct sunlight
        and for diffuse light, 1e-6 to 0.5.  The albedo combines both, so its error is at most this.
    seed : int
        Non-negative; diffuse light uses the next one.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.spectrophotometer`.
    bands : mapping or str, optional
        Names of bands to their limits (nm): ``{"visible": (305, 700)}``; or to a spectral response,
        a mapping of ``wavelength_nm`` and ``response`` or the path of a CSV file with these
        columns; or the name of a sensor, see `splits.sensor_bands`.
    max_rays, threads, kernel
        As for `splits.spectrophotometer`.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress`.

    Returns
    -------
    xarray.Dataset
        ``albedo`` and its error ``albedo_stderr`` over ``wavelength``, with ``albedo_batches`` for
        errors of combinations of wavelengths; ``direct_fraction``, the fraction of direct light;
        and over ``band``,
        the first of which is "broadband", ``band_albedo`` with ``band_albedo_stderr``, weighted by
        irradiance times response, ``band_albedo_batches``, and ``irradiance_covered``, the fraction
        of the band's light within the wavelengths.  With several media all but the last are over
        ``medium``, too.  For `splits.SnowPacks` all are over the label, without ``…_batches``, and
        snowpacks without result have a ``quality_flag``, as for `splits.spectrophotometer`.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths outside the spectrum of the sky.
    """
    run = RunOptions.start(seed, threads, kernel, progress)
    if isinstance(medium, SnowPacks):
        return compute_pack_albedo(medium, sky, wavelength_nm, max_stderr, solver, bands, run)
    sky_spectrum = as_sky(sky)
    wavelengths = choose_wavelengths(wavelength_nm, sky_spectrum, 2)
    named = sky_spectrum.make_bands(bands)
    sky_spectrum.check_bands(named, wavelengths)

    def simulate_component(incidence: float | str, number: int) -> xr.Dataset:
        return spectrophotometer(
            medium, wavelengths, incidence, max_stderr=max_stderr, solver=solver,
            seed=run.seed + number, max_rays=max_rays, threads=run.threads, kernel=kernel,
            progress=progress,
        )  # fmt: skip

    mixed = mix_direct_and_diffuse(sky_spectrum, wavelengths, simulate_component, ["reflectance"])
    first = next(iter(medium.values())) if isinstance(medium, Mapping) else medium
    attributes = {
        **run.make_attributes("Albedo under a sky", "albedo", first),
        **make_sky_attributes(sky_spectrum),
        "max_stderr": max_stderr,
        **mixed.attrs,
    }
    attributes |= {f"band_{name}_sha256": one.sha256 for name, one in named.items() if one.sha256}
    axes = {**mixed.coords, "wavelength": make_wavelength_coordinate(wavelengths)}
    axes["band"] = list(named)
    attributes = {
        name: fact for name, fact in attributes.items() if name == "medium" or name not in axes
    }
    dims = ("medium", "wavelength") if isinstance(medium, Mapping) else ("wavelength",)
    values, stderr, deviations = (
        mixed[f"reflectance{suffix}"].transpose(..., *dims).values
        for suffix in ("", "_stderr", "_batches")
    )
    direct_fraction = sky_spectrum.compute_direct_fraction(wavelengths)
    direct_attributes = {"long_name": "fraction of direct sunlight", "units": "1"}
    variables = {
        **make_variable("albedo", dims, values, stderr, "albedo under this sky"),
        **make_deviation_variable("albedo", dims, deviations, "albedo under this sky"),
        "direct_fraction": ("wavelength", direct_fraction, direct_attributes),
    }
    spectrum = xr.Dataset(variables, axes, attributes)
    return spectrum.assign(average_over_bands(spectrum, "albedo", sky_spectrum, named, "albedo"))


# --------------------------------------------------------------------------------------------------
# Hemispherical-directional reflectance factor under a sky.


@instrument
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
    seed : int
        Non-negative; diffuse light uses the next one.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.goniophotometer`.
    polar_deg, azimuth_deg : array_like
        Directions of view, see `splits.goniophotometer`; azimuth 0 is forward, away from the sun.
    bands : mapping or str, optional
        As for `splits.albedo`.
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
    attributes = run.make_attributes("Reflectance factor under a sky", "hdrf", medium)
    requested = {"relative_stderr": relative_stderr, **mixed.attrs}
    mixed = mixed.assign_coords(wavelength=make_wavelength_coordinate(wavelengths))
    attributes |= {f"band_{key}_sha256": one.sha256 for key, one in named.items() if one.sha256}
    mixed = mixed.assign_attrs(attributes | make_sky_attributes(sky_spectrum) | requested)
    if not named:
        return mixed
    means = average_over_bands(mixed, name, sky_spectrum, named, "reflectance factor")
    return mixed.assign_coords(band=list(named)).assign(means)
