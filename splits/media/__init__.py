"""Media: snow, sand, particle layers, rough surfaces and stacks of them."""

from splits.media.interpretations import Interpretation, SandInterpretation
from splits.media.medium import GranularMedium
from splits.media.particle_layer import ParticleLayer
from splits.media.rough_surface import RoughSurface
from splits.media.sand import Sand
from splits.media.snow import Snow
from splits.media.stack import Stack

__all__ = [
    "GranularMedium",
    "Interpretation",
    "ParticleLayer",
    "RoughSurface",
    "Sand",
    "SandInterpretation",
    "Snow",
    "Stack",
]
