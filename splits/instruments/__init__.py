"""Virtual instruments: run the kernels until the error asked for, estimate, label."""

from splits.instruments.bssrdf import bssrdf
from splits.instruments.deep import deep_transmittance
from splits.instruments.goniophotometer import goniophotometer
from splits.instruments.lens import lens
from splits.instruments.profile import profile
from splits.instruments.progress import Progress, ProgressBar
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
