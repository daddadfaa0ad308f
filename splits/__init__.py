"""Light that snow, sand and rough layers send back.

A *medium* (`Snow`, `Sand`) under a virtual *instrument* (`spectrophotometer`) gives a labelled
dataset with standard errors.

Examples
--------
>>> import splits
>>> ds = splits.spectrophotometer(splits.Snow(), range(400, 2501, 10), max_stderr=0.01)
>>> bool(ds.reflectance.sel(wavelength=500) > 0.9)
True
"""

from splits.dataset import load, save
from splits.instruments import deep_transmittance, single_scattering, spectrophotometer
from splits.media import Readings, Sand, SandReadings, Snow

__all__ = [
    "Readings",
    "Sand",
    "SandReadings",
    "Snow",
    "deep_transmittance",
    "load",
    "save",
    "single_scattering",
    "spectrophotometer",
]
