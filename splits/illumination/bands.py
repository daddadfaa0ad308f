"""Bands of sensors: by their ends, or by how a sensor responds to each wavelength."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splits.core.arrays import check_increasing, check_named_numbers, read_columns
from splits.core.equality import ContentEquality
from splits.core.optional import import_optional
from splits.core.validation import (
    check_choice,
    invalid,
    join_names,
    reject_unknown_arguments,
    snap_to_limits,
    to_text_keys,
)
from splits.materials.csv_table import read_user_table, to_columns

BAND_COLUMNS = ("wavelength_nm", "response")
SENSORS = {
    "landsat_5": ("Landsat-5", "TM"),
    "landsat_7": ("Landsat-7", "ETM+"),
    "landsat_8": ("Landsat-8", "OLI_TIRS"),
    "landsat_9": ("Landsat-9", "OLI_TIRS"),
    "modis_aqua": ("Aqua", "MODIS"),
    "modis_terra": ("Terra", "MODIS"),
    "sentinel_2a": ("Sentinel-2A", "MSI"),
    "sentinel_2b": ("Sentinel-2B", "MSI"),
}
"""Satellite and instrument of every sensor, as pyrsr calls them."""


@dataclass(frozen=True, eq=False, repr=False)
class SpectralBand(ContentEquality):
    """How much a sensor makes of light at each wavelength.

    Attributes
    ----------
    wavelength_nm : float, shape (n,)
        Strictly increasing (nm).
    response : float, shape (n,)
        Linear in between, nothing outside.
    sha256 : str
        Of a user's file.
    """

    wavelength_nm: np.ndarray
    response: np.ndarray
    sha256: str = ""

    @classmethod
    def from_limits(cls, low: float, high: float) -> SpectralBand:
        """Return the band in which all light counts alike, from low to high (nm)."""
        return cls(np.array([low, high]), np.ones(2))

    @classmethod
    def from_input(cls, key: str, value: Any) -> SpectralBand:
        """Return the band that a user's value stands for, or refuse it.

        Parameters
        ----------
        key : str
            For messages.
        value : (float, float), mapping or path
            Its ends (nm), or a mapping of ``wavelength_nm`` and ``response``, or the path of a CSV
            file with these columns.

        Raises
        ------
        ValueError
            For a malformed band.
        """
        digest, value = "", to_columns(value)
        if isinstance(value, str | Path):
            columns, digest = read_user_table(key, value, BAND_COLUMNS)
        elif isinstance(value, Mapping):
            if set(value) != set(BAND_COLUMNS):
                allowed = "its ends (nm), or a mapping of " + ", ".join(BAND_COLUMNS)
                raise invalid(key, sorted(map(str, value)), allowed)
            columns = [value[name] for name in BAND_COLUMNS]
        else:
            low, high = check_named_numbers(key, value, ("low", "high"))
            if not 0.0 < low < high:
                raise invalid(key, value, "0 < low < high (nm)")
            return cls.from_limits(low, high)
        w, response = read_columns(key, dict(zip(BAND_COLUMNS, columns, strict=True)))
        check_increasing(f"{key}.wavelength_nm", w)
        if not w.size == response.size >= 2:
            found = f"{w.size} wavelengths, {response.size} responses"
            raise invalid(key, found, "two lists of the same length, at least 2")
        response = snap_to_limits(response, 0.0, np.inf)
        if response.min() < 0.0 or not response.any():
            raise invalid(
                f"{key}.response", float(response.min()), "at least 0, and not 0 everywhere"
            )
        return cls(w, response, digest)

    def __repr__(self) -> str:
        """Return the band on one line."""
        return f"SpectralBand({self.limits_nm[0]:g} to {self.limits_nm[1]:g} nm)"

    @property
    def limits_nm(self) -> tuple[float, float]:
        """First and last wavelength (nm)."""
        return float(self.wavelength_nm[0]), float(self.wavelength_nm[-1])


@reject_unknown_arguments
def sensor_bands(name: str) -> dict[str, dict[str, np.ndarray]]:
    """Return the bands of a sensor, as `splits.albedo` takes them.

    The tables are those of pyrsr (extra ``sky``), which has bands 1 to 16 of MODIS.  Bands of
    thermal light are left out.

    Parameters
    ----------
    name : str
        One of landsat_5, landsat_7, landsat_8, landsat_9, modis_aqua, modis_terra, sentinel_2a,
        sentinel_2b.

    Returns
    -------
    dict
        By name, the sensor's and the number of its makers, so that bands of several sensors can
        stand together: ``wavelength_nm`` and ``response``, at most 1.

    Raises
    ------
    ValueError
        For an unknown sensor.
    ModuleNotFoundError
        Without pyrsr.

    Examples
    --------
    >>> import splits
    >>> bands = splits.sensor_bands("sentinel_2a")
    >>> green = bands["sentinel_2a_3"]
    >>> round(float(green["wavelength_nm"][green["response"].argmax()]))
    560
    """
    check_choice("sensor", name, SENSORS)
    rsr = import_optional("pyrsr", "sky", "bands of sensors need").RSR
    found = rsr(*SENSORS[name], no_thermal=True)
    w = np.asarray(found.rsrs_wvl, dtype=float)
    bands = {}
    for label, response in found.rsrs_norm01.items():
        # From the last zero before the first response to the first after the last.
        first, last = np.flatnonzero(response > 0.0)[[0, -1]]
        some = slice(max(first - 1, 0), last + 2)
        bands[f"{name}_{label}"] = {
            "wavelength_nm": w[some],
            "response": response[some].clip(0.0, 1.0),
        }
    return bands


def as_bands(bands: Any) -> dict[str, SpectralBand]:
    """Return all bands that a user names, or refuse them."""
    if bands is None:
        return {}
    if isinstance(bands, str):
        check_choice("bands", bands, SENSORS)
        bands = sensor_bands(bands)
    if not isinstance(bands, Mapping):
        allowed = "a mapping of names to bands, or one of " + join_names(SENSORS)
        raise invalid("bands", bands, allowed)
    named = to_text_keys("bands", bands)
    return {name: SpectralBand.from_input(f"bands.{name}", band) for name, band in named.items()}
