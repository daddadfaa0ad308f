"""Virtual instruments: from a medium and its illumination to a labelled dataset with errors."""

from splits.instruments.albedo import albedo
from splits.instruments.beam_spread import beam_spread
from splits.instruments.goniophotometer import goniophotometer
from splits.instruments.hdrf import hdrf
from splits.instruments.irradiance_profile import irradiance_profile
from splits.instruments.lens import lens
from splits.instruments.radiation_profile import radiation_profile
from splits.instruments.single_scattering import single_scattering
from splits.instruments.spectrophotometer import spectrophotometer
from splits.instruments.surface_map import surface_map
from splits.instruments.time_of_flight import time_of_flight

__all__ = [
    "albedo",
    "beam_spread",
    "goniophotometer",
    "hdrf",
    "irradiance_profile",
    "lens",
    "radiation_profile",
    "single_scattering",
    "spectrophotometer",
    "surface_map",
    "time_of_flight",
]
