"""State vector of a retrieval: free parameters, ranges, priors, and coordinates from 0 to 1.

Coordinates use the transforms of `splits.tables.interpolation.transform_axis`, in which reflectance
is closest to linear: the logarithm of a size, the square root of an amount from 0 on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np

from splits.core.arrays import check_named_numbers
from splits.core.declarations import Quantity
from splits.core.inputs import check_mapping
from splits.core.validation import check_relations, invalid, snap_to_limits, unknown_key
from splits.tables.interpolation import COORDINATES, apply_axis_transform

SCALE = "scale"
"""Name of the factor of the modelled reflectance, such as that of a reference panel."""
PRIOR = ("mean", "standard deviation")
Prior = Annotated[
    Mapping[str, Any] | None,
    Quantity(
        "prior knowledge by parameter",
        check=check_mapping("a mapping of names to (mean, standard deviation)"),
    ),
]
UNIFORM_VARIANCE = 1.0 / 12.0
"""Variance of a coordinate with a uniform prior."""


class ParameterRange(NamedTuple):
    """Widest range of a parameter, and the transform of its coordinate."""

    low: float
    high: float
    transform: str


class StateVector(NamedTuple):
    """Free parameters of a retrieval.

    Attributes
    ----------
    names : tuple of str
    low, high : float, shape (parameters,)
        Ranges, in the parameters' own units.
    transforms : tuple of str
        Transforms of the coordinates.
    prior_mean, prior_sd : float, shape (parameters,)
        Normal priors in coordinates; 1/2 and infinity for parameters without a prior.
    """

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    transforms: tuple[str, ...]
    prior_mean: np.ndarray
    prior_sd: np.ndarray

    @classmethod
    def from_ranges(
        cls, ranges: Any, prior: Any, allowed_ranges: Mapping[str, ParameterRange]
    ) -> StateVector:
        """Return the state vector of free parameters; reject invalid input.

        Parameters
        ----------
        ranges : sequence of str or mapping
            Parameters, or their (low, high) by name.
        prior : mapping or None
            (mean, standard deviation) by name.
        allowed_ranges : mapping
            Widest ranges by name, of all parameters that may be free.

        Raises
        ------
        ValueError
            For an unknown name, a range that is invalid or exceeds the widest, or a prior of a
            parameter that is not free.
        """
        limits = _check_ranges(ranges, allowed_ranges)
        names = tuple(limits)
        low, high = np.array([limits[name] for name in names]).T
        transforms = tuple(allowed_ranges[name].transform for name in names)
        vector = cls(
            names, low, high, transforms, np.full(len(names), 0.5), np.full(len(names), np.inf)
        )
        for name, pair in (prior or {}).items():
            if name not in names:
                raise unknown_key(f"prior.{name}", names)
            i = names.index(name)
            # The arrays are those of the vector, which nothing else refers to yet.
            vector.prior_mean[i], vector.prior_sd[i] = vector._to_coordinate_prior(i, pair)
        return vector

    def _to_coordinate_prior(self, index: int, pair: Any) -> tuple[float, float]:
        """Return the mean and standard deviation of a prior in its coordinate."""
        key = f"prior.{self.names[index]}"
        mean, sd = check_named_numbers(key, pair, PRIOR)
        low, high = self.low[index], self.high[index]
        mean = float(snap_to_limits(mean, low, high))
        is_inside = np.array([low <= mean - sd, mean + sd <= high])
        check_relations(
            (sd > 0.0, key, pair, "a standard deviation above 0"),
            (low <= mean <= high, key, pair, f"a mean in the range {low:g} to {high:g}"),
            (
                is_inside.any(), key, pair,
                f"a standard deviation that fits into the range {low:g} to {high:g}",
                "leave it out: it is wider than the range",
            ),
        )  # fmt: skip
        ends = np.clip([mean - sd, mean, mean + sd], low, high)
        coordinates = self.to_coordinate(index, ends)
        # A side that the range cuts off does not count.
        distances = np.diff(coordinates)[is_inside]
        return float(coordinates[1]), float(distances.mean())

    def without_priors(self) -> StateVector:
        """Return the state vector without priors."""
        return self._replace(prior_sd=np.full(len(self.names), np.inf))

    def to_coordinates(self, values: np.ndarray) -> np.ndarray:
        """Return coordinates of values, shape (..., parameters)."""
        columns = [self.to_coordinate(i, values[..., i]) for i in range(len(self.names))]
        return np.stack(columns, axis=-1)

    def to_coordinate(self, index: int, values: np.ndarray) -> np.ndarray:
        """Return coordinates of values of one parameter."""
        first, last = apply_axis_transform(
            self.transforms[index], np.array([self.low[index], self.high[index]])
        )
        return (apply_axis_transform(self.transforms[index], values) - first) / (last - first)

    def to_physical(self, coordinates: np.ndarray) -> np.ndarray:
        """Return the values of coordinates, shape (..., parameters)."""
        values = np.empty(np.shape(coordinates))
        for i, transform in enumerate(self.transforms):
            first, last = apply_axis_transform(transform, np.array([self.low[i], self.high[i]]))
            transformed = first + coordinates[..., i] * (last - first)
            values[..., i] = COORDINATES[transform].invert(transformed)
        return np.clip(values, self.low, self.high)

    @property
    def prior_precision(self) -> np.ndarray:
        """Precision of the priors, 0 without one."""
        return 1.0 / self.prior_sd**2

    @property
    def prior_variance(self) -> np.ndarray:
        """Variance of the prior, or of the range without one."""
        return 1.0 / np.maximum(self.prior_precision, 1.0 / UNIFORM_VARIANCE)


def _check_ranges(
    free: Any, allowed_ranges: Mapping[str, ParameterRange]
) -> dict[str, tuple[float, float]]:
    """Return (low, high) by name; reject invalid ranges."""
    if isinstance(free, str) or not isinstance(free, Mapping | Sequence) or not len(free):
        raise invalid("free", free, "names of parameters, or their (low, high) by name")
    ranges = {}
    for name in free:
        if name not in allowed_ranges:
            raise unknown_key(f"free.{name}", allowed_ranges)
        widest = allowed_ranges[name]
        pair = free[name] if isinstance(free, Mapping) else (widest.low, widest.high)
        limits = (widest.low, widest.high)
        low, high = check_named_numbers(f"free.{name}", pair, ("low", "high"), limits)
        allowed = f"{widest.low:g} <= low < high <= {widest.high:g}"
        is_range = widest.low <= low < high <= widest.high
        check_relations((is_range, f"free.{name}", pair, allowed))
        ranges[str(name)] = (low, high)
    return ranges
