"""Albedos under a sky: by wavelength, and over bands, with errors that go together as they do."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.analysis.errors import weighted_error
from splits.checks import in_range, known_arguments
from splits.instruments import spectrophotometer
from splits.instruments.arguments import check_threads, check_whole
from splits.instruments.labels import run_facts, wavelength_axis
from splits.media.turbid import Medium
from splits.skies.bands import Band
from splits.skies.irradiance import Sky
from splits.skies.mixing import asked, light_of, mixed, sky_facts
from splits.uncertainty import deviations, quantity


@known_arguments
def albedo(
    medium: Medium,
    sky: Sky | str | Mapping[str, Any],
    wavelength_nm: Any = None,
    max_stderr: float = 0.005,
    seed: int = 1,
    *,
    bands: Mapping[str, Any] | str | None = None,
    threads: int | None = None,
) -> xr.Dataset:
    """Measure the albedo of a medium under a sky (blue-sky albedo).

    Parameters
    ----------
    medium : GranularMedium or TurbidMedium
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
        columns; or the name of a sensor, see `splits.sensor`.
    threads : int, optional
        Default: every CPU this process may use.

    Returns
    -------
    xarray.Dataset
        ``albedo`` and its error ``albedo_stderr`` over ``wavelength``, with ``albedo_groups`` for
        what combines wavelengths; ``direct_share`` of the light; and over ``band``, the first of
        which is "broadband", ``band_albedo`` with ``band_albedo_stderr``, weighted by irradiance
        times response, and ``irradiance_covered``, the part of the band's light within the
        wavelengths.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths that the sky does not have.
    """
    begun = time.perf_counter()
    light = light_of(sky)
    w = asked(wavelength_nm, light, 2)
    max_stderr = in_range("max_stderr", max_stderr, 1e-6, 0.5)
    seed, threads = check_whole("seed", seed, 0), check_threads(threads)
    named = light.bands(bands)
    light.check_bands(named, w)

    def run(incidence: float | str, number: int) -> xr.Dataset:
        return spectrophotometer(medium, w, incidence, max_stderr, seed + number, threads=threads)

    found = mixed(light, w, run, ["reflectance"])
    label = "albedo under this sky"
    variables = quantity(
        "albedo", "wavelength", found.reflectance.values, found.reflectance_stderr.values, label
    )
    groups = found.reflectance_groups.transpose("group", "wavelength").values
    variables |= deviations("albedo", "wavelength", groups, label)
    facts = {
        **run_facts("Albedo under a sky", "albedo", medium, begun, seed, threads),
        **sky_facts(light),
        "max_stderr": max_stderr,
    }
    facts |= {f"band_{name}_sha256": one.sha256 for name, one in named.items() if one.sha256}
    spectrum = xr.Dataset(variables, {"wavelength": wavelength_axis(w)}, facts)
    about = {"long_name": "part of the light that comes straight from the sun", "units": "1"}
    spectrum["direct_share"] = ("wavelength", light.direct_share(w), about)
    return spectrum.assign(_over_bands(spectrum, light, named)).assign_coords(band=list(named))


def _over_bands(spectrum: xr.Dataset, light: Sky, bands: Mapping[str, Band]) -> dict[str, Any]:
    """Return the albedo of every band, its error, and how much of the band's light is known."""
    w = spectrum.wavelength.values
    value, error, covered = [], [], []
    for band in bands.values():
        weights = light.weights(w, band)
        all_light = light.weights(light.wavelength_nm, band).sum()
        normal = xr.DataArray(weights / weights.sum(), {"wavelength": w}, ("wavelength",))
        value.append(float((normal * spectrum.albedo).sum()))
        error.append(float(weighted_error(spectrum, "albedo", normal)))
        covered.append(weights.sum() / all_light)
    label = "albedo over a band, weighted by irradiance"
    found: dict[str, Any] = quantity("band_albedo", "band", np.array(value), np.array(error), label)
    about = {"long_name": "part of the band's light within the wavelengths", "units": "1"}
    return found | {"irradiance_covered": ("band", np.array(covered), about)}
