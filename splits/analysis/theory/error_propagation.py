"""What errors of single-scattering properties make of a theory's results."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import xarray as xr

from splits.core.uncertainty import compute_jackknife_stderr

JACKKNIFE_SUFFIX, BOUND_SUFFIX = "_jackknife", "_interpolation_bound"
"""How names end of what `splits.instruments.single_scattering` tells of errors."""

TheoryFunction = Callable[[xr.Dataset], np.ndarray]
"""From optics to numbers, the wavelengths along the last axis."""


def propagate_errors(theory: TheoryFunction, optics: xr.Dataset) -> np.ndarray:
    """Return the standard error that a theory's results have from their optics.

    The theory is applied to the optics without one part of the rays after the other: the jackknife,
    which knows how the errors of albedo, moments and displacements go together.  What interpolation
    between refractive indices may miss of each of them is added as it comes through.

    Parameters
    ----------
    theory : callable
        From a dataset like `optics` to float[…, wavelengths].
    optics : xarray.Dataset
        From `splits.instruments.single_scattering`; without ``…_jackknife`` and
        ``…_interpolation_bound``, it is taken for exact.

    References
    ----------
    Efron (1982), The Jackknife, the Bootstrap and Other Resampling Plans, chapter 3.
    """
    parts = compute_jackknife_results(theory, optics)
    statistical = 0.0 if parts is None else compute_jackknife_stderr(parts)
    return np.hypot(statistical, compute_interpolation_bound(theory, optics))


def compute_jackknife_results(theory: TheoryFunction, optics: xr.Dataset) -> np.ndarray | None:
    """Return a theory's results without one part of the rays each, None without such parts."""
    values = [theory(one) for one in _iterate_jackknife_optics(optics)]
    return np.stack(values) if values else None


def compute_interpolation_bound(theory: TheoryFunction, optics: xr.Dataset) -> np.ndarray:
    """Return the bound on what interpolation of the optics may miss of a theory's results.

    Every number of the optics may be off by itself, either way: what each does to the results is
    added up in size, which is a bound as far as results respond in proportion.
    """
    whole = theory(optics)
    bound = np.zeros_like(whole)
    for name in _list_names_with_suffix(optics, BOUND_SUFFIX):
        if name in optics:
            for off in _iterate_components(optics[name + BOUND_SUFFIX]):
                bound += np.abs(theory(optics.assign({name: optics[name] - off})) - whole)
    return bound


def _iterate_components(bound: xr.DataArray) -> Iterator[xr.DataArray]:
    """Yield it with one order after the other, all others 0; results know one wavelength each."""
    along = [dim for dim in bound.dims if dim != "wavelength"]
    for place in np.ndindex(*(bound.sizes[dim] for dim in along)):
        one = dict(zip(along, place, strict=True))
        if bound[one].values.any():
            off = xr.zeros_like(bound)
            off[one] = bound[one]
            yield off


def _iterate_jackknife_optics(optics: xr.Dataset) -> Iterator[xr.Dataset]:
    """Yield the optics as they are without one part of the rays after the other."""
    names = _list_names_with_suffix(optics, JACKKNIFE_SUFFIX)
    for part in range(optics.sizes["batch"] if names else 0):
        yield optics.assign({n: optics[n + JACKKNIFE_SUFFIX].isel(batch=part) for n in names})


def _list_names_with_suffix(optics: xr.Dataset, suffix: str) -> list[str]:
    return [
        str(name).removesuffix(suffix) for name in optics.data_vars if str(name).endswith(suffix)
    ]
