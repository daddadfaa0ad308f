"""Values with standard errors."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr


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
