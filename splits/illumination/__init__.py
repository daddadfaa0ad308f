"""Light from the sky: spectral irradiances, and what a sample makes of them."""

from splits.instruments.albedo import albedo
from splits.illumination.bands import sensor_bands
from splits.instruments.hdrf import hdrf
from splits.instruments.radiation_profile import radiation_profile
from splits.illumination.sky import Sky, sky

__all__ = ["Sky", "albedo", "hdrf", "light_inside", "sensor", "sky"]
