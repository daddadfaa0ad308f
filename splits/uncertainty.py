"""Values with their standard errors: as variables of a dataset, and from groups of rays."""

from __future__ import annotations

import numpy as np

Variable = tuple[str | tuple[str, ...], np.ndarray, dict[str, str]]
"""Dimensions, values and attributes, as `xarray.Dataset` takes them."""


def quantity(
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


def deviations(
    name: str, dims: str | tuple[str, ...], deviations: np.ndarray, long_name: str
) -> dict[str, Variable]:
    """Return how far groups of rays take a quantity off, ``…_groups``, by name.

    Parameters
    ----------
    name, dims, long_name
        Of the quantity.
    groups : float, shape (groups, ...)
        Stored in single precision.
    """
    dims = (dims,) if isinstance(dims, str) else dims
    about = {
        "long_name": f"deviation of {long_name} by group of rays",
        "units": "1",
        "comment": "sums over groups of products are covariances, without what stands for "
        "interpolation between refractive indices in the standard error",
    }
    return {f"{name}_groups": (("group", *dims), deviations.astype(np.float32), about)}


def stderr_of(batch_means: np.ndarray) -> np.ndarray:
    """Return the standard error of the mean of groups of rays."""
    return batch_means.std(axis=0, ddof=1) / np.sqrt(len(batch_means))


def without_one(batch_means: np.ndarray) -> np.ndarray:
    """Return the means over all groups but one, the groups along the first axis."""
    return (batch_means.sum(axis=0) - batch_means) / (len(batch_means) - 1)


def jackknife(leave_one_out: np.ndarray) -> np.ndarray:
    """Return the standard error of what was computed from all groups but one (Efron 1982)."""
    n = len(leave_one_out)
    return np.sqrt((n - 1) / n * ((leave_one_out - leave_one_out.mean(axis=0)) ** 2).sum(axis=0))
