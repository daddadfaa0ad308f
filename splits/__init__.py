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

from typing import Any

import lazy_loader

# Modules of public names, as listed in __init__.pyi, are imported on first use, so that plotting
# does not import the kernels.
_load_name, _list_names, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __dir__() -> list[str]:
    """Return the public names, with all instruments."""
    from splits.core.discovery import list_instrument_names

    return sorted({*_list_names(), *list_instrument_names()})


def __getattr__(name: str) -> Any:
    """Return a public name or an instrument; the message for an unknown one suggests the nearest.

    Instruments are found by their files, so that the stub need not list a new one.
    """
    try:
        return _load_name(name)
    except AttributeError as error:
        if name in __all__:
            raise
        from splits.core.discovery import is_instrument, load_instrument
        from splits.core.validation import suggest_name

        if is_instrument(name):
            return load_instrument(name)
        hint = suggest_name(name, __dir__())
        message = f"module 'splits' has no attribute {name!r}" + (f" ({hint})" if hint else "")
        raise AttributeError(message, name=name) from error
