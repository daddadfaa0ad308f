"""Bands of sensors: tables of pyrsr, and Gaussian responses of published centres and widths."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from splits.core.keywords import reject_unknown_arguments
from splits.core.optional import import_optional
from splits.core.validation import check_choice
from splits.materials.csv_table import read_csv

PYRSR_SENSORS = {
    "landsat_5": ("Landsat-5", "TM"),
    "landsat_7": ("Landsat-7", "ETM+"),
    "landsat_8": ("Landsat-8", "OLI_TIRS"),
    "landsat_9": ("Landsat-9", "OLI_TIRS"),
    "modis_aqua": ("Aqua", "MODIS"),
    "modis_terra": ("Terra", "MODIS"),
    "sentinel_2a": ("Sentinel-2A", "MSI"),
    "sentinel_2b": ("Sentinel-2B", "MSI"),
}
"""Satellite and instrument of every sensor whose responses are those of pyrsr."""
GAUSSIAN_SENSORS = (
    "emit",
    "enmap",
    "olci_sentinel_3a",
    "prisma",
    "slstr_sentinel_3a",
    "viirs_suomi_npp",
)
"""Sensors whose responses are Gaussian, with the centres and widths of sensors.csv."""
SENSORS = tuple(sorted((*PYRSR_SENSORS, *GAUSSIAN_SENSORS)))
HALF_RANGE_WIDTHS = 1.5
"""Range of a Gaussian response on either side of its centre, in widths; it is 1/512 at the ends."""
N_RESPONSE_POINTS = 37
_SENSORS_CSV = Path(__file__).with_name("sensors.csv")


@reject_unknown_arguments
def sensor_bands(name: str) -> dict[str, dict[str, np.ndarray]]:
    """Return the bands of a sensor in the form that `splits.albedo` takes.

    The responses of Landsat, MODIS and Sentinel-2 are the tables of pyrsr (extra ``sky``), which
    has bands 1 to 16 of MODIS.  The other sensors need no further package: their responses are
    Gaussian, with the centres and full widths at half maximum in ``illumination/sensors.csv``,
    which states the source of each.  Thermal bands are excluded.

    Parameters
    ----------
    name : str
        One of landsat_5, landsat_7, landsat_8, landsat_9, modis_aqua, modis_terra, sentinel_2a,
        sentinel_2b; or emit (285 bands), enmap (224), prisma (234), olci_sentinel_3a (Oa01 to
        Oa21), slstr_sentinel_3a (S1 to S6), viirs_suomi_npp (I1 to I3, M1 to M11).

    Returns
    -------
    dict
        By name, which consists of the sensor and the number of the band, so that bands of several
        sensors can be combined: ``wavelength_nm`` (nm) and ``response``, at most 1.

    Raises
    ------
    ValueError
        For an unknown sensor.
    ModuleNotFoundError
        Without pyrsr, for a sensor that needs it.

    Notes
    -----
    A Gaussian response is given at 37 wavelengths within 1.5 widths of the centre.  It is 0
    outside, where the Gaussian has 0.04 % of its area.  The measured responses of OLCI, SLSTR and
    VIIRS are closer to rectangles.  A Gaussian of the same width w (nm) has a larger variance, so
    that the mean of an albedo A over it differs by about 0.05 w² A'', where A'' is the second
    derivative with respect to wavelength.  The last VNIR bands of EnMAP and PRISMA overlap the
    first SWIR bands.  Centres and widths vary between scenes and across the swath.  For the
    analysis of a scene, use those of its metadata.

    Examples
    --------
    >>> import splits
    >>> bands = splits.sensor_bands("olci_sentinel_3a")
    >>> violet = bands["olci_sentinel_3a_Oa01"]
    >>> float(violet["wavelength_nm"][violet["response"].argmax()])
    400.0
    """
    check_choice("sensor", name, SENSORS)
    return _load_pyrsr_bands(name) if name in PYRSR_SENSORS else _make_gaussian_bands(name)


def _load_pyrsr_bands(name: str) -> dict[str, dict[str, np.ndarray]]:
    """Return the bands of a sensor from the tables of pyrsr."""
    rsr = import_optional("pyrsr", "sky", "bands of this sensor need").RSR
    spectral_response = rsr(*PYRSR_SENSORS[name], no_thermal=True)
    wavelengths = np.asarray(spectral_response.rsrs_wvl, dtype=float)
    bands = {}
    for label, response in spectral_response.rsrs_norm01.items():
        # From the last zero before the first response to the first after the last.
        first, last = np.flatnonzero(response > 0.0)[[0, -1]]
        support = slice(max(first - 1, 0), last + 2)
        bands[f"{name}_{label}"] = {
            "wavelength_nm": wavelengths[support],
            "response": response[support].clip(0.0, 1.0),
        }
    return bands


def _make_gaussian_bands(name: str) -> dict[str, dict[str, np.ndarray]]:
    """Return the bands of a sensor in the table of centres and widths."""
    table = load_band_centres()
    rows = table[table.sensor == name]
    offset_widths = np.linspace(-HALF_RANGE_WIDTHS, HALF_RANGE_WIDTHS, N_RESPONSE_POINTS)
    response = np.exp2(-4.0 * offset_widths**2)
    return {
        f"{name}_{row.band}": {
            "wavelength_nm": row.centre_nm + row.width_nm * offset_widths,
            "response": response.copy(),
        }
        for row in rows.itertuples()
    }


@cache
def load_band_centres() -> pd.DataFrame:
    """Return the table of Gaussian bands: sensor, band, centre_nm and width_nm (nm)."""
    table = read_csv("sensors", _SENSORS_CSV)
    columns: dict[str, Any] = {name: table.get_texts(name) for name in ("sensor", "band")}
    columns |= {name: table.get_numbers(name) for name in ("centre_nm", "width_nm")}
    return pd.DataFrame(columns)
