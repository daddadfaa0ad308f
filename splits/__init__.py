"""Monte Carlo reflectance and transmittance of snow, sand and rough particle layers.

A virtual *instrument* (`spectrophotometer`, `goniophotometer`, `beam_spread`, …) measures a
*medium* (`Snow`, `Sand`, `ParticleLayer`, `Stack`) and returns a labelled dataset with standard
errors.

Examples
--------
>>> import splits
>>> ds = splits.spectrophotometer(splits.Snow(), range(400, 2501, 10), max_stderr=0.01)
>>> bool(ds.reflectance.sel(wavelength=500) > 0.9)
True
"""

import lazy_loader

# Modules of public names, as listed in __init__.pyi, are imported on first use, so that plotting
# does not import the kernels.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
