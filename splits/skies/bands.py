"""Bands of sensors: by their ends, or by how a sensor responds to each wavelength."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splits.arrays import increasing, numbers, read_columns
from splits.checks import known_arguments, listed, name_as_texts, one_of, refuse, snap_to_ends
from splits.equality import ByContent
from splits.extras import optional
from splits.materials.tables import columns_of, user_table

COLUMNS = ("wavelength_nm", "response")
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
class Band(ByContent):
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
    def from_limits(cls, low: float, high: float) -> Band:
        """Return the band in which all light counts alike, from low to high (nm)."""
        return cls(np.array([low, high]), np.ones(2))

    @classmethod
    def from_input(cls, key: str, value: Any) -> Band:
        """Return the band that a user's value stands for, or refuse it.

        Parameters
        ----------
        key : str
            For messages.
        given : (float, float), mapping or path
            Its ends (nm), or a mapping of ``wavelength_nm`` and ``response``, or the path of a CSV
            file with these columns.

        Raises
        ------
        ValueError
            For a malformed band.
        """
        digest, value = "", columns_of(value)
        if isinstance(value, str | Path):
            columns, digest = user_table(key, value, COLUMNS)
        elif isinstance(value, Mapping):
            if set(value) != set(COLUMNS):
                allowed = "its ends (nm), or a mapping of " + ", ".join(COLUMNS)
                raise refuse(key, sorted(map(str, value)), allowed)
            columns = [value[name] for name in COLUMNS]
        else:
            low, high = numbers(key, value, ("low", "high"))
            if not 0.0 < low < high:
                raise refuse(key, value, "0 < low < high (nm)")
            return cls.from_limits(low, high)
        w, response = read_columns(key, dict(zip(COLUMNS, columns, strict=True)))
        increasing(f"{key}.wavelength_nm", w)
        if not w.size == response.size >= 2:
            found = f"{w.size} wavelengths, {response.size} responses"
            raise refuse(key, found, "two lists of the same length, at least 2")
        response = snap_to_ends(response, 0.0, np.inf)
        if response.min() < 0.0 or not response.any():
            raise refuse(
                f"{key}.response", float(response.min()), "at least 0, and not 0 everywhere"
            )
        return cls(w, response, digest)

    def __repr__(self) -> str:
        """Return the band on one line."""
        return f"Band({self.limits_nm[0]:g} to {self.limits_nm[1]:g} nm)"

    @property
    def limits_nm(self) -> tuple[float, float]:
        """First and last wavelength (nm)."""
        return float(self.wavelength_nm[0]), float(self.wavelength_nm[-1])


@known_arguments
def sensor(name: str) -> dict[str, dict[str, np.ndarray]]:
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
    >>> bands = splits.sensor("sentinel_2a")
    >>> green = bands["sentinel_2a_3"]
    >>> round(float(green["wavelength_nm"][green["response"].argmax()]))
    560
    """
    one_of("sensor", name, SENSORS)
    rsr = optional("pyrsr", "sky", "bands of sensors need").RSR
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


def bands_of(bands: Any) -> dict[str, Band]:
    """Return all bands that a user names, or refuse them."""
    if bands is None:
        return {}
    if isinstance(bands, str):
        one_of("bands", bands, SENSORS)
        bands = sensor(bands)
    if not isinstance(bands, Mapping):
        allowed = "a mapping of names to bands, or one of " + listed(SENSORS)
        raise refuse("bands", bands, allowed)
    named = name_as_texts("bands", bands)
    return {name: Band.from_input(f"bands.{name}", band) for name, band in named.items()}
