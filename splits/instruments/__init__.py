"""Virtual instruments: run the kernels until the error asked for, estimate, label."""

from splits.instruments.ensemble import Progress
from splits.instruments.spectrophotometer import spectrophotometer

__all__ = ["Progress", "spectrophotometer"]
