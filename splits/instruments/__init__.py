"""Virtual instruments: run the kernels until the error asked for, estimate, label."""

from splits.instruments.deep import deep_transmittance
from splits.instruments.runner import Progress
from splits.instruments.single_scattering import single_scattering
from splits.instruments.spectrophotometer import spectrophotometer

__all__ = ["Progress", "deep_transmittance", "single_scattering", "spectrophotometer"]
