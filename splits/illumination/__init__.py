"""Illumination: spectral irradiance of skies, and spectral bands of sensors."""

from splits.illumination.sensors import sensor_bands
from splits.illumination.sky import Sky
from splits.illumination.sky_spectra import sky

__all__ = [
    "Sky",
    "sensor_bands",
    "sky",
]
