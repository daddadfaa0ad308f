"""Virtual instruments: run the kernels until the error asked for, estimate, label."""

from splits.instruments.beam_spread import beam_spread
from splits.instruments.deep_transmittance import deep_transmittance
from splits.instruments.goniophotometer import goniophotometer
from splits.instruments.lens import lens
from splits.instruments.irradiance_profile import irradiance_profile
from splits.core.progress import Progress, ProgressBar
from splits.instruments.single_scattering import single_scattering
from splits.instruments.spectra import spectra
from splits.instruments.spectrophotometer import spectrophotometer
from splits.instruments.surface_map import surface_map

__all__ = [
    "Progress",
    "ProgressBar",
    "bssrdf",
    "deep_transmittance",
    "goniophotometer",
    "lens",
    "profile",
    "single_scattering",
    "spectra",
    "spectrophotometer",
    "surface_map",
]
