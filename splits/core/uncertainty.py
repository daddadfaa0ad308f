"""Values with their standard errors: as variables of a dataset, and from groups of rays.

Errors of what combines several wavelengths of one spectrum.

A spectrophotometer traces paths at a few refractive indices.  Errors of wavelengths that draw on
the same paths go together, those of others do not, so neither rule serves for a whole spectrum.
Each dataset therefore carries how far `splits.simulation.tally.GROUPS` groups of its rays take
every wavelength off (``…_batches``).  What is linear in the spectrum deviates by group alike, and
the squares of its deviations add up to its variance.  What the standard error holds beyond that
bounds what interpolation between refractive indices misses.  Neighbours miss alike, wavelengths far
apart do not: bounds add up along each stretch of weights of one sign, and stretches in quadrature.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from splits.core.arrays import check_no_gaps, find_labels, match_labels
from splits.core.validation import check_choice, invalid

Variable = tuple[str | tuple[str, ...], np.ndarray, dict[str, str]]
"""Dimensions, values and attributes, as `xarray.Dataset` takes them."""


def make_variable(
    name: str,
    dims: str | tuple[str, ...],
    values: np.ndarray,
    stderr: np.ndarray | None,
    long_name: str,
    units: str = "1",
) -> dict[str, Variable]:
    """Return a variable and, unless it is None, its standard error ``…_stderr``, by name."""
    about = {"long_name": long_name, "units": units}
    if stderr is None:
        return {name: (dims, values, about)}
    error = f"{name}_stderr"
    return {
        name: (dims, values, {**about, "ancillary_variables": error}),
        error: (dims, stderr, {**about, "long_name": f"standard error of {long_name}"}),
    }


def make_deviation_variable(
    name: str, dims: str | tuple[str, ...], deviations: np.ndarray, long_name: str
) -> dict[str, Variable]:
    """Return how far groups of rays take a quantity off, ``…_batches``, by name.

    Parameters
    ----------
    name, dims, long_name
        Of the quantity.
    deviations : float, shape (groups, ...)
        Stored in single precision.
    """
    dims = (dims,) if isinstance(dims, str) else dims
    about = {
        "long_name": f"deviation of {long_name} by batch of rays",
        "units": "1",
        "comment": "sums over groups of products are covariances, without what stands for "
        "interpolation between refractive indices in the standard error",
    }
    return {f"{name}_batches": (("batch", *dims), deviations.astype(np.float32), about)}


def compute_batch_stderr(batch_means: np.ndarray) -> np.ndarray:
    """Return the standard error of the mean of groups of rays."""
    return batch_means.std(axis=0, ddof=1) / np.sqrt(len(batch_means))


def compute_leave_one_out_means(batch_means: np.ndarray) -> np.ndarray:
    """Return the means over all groups but one, the groups along the first axis."""
    return (batch_means.sum(axis=0) - batch_means) / (len(batch_means) - 1)


def compute_jackknife_stderr(leave_one_out: np.ndarray) -> np.ndarray:
    """Return the standard error of what was computed from all groups but one (Efron 1982)."""
    n = len(leave_one_out)
    return np.sqrt((n - 1) / n * ((leave_one_out - leave_one_out.mean(axis=0)) ** 2).sum(axis=0))


_VARIANCE_ROUNDING = 1e-6
"""Part of a variance that deviations in single precision may miss."""


def compute_weighted_error(
    dataset: xr.Dataset, quantity: str, weights: xr.DataArray
) -> xr.DataArray:
    """Return the standard error of a weighted sum of a spectrum.

    Parameters
    ----------
    dataset, quantity, weights
        As for `compute_error_parts`.

    Returns
    -------
    xarray.DataArray
        Over all other dimensions: both parts, added in quadrature.
    """
    scatter, missed = compute_error_parts(dataset, quantity, weights)
    return (scatter**2 + missed**2) ** 0.5


def compute_error_parts(
    dataset: xr.Dataset, quantity: str, weights: xr.DataArray
) -> tuple[xr.DataArray, xr.DataArray]:
    """Return how a weighted sum of a spectrum scatters, and a bound on what it misses besides.

    Parameters
    ----------
    dataset : xarray.Dataset
        The quantity's ``_stderr`` over ``wavelength`` and any other dimensions, and its
        ``_batches`` over ``batch`` besides.  Without those, as in datasets of earlier versions,
        the scatter is an upper bound: the sum of errors times sizes of weights.
    quantity : str
        Such as ``reflectance``.
    weights : xarray.DataArray
        Over ``wavelength`` and any other dimensions; of any sign.

    Returns
    -------
    scatter, missed : xarray.DataArray
        Over all other dimensions: one standard deviation between runs with other seeds, and how
        much interpolation between refractive indices may miss.  NaN where an error that counts is
        unknown.
    """
    stderr = dataset[f"{quantity}_stderr"]
    weights = _align_weights(weights, dataset)
    if f"{quantity}_batches" not in dataset:
        most = _sum_weighted(abs(weights), stderr)
        return most, xr.zeros_like(most)
    groups = dataset[f"{quantity}_batches"].astype(float)
    rest = stderr**2 - (groups**2).sum("batch", skipna=False)
    bound = rest.where(~(rest <= _VARIANCE_ROUNDING * stderr**2), 0.0) ** 0.5
    scatter = (_sum_weighted(weights, groups) ** 2).sum("batch", skipna=False) ** 0.5
    weighed = (abs(weights) * bound).where(weights != 0.0, 0.0)
    missed = xr.apply_ufunc(
        _sum_same_sign_intervals,
        *xr.broadcast(weights, weighed),
        input_core_dims=[["wavelength"]] * 2,
    )
    return scatter, missed


def compute_difference(
    dataset: xr.Dataset, quantity: str, one: str, other: str, dim: str = "medium"
) -> tuple[xr.DataArray, xr.DataArray]:
    """Return by how much one medium exceeds another that shares its paths, and the error of that.

    What they scatter by is largely the same and cancels, group by group.  Interpolation between
    refractive indices is the same as well: of what it may miss, the difference counts.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of `splits.spectrophotometer` or `splits.albedo` with several media.
    quantity : str
        Such as ``reflectance`` or ``band_albedo``, with its ``_stderr`` and ``_batches``.
    one, other : str
        Labels along `dim`.
    dim : str

    Returns
    -------
    difference, stderr : xarray.DataArray
        Over all other dimensions.

    Raises
    ------
    ValueError
        For a label that is not there, or a dataset without groups.
    """
    if f"{quantity}_batches" not in dataset:
        raise invalid("quantity", quantity, "one with groups of rays", "such as reflectance")
    labels = [str(label) for label in np.atleast_1d(dataset[dim].values)]
    parts = [
        dataset.sel({dim: check_choice(key, label, labels)}, drop=True)
        for key, label in (("one", one), ("other", other))
    ]
    groups = [part[f"{quantity}_batches"].astype(float) for part in parts]
    bounds = [
        np.maximum(part[f"{quantity}_stderr"] ** 2 - (found**2).sum("batch"), 0.0) ** 0.5
        for part, found in zip(parts, groups, strict=True)
    ]
    scatter = ((groups[0] - groups[1]) ** 2).sum("batch")
    stderr = (scatter + (bounds[0] - bounds[1]) ** 2) ** 0.5
    return (parts[0][quantity] - parts[1][quantity]).drop_attrs(), stderr.drop_attrs()


def _align_weights(weights: xr.DataArray, dataset: xr.Dataset) -> xr.DataArray:
    """Return weights in the order of a dataset's wavelengths, or refuse those of others."""
    check_no_gaps("weights", weights)
    axis = weights.get_axis_num("wavelength")
    places = match_labels("weights", find_labels(weights, axis), [dataset.wavelength])
    return weights.isel(wavelength=places)


def _sum_same_sign_intervals(weights: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return sums of parts over stretches of one sign along the last axis, added in quadrature."""
    places = np.where(weights != 0.0, np.arange(weights.shape[-1]), 0)
    signs = np.sign(np.take_along_axis(weights, np.maximum.accumulate(places, axis=-1), axis=-1))
    stretch = np.cumsum(np.diff(signs, axis=-1, prepend=signs[..., :1]) != 0.0, axis=-1)
    total = np.zeros(parts.shape[:-1])
    for number in range(int(stretch.max()) + 1):
        total += np.where(stretch == number, parts, 0.0).sum(axis=-1) ** 2
    return np.sqrt(total)


def _sum_weighted(weights: xr.DataArray, values: xr.DataArray) -> xr.DataArray:
    """Return a weighted sum over wavelength, unknown if a value is that counts."""
    return (weights * values).where(weights != 0.0, 0.0).sum("wavelength", skipna=False)


def make_band_weights(dataset: xr.Dataset, low: float, high: float) -> xr.DataArray:
    """Return the weights over wavelength that make a sum the mean over a band (nm).

    Raises
    ------
    ValueError
        If the dataset has no wavelength there.
    """
    inside = (dataset.wavelength >= low) & (dataset.wavelength <= high)
    if not inside.any():
        ends = " to ".join(f"{end:g}" for end in dataset.wavelength.values[[0, -1]])
        raise invalid("wavelength", f"{ends} nm", f"some in {low:g} to {high:g} nm")
    weights = inside / inside.sum()
    weights.attrs.clear()  # those of wavelengths are not those of errors
    return weights


def compute_band_error(dataset: xr.Dataset, quantity: str, low: float, high: float) -> xr.DataArray:
    """Return the standard error of the mean of a quantity over a band (nm)."""
    return compute_weighted_error(dataset, quantity, make_band_weights(dataset, low, high))
