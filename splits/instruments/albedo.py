"""Spectral and band albedo under a sky, with correlated errors propagated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import compute_weighted_error, make_deviation_variable, make_variable
from splits.core.validation import check_range
from splits.illumination.bands import SpectralBand
from splits.illumination.sky import Sky
from splits.instruments.sky_mixing import (
    as_sky,
    choose_wavelengths,
    make_sky_attributes,
    mix_direct_and_diffuse,
)
from splits.instruments.spectrophotometer import spectrophotometer
from splits.media.medium import Medium
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate


@reject_unknown_arguments
def albedo(
    medium: Medium | Mapping[str, Medium],
    sky: Sky | str | Mapping[str, Any],
    wavelength_nm: Any = None,
    max_stderr: float = 0.005,
    seed: int = 1,
    *,
    bands: Mapping[str, Any] | str | None = None,
    threads: int | None = None,
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the albedo of a medium under a sky (blue-sky albedo).

    Parameters
    ----------
    medium : Medium, or a mapping
        For example `splits.Snow`, or a mapping from names to media that share paths, as for
        `splits.spectrophotometer`.  The errors of differences between these media are much smaller
        than those of their albedos (`splits.core.uncertainty.compute_difference`).
    sky : Sky, str or mapping
        See `splits.sky`.
    wavelength_nm : array_like, optional
        Strictly increasing vacuum wavelengths (nm), at least two; by default every 10 nm from
        the first of the sky to 2495.
    max_stderr : float
        Largest standard error of the reflectance at any wavelength, separately for direct sunlight
        and for diffuse light, 1e-6 to 0.5.  The albedo combines both, so its error is at most this.
    seed : int
        Non-negative; diffuse light uses the next one.
    bands : mapping or str, optional
        Names of bands to their limits (nm): ``{"visible": (305, 700)}``; or to a spectral response,
        a mapping of ``wavelength_nm`` and ``response`` or the path of a CSV file with these
        columns; or the name of a sensor, see `splits.sensor_bands`.
    threads : int, optional
        Default: every CPU that this process may use.
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
        ``medium``, too.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths outside the spectrum of the sky.
    """
    sky_spectrum = as_sky(sky)
    wavelengths = choose_wavelengths(wavelength_nm, sky_spectrum, 2)
    max_stderr = check_range("max_stderr", max_stderr, 1e-6, 0.5)
    run = RunOptions.from_arguments(seed, threads, progress=progress)
    named = sky_spectrum.make_bands(bands)
    sky_spectrum.check_bands(named, wavelengths)

    is_mapping = isinstance(medium, Mapping)

    def simulate(incidence: float | str, number: int) -> xr.Dataset:
        return spectrophotometer(
            medium,
            wavelengths,
            incidence,
            max_stderr,
            run.seed + number,
            threads=run.threads,
            progress=progress,
        )

    mixed = mix_direct_and_diffuse(sky_spectrum, wavelengths, simulate, ["reflectance"])
    attributes = {
        **run.make_attributes("Albedo under a sky", "albedo", _get_first_medium(medium)),
        **make_sky_attributes(sky_spectrum),
        "max_stderr": max_stderr,
    }
    attributes |= {f"band_{name}_sha256": one.sha256 for name, one in named.items() if one.sha256}
    axes = {name: axis for name, axis in mixed.coords.items() if name != "wavelength"}
    attributes = {
        name: fact for name, fact in attributes.items() if name == "medium" or name not in axes
    }
    axes["wavelength"] = make_wavelength_coordinate(wavelengths)
    dims = ("medium", "wavelength") if is_mapping else ("wavelength",)
    spectrum = xr.Dataset(
        _rename_reflectance("albedo", dims, mixed, "albedo under this sky"), axes, attributes
    )
    direct_attributes = {"long_name": "fraction of direct sunlight", "units": "1"}
    spectrum["direct_fraction"] = (
        "wavelength",
        sky_spectrum.compute_direct_fraction(wavelengths),
        direct_attributes,
    )
    return spectrum.assign(_average_over_bands(spectrum, sky_spectrum, named)).assign_coords(
        band=list(named)
    )


def _get_first_medium(medium: Medium | Mapping[str, Medium]) -> Medium:
    return next(iter(medium.values())) if isinstance(medium, Mapping) else medium


def _rename_reflectance(
    name: str, dims: tuple[str, ...], reflectance: xr.Dataset, label: str
) -> dict[str, Any]:
    """Return a reflectance under another name: values, errors and batch deviations."""
    value, error = (
        reflectance[f"reflectance{suffix}"].transpose(*dims).values for suffix in ("", "_stderr")
    )
    batch_deviations = reflectance.reflectance_batches.transpose("batch", *dims).values
    return make_variable(name, dims, value, error, label) | make_deviation_variable(
        name, dims, batch_deviations, label
    )


def _average_over_bands(
    spectrum: xr.Dataset, sky: Sky, bands: Mapping[str, SpectralBand]
) -> dict[str, Any]:
    """Return the albedo of every band, its error, and the fraction of its light that is covered."""
    wavelengths = spectrum.wavelength.values
    value, error, batch_deviations, covered = [], [], [], []
    for band in bands.values():
        weights = sky.compute_weights(wavelengths, band)
        all_light = sky.compute_weights(sky.wavelength_nm, band).sum()
        normalized = xr.DataArray(
            weights / weights.sum(), {"wavelength": wavelengths}, ("wavelength",)
        )
        value.append((normalized * spectrum.albedo).sum("wavelength").values)
        error.append(compute_weighted_error(spectrum, "albedo", normalized).values)
        batch_deviations.append((normalized * spectrum.albedo_batches).sum("wavelength").values)
        covered.append(weights.sum() / all_light)
    label = "albedo over a band, weighted by irradiance"
    dims = (*(dim for dim in spectrum.albedo.dims if dim != "wavelength"), "band")
    variables: dict[str, Any] = make_variable(
        "band_albedo", dims, np.stack(value, axis=-1), np.stack(error, axis=-1), label
    )
    variables |= make_deviation_variable(
        "band_albedo", dims, np.stack(batch_deviations, axis=-1), label
    )
    attributes = {"long_name": "fraction of the band's light within the wavelengths", "units": "1"}
    return variables | {"irradiance_covered": ("band", np.array(covered), attributes)}
