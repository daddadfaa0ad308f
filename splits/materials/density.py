"""Densities of ice and minerals."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from splits.core.validation import check_range

_ICE_TEMPERATURE_C = np.array([-40.0, -30.0, -20.0, -10.0, 0.0])
_ICE_DENSITY_KG_M3 = np.array([922.8, 921.6, 920.3, 918.7, 916.7])

MINERAL_DENSITY_KG_M3: Mapping[str, float] = MappingProxyType(
    {
        "quartz": 2650.0,
        "hematite": 5250.0,
        "goethite": 4300.0,
        "magnetite": 5200.0,
        "kaolinite": 2590.0,
    }
)
"""Densities of minerals (kg/m³), SPLITS (Kimmel & Baranoski 2007) Table 2."""


def ice_density(temperature_c: float) -> float:
    """Return the density of ice (kg/m³), linear between tabulated temperatures.

    Parameters
    ----------
    temperature_c : float
        Temperature (°C), −40 to 0.

    Raises
    ------
    ValueError
        For a temperature outside the table.

    References
    ----------
    CRC Handbook of Chemistry and Physics (Rumble 2019), as used in SPLITSnow appendix A.
    """
    temperature_c = check_range("temperature_c", temperature_c, -40.0, 0.0, "degrees Celsius")
    return float(interpolate_ice_density(temperature_c))


def interpolate_ice_density(temperature_c: np.ndarray | float) -> np.ndarray:
    """Return the density of ice (kg/m³) at temperatures (°C), those of `ice_density`, unchecked.

    Beyond −40 and 0 °C it is that of the nearer limit; NaN gives NaN.
    """
    return np.asarray(np.interp(temperature_c, _ICE_TEMPERATURE_C, _ICE_DENSITY_KG_M3))
