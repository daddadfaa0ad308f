"""Light from the sky: spectral irradiances, and what a sample makes of them."""

from splits.skies.albedo import albedo
from splits.skies.irradiance import Sky, sky

__all__ = ["Sky", "albedo", "sky"]
