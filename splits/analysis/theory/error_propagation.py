"""Propagation of errors of single-scattering properties to the results of a theory."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import xarray as xr

from splits.core.uncertainty import compute_jackknife_stderr

JACKKNIFE_SUFFIX, BOUND_SUFFIX = "_jackknife", "_interpolation_bound"
"""Suffixes of the variables of `splits.instruments.single_scattering` for errors."""

TheoryFunction = Callable[[xr.Dataset], np.ndarray]
"""Function from optics to an array with wavelengths along the last axis."""


def propagate_errors(theory: TheoryFunction, optics: xr.Dataset) -> np.ndarray:
    """Return the standard error of a theory's results due to errors of its optics.

    The theory is applied to the optics with each batch of rays left out in turn (jackknife), which
    includes the correlations of albedo, moments and displacements.  The bound from interpolation
    between refractive indices is added.

    Parameters
    ----------
    theory : callable
        From a dataset like `optics` to float[…, wavelengths].
    optics : xarray.Dataset
        From `splits.instruments.single_scattering`; without ``…_jackknife`` and
        ``…_interpolation_bound`` it is assumed exact.

    References
    ----------
    Efron (1982), The Jackknife, the Bootstrap and Other Resampling Plans, chapter 3.
    """
    parts = compute_jackknife_results(theory, optics)
    statistical = 0.0 if parts is None else compute_jackknife_stderr(parts)
    return np.hypot(statistical, compute_interpolation_bound(theory, optics))


def compute_jackknife_results(theory: TheoryFunction, optics: xr.Dataset) -> np.ndarray | None:
    """Return a theory's results with each batch of rays left out, or None without batches."""
    values = [theory(variant) for variant in _iterate_jackknife_optics(optics)]
    return np.stack(values) if values else None


def compute_interpolation_bound(theory: TheoryFunction, optics: xr.Dataset) -> np.ndarray:
    """Return the bound on the error of a theory's results due to interpolation of the optics.

    The absolute effects of the errors of all optical quantities are added, which is a bound if the
    results depend linearly on them.
    """
    if not _list_names_with_suffix(optics, BOUND_SUFFIX):
        return np.zeros(optics.sizes["wavelength"])
    result = theory(optics)
    bound = np.zeros_like(result)
    for name in _list_names_with_suffix(optics, BOUND_SUFFIX):
        if name in optics:
            for error in _iterate_components(optics[name + BOUND_SUFFIX]):
                bound += np.abs(theory(optics.assign({name: optics[name] - error})) - result)
    return bound


def _iterate_components(bound: xr.DataArray) -> Iterator[xr.DataArray]:
    """Yield a bound with a single order each, all others 0, since wavelengths are independent."""
    order_dims = [dim for dim in bound.dims if dim != "wavelength"]
    for index in np.ndindex(*(bound.sizes[dim] for dim in order_dims)):
        selection = dict(zip(order_dims, index, strict=True))
        if bound[selection].values.any():
            component = xr.zeros_like(bound)
            component[selection] = bound[selection]
            yield component


def _iterate_jackknife_optics(optics: xr.Dataset) -> Iterator[xr.Dataset]:
    """Yield the optics with each batch of rays left out in turn."""
    names = _list_names_with_suffix(optics, JACKKNIFE_SUFFIX)
    for batch in range(optics.sizes["batch"] if names else 0):
        yield optics.assign(
            {name: optics[name + JACKKNIFE_SUFFIX].isel(batch=batch) for name in names}
        )


def _list_names_with_suffix(optics: xr.Dataset, suffix: str) -> list[str]:
    return [
        str(name).removesuffix(suffix) for name in optics.data_vars if str(name).endswith(suffix)
    ]
