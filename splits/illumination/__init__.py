"""Illumination: spectral irradiance of skies, and spectral bands of sensors."""

from splits.illumination.bands import sensor_bands
from splits.illumination.sky import Sky, sky

__all__ = [
    "Sky",
    "sensor_bands",
    "sky",
]
