"""What a user describes: media, turned into numbers for the kernels."""

from splits.media.granular import GranularMedium
from splits.media.layer import Layer
from splits.media.readings import Readings, SandReadings
from splits.media.rough_surface import RoughSurface
from splits.media.sand import Sand
from splits.media.snow import Snow
from splits.media.stack import Stack

__all__ = [
    "GranularMedium",
    "Layer",
    "Readings",
    "RoughSurface",
    "Sand",
    "SandReadings",
    "Snow",
    "Stack",
]
