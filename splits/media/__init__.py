"""What a user describes: media, turned into numbers for the kernels."""

from splits.media.granular import GranularMedium
from splits.media.readings import Readings, SandReadings
from splits.media.sand import Sand
from splits.media.snow import Snow

__all__ = ["GranularMedium", "Readings", "Sand", "SandReadings", "Snow"]
