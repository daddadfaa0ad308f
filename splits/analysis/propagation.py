"""What errors of single-scattering properties make of a theory's results."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import xarray as xr

from splits.uncertainty import jackknife

LEFT_OUT, MISSED = "_left_out", "_missed"
"""How names end of what `splits.instruments.single_scattering` tells of errors."""

Theory = Callable[[xr.Dataset], np.ndarray]
"""From optics to numbers, the wavelengths along the last axis."""


def response(theory: Theory, optics: xr.Dataset) -> np.ndarray:
    """Return the standard error that a theory's results have from their optics.

    The theory is applied to the optics without one part of the rays after the other: the jackknife,
    which knows how the errors of albedo, moments and displacements go together.  What interpolation
    between refractive indices may miss of each of them is added as it comes through.

    Parameters
    ----------
    theory : callable
        From a dataset like `optics` to float[…, wavelengths].
    optics : xarray.Dataset
        From `splits.instruments.single_scattering`; without ``…_left_out`` and ``…_missed``, it is
        taken for exact.

    References
    ----------
    Efron (1982), The Jackknife, the Bootstrap and Other Resampling Plans, chapter 3.
    """
    parts = left_out(theory, optics)
    statistical = 0.0 if parts is None else jackknife(parts)
    return np.hypot(statistical, missed(theory, optics))


def left_out(theory: Theory, optics: xr.Dataset) -> np.ndarray | None:
    """Return a theory's results without one part of the rays each, None without such parts."""
    values = [theory(one) for one in _without_parts(optics)]
    return np.stack(values) if values else None


def missed(theory: Theory, optics: xr.Dataset) -> np.ndarray:
    """Return the bound on what interpolation of the optics may miss of a theory's results."""
    names = [name for name in _with(optics, MISSED) if name in optics]
    whole = theory(optics)
    moved = [
        theory(optics.assign({name: optics[name] - optics[name + MISSED]})) - whole
        for name in names
        if optics[name + MISSED].values.any()
    ]
    return np.sqrt(sum((np.square(one) for one in moved), start=np.zeros_like(whole)))


def _without_parts(optics: xr.Dataset) -> Iterator[xr.Dataset]:
    """Yield the optics as they are without one part of the rays after the other."""
    names = _with(optics, LEFT_OUT)
    for part in range(optics.sizes["part"] if names else 0):
        yield optics.assign({n: optics[n + LEFT_OUT].isel(part=part) for n in names})


def _with(optics: xr.Dataset, end: str) -> list[str]:
    return [str(name).removesuffix(end) for name in optics.data_vars if str(name).endswith(end)]
