"""Virtual instruments: from a medium and its illumination to a labelled dataset with errors."""

from splits.instruments.albedo import albedo, hdrf
from splits.instruments.beam_spread import beam_spread
from splits.instruments.goniophotometer import goniophotometer
from splits.instruments.profiles import irradiance_profile, radiation_profile
from splits.instruments.rough_surfaces import lens, surface_map
from splits.instruments.single_scattering import single_scattering
from splits.instruments.spectrophotometer import spectrophotometer
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
