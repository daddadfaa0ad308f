"""What a retrieval is free to vary: ranges, priors, and coordinates from 0 to 1.

A coordinate goes evenly where light changes evenly, by the laws of
`splits.tables.interpolation.transform_axis`: the logarithm of a size, the root of an amount from 0
on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.core.arrays import check_named_numbers
from splits.core.validation import invalid, snap_to_limits, unknown_key
from splits.tables.interpolation import apply_axis_transform

SCALE = "scale"
"""Name of the factor of the measurement, such as that of a reference panel."""
UNIFORM_VARIANCE = 1.0 / 12.0
"""Of a coordinate of which nothing is known."""


class ParameterRange(NamedTuple):
    """The widest range of a parameter, and the law by which light changes evenly along it."""

    low: float
    high: float
    transform: str


class StateVector(NamedTuple):
    """Free parameters.

    Attributes
    ----------
    names : tuple of str
    low, high : float, shape (parameters,)
        Ranges, in the parameters' own units.
    transforms : tuple of str
        By which coordinates go.
    prior_mean, prior_sd : float, shape (parameters,)
        Normal priors in coordinates; of a parameter without one, 1/2 and infinite.
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
        """Return what a user leaves free, or refuse it.

        Parameters
        ----------
        ranges : sequence of str or mapping
            Parameters, or their (low, high) by name.
        prior : mapping or None
            (mean, standard deviation) by name.
        allowed_ranges : mapping
            Widest ranges by name, of those that can be free.

        Raises
        ------
        ValueError
            For a name that is not known, a range that is none or not within the widest, or a
            prior of what is not free.
        """
        given = _check_ranges(ranges, allowed_ranges)
        names = tuple(given)
        low, high = np.array([given[name] for name in names]).T
        laws = tuple(allowed_ranges[name].transform for name in names)
        plain = cls(names, low, high, laws, np.full(len(names), 0.5), np.full(len(names), np.inf))
        if prior is None:
            return plain
        if not isinstance(prior, Mapping):
            raise invalid("prior", prior, "a mapping of names to (mean, standard deviation)")
        mean, sd = plain.prior_mean.copy(), plain.prior_sd.copy()
        for name, pair in prior.items():
            if name not in names:
                raise unknown_key(f"prior.{name}", names)
            i = names.index(name)
            mean[i], sd[i] = plain._to_coordinate_prior(i, pair)
        return plain._replace(prior_mean=mean, prior_sd=sd)

    def _to_coordinate_prior(self, index: int, pair: Any) -> tuple[float, float]:
        """Return mean and standard deviation of a prior in its coordinate, or refuse it."""
        key = f"prior.{self.names[index]}"
        mean, sd = check_named_numbers(key, pair, ("mean", "standard deviation"))
        if not sd > 0.0:
            raise invalid(key, pair, "a standard deviation above 0")
        low, high = self.low[index], self.high[index]
        mean = float(snap_to_limits(mean, low, high))
        if not low <= mean <= high:
            raise invalid(key, pair, f"a mean in the range {low:g} to {high:g}")
        ends = [np.clip(mean + sign * sd, low, high) for sign in (-1.0, 1.0)]
        below, middle, above = self.to_coordinate(
            index, np.array([ends[0], mean, ends[1]])
        ).tolist()
        # Where the range cuts one side off, the other one tells.
        cut = [ends[0] > mean - sd, ends[1] < mean + sd]
        sides = [d for d, off in zip((middle - below, above - middle), cut, strict=True) if not off]
        if not sides:
            allowed = f"a standard deviation that fits into the range {low:g} to {high:g}"
            raise invalid(key, pair, allowed, "leave it out: it says less than the range does")
        return middle, float(np.mean(sides))

    def drop_priors(self) -> StateVector:
        """Return the same without priors."""
        return self._replace(prior_sd=np.full(len(self.names), np.inf))

    def to_coordinates(self, values: np.ndarray) -> np.ndarray:
        """Return coordinates of values, shape (..., parameters)."""
        found = [self.to_coordinate(i, values[..., i]) for i in range(len(self.names))]
        return np.stack(found, axis=-1)

    def to_coordinate(self, index: int, values: np.ndarray) -> np.ndarray:
        """Return coordinates of values of one parameter."""
        first, last = apply_axis_transform(
            self.transforms[index], np.array([self.low[index], self.high[index]])
        )
        row: np.ndarray = (apply_axis_transform(self.transforms[index], values) - first) / (
            last - first
        )
        return row

    def to_physical(self, coordinates: np.ndarray) -> np.ndarray:
        """Return the values of coordinates, shape (..., parameters)."""
        found = np.empty(np.shape(coordinates))
        for i, kind in enumerate(self.transforms):
            first, last = apply_axis_transform(kind, np.array([self.low[i], self.high[i]]))
            found[..., i] = _invert_axis_transform(
                kind, first + coordinates[..., i] * (last - first)
            )
        return np.clip(found, self.low, self.high)

    @property
    def prior_precision(self) -> np.ndarray:
        """Precision of the priors, 0 without one."""
        return 1.0 / self.prior_sd**2

    @property
    def prior_variance(self) -> np.ndarray:
        """Variance of what was known before: of the prior, or of the range."""
        return 1.0 / np.maximum(self.prior_precision, 1.0 / UNIFORM_VARIANCE)


def _invert_axis_transform(transform: str, transformed: np.ndarray) -> np.ndarray:
    """Return the inverse of `splits.tables.interpolation.apply_axis_transform`."""
    if transform == "cosine":
        return np.degrees(np.arccos(np.clip(-transformed, -1.0, 1.0)))
    if transform == "logarithm":
        return np.exp(transformed)
    return np.square(transformed) if transform == "root" else np.asarray(transformed, dtype=float)


def _check_ranges(
    free: Any, allowed_ranges: Mapping[str, ParameterRange]
) -> dict[str, tuple[float, float]]:
    """Return (low, high) by name, or refuse them."""
    if isinstance(free, str) or not isinstance(free, Mapping | Sequence) or not len(free):
        raise invalid("free", free, "names of parameters, or their (low, high) by name")
    found = {}
    for name in free:
        if name not in allowed_ranges:
            raise unknown_key(f"free.{name}", allowed_ranges)
        widest = allowed_ranges[name]
        pair = free[name] if isinstance(free, Mapping) else (widest.low, widest.high)
        ends = (widest.low, widest.high)
        low, high = check_named_numbers(f"free.{name}", pair, ("low", "high"), ends)
        if not widest.low <= low < high <= widest.high:
            allowed = f"{widest.low:g} <= low < high <= {widest.high:g}"
            raise invalid(f"free.{name}", pair, allowed)
        found[str(name)] = (low, high)
    return found
