"""Light that snow, sand and rough layers send back.

A *medium* (`Snow`, `Sand`, `Layer`) under a virtual *instrument* (`spectrophotometer`,
`goniophotometer`, `bssrdf`, …) gives a labelled dataset with standard errors.

Examples
--------
>>> import splits
>>> ds = splits.spectrophotometer(splits.Snow(), range(400, 2501, 10), max_stderr=0.01)
>>> bool(ds.reflectance.sel(wavelength=500) > 0.9)
True
"""

import lazy_loader

# Drawing a figure needs no kernels: a public name loads its module, as listed in __init__.pyi,
# when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
