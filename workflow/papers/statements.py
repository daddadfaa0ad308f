"""Statements of papers as numbers with errors and verdicts, and checks of what a study reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.validation import invalid, join_names

DIRECTION_DIMS = {"wavelength", "polar_deg", "azimuth_deg", "screen_depth"}
"""Dimensions of an instrument's results; those of its grid are the others."""


def require(
    key: str,
    dataset: xr.Dataset,
    quantity: str,
    axes: Sequence[str] = (),
    *,
    values: Mapping[str, Sequence[float | str]] | None = None,
    at_nm: Sequence[float] = (),
    band_nm: Sequence[float] = (),
) -> xr.Dataset:
    """Return the dataset of a study input in the order of its axes; reject an unsuitable one.

    Parameters
    ----------
    key : str
        Study input, for the message.
    dataset : xarray.Dataset
    quantity : str
        Quantity that the study reads.
    axes : sequence of str
        Parameters of the grid, exactly, with two values or more each.  Numbers, and the means of
        ranges, are returned in increasing order.
    values : mapping, optional
        Values that the grid must contain, by parameter.
    at_nm, band_nm : sequence of float
        Wavelengths that the dataset must contain, and the ends of a range that it must cover (nm).

    Raises
    ------
    ValueError
        With one line that names the study input, its experiment and what the study needs.
    """

    def make_error(allowed: str) -> ValueError:
        name = dataset.attrs.get("experiment", dataset.attrs.get("title", ""))
        return invalid(f"inputs.{key}", name, f"an experiment {allowed}")

    if f"{quantity}_stderr" not in dataset:
        raise make_error(f"with {quantity} and its standard error")
    sizes = {str(d): n for d, n in dataset[quantity].sizes.items() if d not in DIRECTION_DIMS}
    if set(sizes) != set(axes) or min(sizes.values(), default=2) < 2:
        grid = f"over {' and '.join(axes)}, two values or more each"
        raise make_error(grid if axes else "without a grid")
    for name, required in (values or {}).items():
        labels = dataset[name].values
        for value in required:
            is_number = not isinstance(value, str)
            if labels.dtype.kind in "fi":
                found = is_number and np.isclose(labels, value).any()
            else:
                found = str(value) in map(str, labels)
            if not found:
                raise make_error(f"with {name} = {value} on its grid")
    wavelengths = dataset.wavelength.values if at_nm or len(band_nm) else np.array([])
    for wavelength in at_nm:
        if not np.isclose(wavelengths, wavelength).any():
            raise make_error(f"with wavelength {wavelength:g} nm")
    if len(band_nm) and (wavelengths[0] > band_nm[0] or wavelengths[-1] < band_nm[-1]):
        raise make_error(f"over wavelengths from {band_nm[0]:g} to {band_nm[-1]:g} nm")
    for name in axes:
        order = f"{name}_mean" if f"{name}_mean" in dataset.coords else name
        if dataset[order].dtype.kind == "f":
            dataset = dataset.sortby(order)
    return dataset


def require_columns(key: str, table: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Return a table of numbers; reject one without these columns, or ids of published numbers."""
    missing = [name for name in names if name not in {*table.columns, *table.index}]
    if missing:
        raise invalid(key, list(table.columns), f"a table with {join_names(missing)}")
    return table


class Estimate(NamedTuple):
    """Values and standard errors, as numbers or data arrays; operands are independent."""

    value: Any
    stderr: Any

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset, quantity: str) -> Estimate:
        """Return a quantity of a dataset and its standard error."""
        return cls(dataset[quantity], dataset[f"{quantity}_stderr"])

    def __sub__(self, other: Estimate | float) -> Estimate:
        """Return the difference from an estimate or from a number without error."""
        value, stderr = other if isinstance(other, Estimate) else (other, 0.0)
        return Estimate(self.value - value, np.hypot(self.stderr, stderr))

    def __truediv__(self, other: Estimate | float) -> Estimate:
        """Return the ratio to an estimate or to a number without error."""
        value, stderr = other if isinstance(other, Estimate) else (other, 0.0)
        ratio = self.value / value
        return Estimate(ratio, np.hypot(self.stderr, ratio * stderr) / abs(value))

    def __neg__(self) -> Estimate:
        """Return the negative values."""
        return Estimate(-self.value, self.stderr)

    def to_floats(self) -> Estimate:
        """Return a single value and its error as numbers, which can be ordered."""
        return Estimate(*(np.asarray(part, dtype=float).item() for part in self))

    def isel(self, **positions: Any) -> Estimate:
        """Return a selection by position along dimensions."""
        return Estimate(self.value.isel(positions), self.stderr.isel(positions))

    def sel(self, **labels: Any) -> Estimate:
        """Return a selection by label along dimensions."""
        return Estimate(self.value.sel(labels), self.stderr.sel(labels))

    def diff(self, dim: str) -> Estimate:
        """Return the steps along a dimension."""
        before, after = self._list_neighbours(dim)
        return after - before

    def divide_neighbours(self, dim: str) -> Estimate:
        """Return the ratios of successive values along a dimension, each to the one before."""
        before, after = self._list_neighbours(dim)
        return after / before

    def _list_neighbours(self, dim: str) -> list[Estimate]:
        """Return the values before and after each step along a dimension, without its labels."""
        bare = Estimate(*(part.drop_vars(dim, errors="ignore") for part in self))
        return [bare.isel(**{dim: part}) for part in (slice(None, -1), slice(1, None))]


UNRESOLVED_VERDICT = "not resolved at this accuracy"
"""Verdict on a number whose error is too large for a decision."""
MIN_TREND_SIGMA = 3.0
"""Significance (standard errors) that the smallest step of a trend must exceed."""


def compute_steps(
    dataset: xr.Dataset, quantity: str, dimension: str, low: float, high: float
) -> Estimate:
    """Return the steps of a band mean along a grid dimension and their standard errors.

    Points of the grid are assumed independent, which overestimates the error where they share
    random numbers.
    """
    return Estimate(*dataset.errors.mean(quantity, low, high)).diff(dimension)


def make_row(
    quantity: str, place: str, value: Any, error: Any, within: bool, bar: str
) -> dict[str, object]:
    """Return the row of a number with its criterion and verdict."""
    return {
        "id": "trend", "quantity": quantity, "place": place, "ours": float(value),
        "stderr": float(error), "bar": bar, "verdict": "agrees" if within else "outside",
    }  # fmt: skip


def select_least_significant(value: Any, error: Any) -> tuple[float, float]:
    """Return the value that exceeds 0 by the fewest standard errors, and its error."""
    value, error = np.ravel(value), np.ravel(error)
    worst = int(np.argmin(value / error))
    return float(value[worst]), float(error[worst])


def make_significance_row(quantity: str, place: str, value: Any, error: Any) -> dict[str, object]:
    """Return the row of the least significant of some values expected to be positive.

    Columns are id, quantity, place, ours, stderr, bar, verdict.  The trend agrees if the value
    exceeds `MIN_TREND_SIGMA` standard errors.
    """
    value, error = select_least_significant(value, error)
    bar = f"above {MIN_TREND_SIGMA:g} standard errors"
    row = make_row(quantity, place, value, error, value > MIN_TREND_SIGMA * error, bar)
    is_resolved = abs(value) > MIN_TREND_SIGMA * error
    return row if is_resolved else row | {"verdict": UNRESOLVED_VERDICT}


def make_monotone_row(
    dataset: xr.Dataset, quantity: str, dimension: str, sign: int,
    band_nm: tuple[float, float], statement: str, place: str,
) -> dict[str, object]:  # fmt: skip
    """Return the row of a band mean (nm) that rises (+1) or falls (-1) along a grid's dimension."""
    steps = compute_steps(dataset, quantity, dimension, *band_nm)
    steps = steps if sign > 0 else -steps
    return make_significance_row(f"{statement}: smallest step", place, *steps)
