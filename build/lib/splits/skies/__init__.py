"""Light from the sky: spectral irradiances, and what a sample makes of them."""

from splits.skies.albedo import albedo
from splits.skies.bands import sensor
from splits.skies.directional import hdrf
from splits.skies.heating import light_inside
from splits.skies.irradiance import Sky, sky

__all__ = ["Sky", "albedo", "hdrf", "light_inside", "sensor", "sky"]
