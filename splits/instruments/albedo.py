"""Albedos under a sky: by wavelength, and over bands, with errors that go together as they do."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.progress import ProgressCallback
from splits.core.uncertainty import compute_weighted_error, make_deviation_variable, make_variable
from splits.core.validation import check_range, reject_unknown_arguments
from splits.illumination.bands import SpectralBand
from splits.illumination.sky import Sky
from splits.instruments.sky_mixing import (
    as_sky,
    choose_wavelengths,
    make_sky_attributes,
    mix_direct_and_diffuse,
)
from splits.instruments.spectra import spectra
from splits.instruments.spectrophotometer import spectrophotometer
from splits.media.medium import Medium
from splits.simulation.arguments import check_integer, check_threads
from splits.simulation.attributes import make_run_attributes, make_wavelength_coordinate


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
    """Measure the albedo of a medium under a sky (blue-sky albedo).

    Parameters
    ----------
    medium : GranularMedium or ParticleMedium, or a mapping
        Names to media that share paths, as for `splits.spectra`: their differences are known far
        better than their albedos (`splits.core.uncertainty.compute_difference`).
    sky : Sky, str or mapping
        See `splits.sky`.
    wavelength_nm : array_like, optional
        Strictly increasing vacuum wavelengths (nm), at least two; by default every 10 nm from
        the first of the sky to 2495.
    max_stderr : float
        Largest standard error wanted at any wavelength, of the light of the sun and of the
        diffuse light each, 1e-6 to 0.5.
    seed : int
        Non-negative; diffuse light takes the next.
    bands : mapping or str, optional
        Names of bands to their ends (nm): ``{"visible": (305, 700)}``; or to how a sensor responds,
        a mapping of ``wavelength_nm`` and ``response`` or the path of a CSV file with these
        columns; or the name of a sensor, see `splits.sensor_bands`.
    threads : int, optional
        Default: every CPU this process may use.
    progress : callable or bool, optional
        True shows a bar; a function is called now and then with a `Progress`.

    Returns
    -------
    xarray.Dataset
        ``albedo`` and its error ``albedo_stderr`` over ``wavelength``, with ``albedo_batches`` for
        what combines wavelengths; ``direct_fraction`` of the light; and over ``band``, the first of
        which is "broadband", ``band_albedo`` with ``band_albedo_stderr``, weighted by irradiance
        times response, ``band_albedo_batches``, and ``irradiance_covered``, the part of the band's
        light within the wavelengths.  Of several media all but the last are over ``medium``, too.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths that the sky does not have.
    """
    begun = time.perf_counter()
    light = as_sky(sky)
    w = choose_wavelengths(wavelength_nm, light, 2)
    max_stderr = check_range("max_stderr", max_stderr, 1e-6, 0.5)
    seed, threads = check_integer("seed", seed, 0), check_threads(threads)
    named = light.make_bands(bands)
    light.check_bands(named, w)

    many = isinstance(medium, Mapping)

    def run(incidence: float | str, number: int) -> xr.Dataset:
        measure: Any = spectra if many else spectrophotometer
        return measure(
            medium, w, incidence, max_stderr, seed + number, threads=threads, progress=progress
        )

    found = mix_direct_and_diffuse(light, w, run, ["reflectance"])
    facts = {
        **make_run_attributes(
            "Albedo under a sky", "albedo", _get_first_medium(medium), begun, seed, threads
        ),
        **make_sky_attributes(light),
        "max_stderr": max_stderr,
    }
    facts |= {f"band_{name}_sha256": one.sha256 for name, one in named.items() if one.sha256}
    axes = {name: axis for name, axis in found.coords.items() if name != "wavelength"}
    facts = {name: fact for name, fact in facts.items() if name == "medium" or name not in axes}
    axes["wavelength"] = make_wavelength_coordinate(w)
    dims = ("medium", "wavelength") if many else ("wavelength",)
    spectrum = xr.Dataset(
        _rename_reflectance("albedo", dims, found, "albedo under this sky"), axes, facts
    )
    about = {"long_name": "part of the light that comes straight from the sun", "units": "1"}
    spectrum["direct_fraction"] = ("wavelength", light.compute_direct_fraction(w), about)
    return spectrum.assign(_average_over_bands(spectrum, light, named)).assign_coords(
        band=list(named)
    )


def _get_first_medium(medium: Medium | Mapping[str, Medium]) -> Medium:
    return next(iter(medium.values())) if isinstance(medium, Mapping) else medium


def _rename_reflectance(
    name: str, dims: tuple[str, ...], reflectance: xr.Dataset, label: str
) -> dict[str, Any]:
    """Return what was found of reflectance under another name: values, errors and groups."""
    value, error = (
        reflectance[f"reflectance{end}"].transpose(*dims).values for end in ("", "_stderr")
    )
    groups = reflectance.reflectance_batches.transpose("batch", *dims).values
    return make_variable(name, dims, value, error, label) | make_deviation_variable(
        name, dims, groups, label
    )


def _average_over_bands(
    spectrum: xr.Dataset, sky: Sky, bands: Mapping[str, SpectralBand]
) -> dict[str, Any]:
    """Return the albedo of every band, its error, and how much of the band's light is known."""
    w = spectrum.wavelength.values
    value, error, groups, covered = [], [], [], []
    for band in bands.values():
        weights = sky.compute_weights(w, band)
        all_light = sky.compute_weights(sky.wavelength_nm, band).sum()
        normal = xr.DataArray(weights / weights.sum(), {"wavelength": w}, ("wavelength",))
        value.append((normal * spectrum.albedo).sum("wavelength").values)
        error.append(compute_weighted_error(spectrum, "albedo", normal).values)
        groups.append((normal * spectrum.albedo_batches).sum("wavelength").values)
        covered.append(weights.sum() / all_light)
    label = "albedo over a band, weighted by irradiance"
    dims = (*(d for d in spectrum.albedo.dims if d != "wavelength"), "band")
    found: dict[str, Any] = make_variable(
        "band_albedo", dims, np.stack(value, axis=-1), np.stack(error, axis=-1), label
    )
    found |= make_deviation_variable("band_albedo", dims, np.stack(groups, axis=-1), label)
    about = {"long_name": "part of the band's light within the wavelengths", "units": "1"}
    return found | {"irradiance_covered": ("band", np.array(covered), about)}
