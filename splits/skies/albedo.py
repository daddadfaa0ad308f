"""Albedos under a sky: by wavelength, and over bands, with errors that go together as they do."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.analysis.errors import weighted_error
from splits.checks import in_range, known_arguments, numbers, refuse
from splits.instruments import spectrophotometer
from splits.instruments.arguments import check_threads, check_wavelengths, check_whole
from splits.instruments.labels import run_facts, wavelength_axis
from splits.media.turbid import Medium
from splits.skies.irradiance import Sky, sky
from splits.uncertainty import deviations, quantity

STEP_NM = 10.0
LAST_NM = 2495.0
"""Wavelengths by default end where less than a hundredth of sunlight is left."""
ALL = "broadband"


@known_arguments
def albedo(
    medium: Medium,
    sky: Sky | str | Mapping[str, Any],
    wavelength_nm: Any = None,
    max_stderr: float = 0.005,
    seed: int = 1,
    *,
    bands: Mapping[str, tuple[float, float]] | None = None,
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
    bands : mapping, optional
        Names of bands to their ends (nm): ``{"visible": (305, 700)}``.
    threads : int, optional
        Default: every CPU this process may use.

    Returns
    -------
    xarray.Dataset
        ``albedo`` and its error ``albedo_stderr`` over ``wavelength``, with ``albedo_groups`` for
        what combines wavelengths; ``direct_share`` of the light; and over ``band``, the first of
        which is "broadband", ``band_albedo`` with ``band_albedo_stderr``, weighted by irradiance,
        and ``irradiance_covered``, the part of the band's light within the wavelengths.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths that the sky does not have.
    """
    begun = time.perf_counter()
    light = sky if isinstance(sky, Sky) else _sky(sky)
    first = float(light.wavelength_nm[0])
    last = min(LAST_NM, float(light.wavelength_nm[-1]))
    asked = np.arange(first, last + 0.5, STEP_NM) if wavelength_nm is None else wavelength_nm
    w = check_wavelengths(asked)
    if w.size < 2:
        raise refuse("wavelength_nm", w.tolist(), "at least two wavelengths")
    light.check_covers(w)
    max_stderr = in_range("max_stderr", max_stderr, 1e-6, 0.5)
    seed, threads = check_whole("seed", seed, 0), check_threads(threads)
    ends = _bands(bands, light)
    share = light.direct_share(w)
    found = _mixed(medium, light, w, share, (max_stderr, seed, threads))
    variables = quantity("albedo", "wavelength", *found[:2], "albedo under this sky")
    variables |= deviations("albedo", "wavelength", found[2], "albedo under this sky")
    about = {"long_name": "part of the light that comes straight from the sun", "units": "1"}
    facts = {
        **run_facts("Albedo under a sky", "albedo", medium, begun, seed, threads),
        "sky": light.name,
        "sky_source": light.source,
        "zenith_deg": light.zenith_deg,
        "max_stderr": max_stderr,
    }
    if light.sha256:
        facts["sky_sha256"] = light.sha256
    coordinates = {"wavelength": wavelength_axis(w)}
    spectrum = xr.Dataset(variables, coordinates, facts)
    spectrum["direct_share"] = ("wavelength", share, about)
    return spectrum.assign(_over_bands(spectrum, light, ends)).assign_coords(band=list(ends))


_sky = sky


def _bands(
    bands: Mapping[str, tuple[float, float]] | None, light: Sky
) -> dict[str, tuple[float, float]]:
    """Return the ends of all bands, or refuse them."""
    found = {ALL: (float(light.wavelength_nm[0]), float(light.wavelength_nm[-1]))}
    for name, ends in (bands or {}).items():
        low, high = numbers(f"bands.{name}", ends, ("low", "high"))
        if not 0.0 < low < high:
            raise refuse(f"bands.{name}", ends, "0 < low < high (nm)")
        found[str(name)] = (low, high)
    return found


def _mixed(
    medium: Medium, light: Sky, w: np.ndarray, share: np.ndarray, how: tuple[float, int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the albedo, its standard error and deviations by group of rays."""
    max_stderr, seed, threads = how
    value, square = np.zeros_like(w), np.zeros_like(w)
    groups = []
    ways: list[tuple[np.ndarray, float | str]] = [
        (share, light.zenith_deg),
        (1.0 - share, "diffuse"),
    ]
    for number, (part, incidence) in enumerate(ways):
        if not part.any():
            continue
        run = spectrophotometer(medium, w, incidence, max_stderr, seed + number, threads=threads)
        value += part * run.reflectance.values
        square += (part * run.reflectance_stderr.values) ** 2
        groups.append(part * run.reflectance_groups.values)
    # Rays of the sun and of the sky know nothing of each other.
    return value, np.sqrt(square), np.concatenate(groups)


def _over_bands(
    spectrum: xr.Dataset, light: Sky, bands: Mapping[str, tuple[float, float]]
) -> dict[str, Any]:
    """Return the albedo of every band, its error, and how much of the band's light is known."""
    w = spectrum.wavelength.values
    value, error, covered = [], [], []
    for name, (low, high) in bands.items():
        weights = light.weights(w, low, high)
        all_light = light.weights(light.wavelength_nm, low, high).sum()
        if not weights.any():
            allowed = f"bands with light between {w[0]:g} and {w[-1]:g} nm"
            raise refuse(f"bands.{name}", (low, high), allowed)
        normal = xr.DataArray(weights / weights.sum(), {"wavelength": w}, ("wavelength",))
        value.append(float((normal * spectrum.albedo).sum()))
        error.append(float(weighted_error(spectrum, "albedo", normal)))
        covered.append(weights.sum() / all_light)
    label = "albedo over a band, weighted by irradiance"
    found: dict[str, Any] = quantity("band_albedo", "band", np.array(value), np.array(error), label)
    about = {"long_name": "part of the band's light within the wavelengths", "units": "1"}
    return found | {"irradiance_covered": ("band", np.array(covered), about)}
