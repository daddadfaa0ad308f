"""Interpolation of a quantity along one axis, in the best coordinate and with a measured error.

A table has spectra at two or more positions between all neighbouring nodes of an axis, for a few
nodes of the other axes (`splits.tables.comparison`).  At every wavelength, the coordinate is the
one that predicts these spectra best.  The differences that remain, divided by the product of the
distances of the stencil from the position, give the factor f⁗/24 of the error along the axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.validation import invalid
from splits.tables.axes import ANGLES, POLAR
from splits.tables.interpolation import (
    COORDINATES,
    Coordinate,
    apply_axis_transform,
    compute_stencil,
    estimate_error_weights,
    list_coordinates,
    make_stencil_matrix,
    transform_axis,
)

MIN_COMPARED = 2
"""Smallest number of compared positions in every interval."""
ROUNDING = 2e-7
"""Differences that are not significant in single precision."""
MEAN_SHARE = 0.1
"""Share of the root mean square over the other axes in the error at a position: a difference may
vanish by chance where it changes its sign."""
NEIGHBOUR_WEIGHTS = (0.25, 0.5, 0.25)
"""Weights of squared factors at a node and beside it, of the other angles of a table with
directions: details such as halos move with all angles, so that a factor may vanish at a node and be
large beside it.  The whole range of angles would say little about one of them."""
VARIATION_SHARE = 0.25
"""Share of the variance of factors at neighbouring nodes in the squared error between them, if they
are angles of a table with directions, which has many; for other axes, all of it counts."""

REFINEMENT_SHARE, REFINEMENT_TOLERANCE = 0.2, 1e-5
"""Allowed deviation of cubics between added nodes: share of the measured error, and absolute."""
MAX_REFINEMENT = 16
"""Largest number of intervals into which an interval of a table is divided."""


class AxisWeights(NamedTuple):
    """Weights of the nodes of an axis at a position, by wavelength.

    Attributes
    ----------
    values, slopes : float, shape (nodes, wavelengths)
        Weights of the value, and of its derivative with respect to the parameter of the axis.
    product, product_slope : float, shape (wavelengths,)
        Product of the distances of the stencil from the position, and its derivative.
    """

    values: np.ndarray
    slopes: np.ndarray
    product: np.ndarray
    product_slope: np.ndarray


class AxisError(NamedTuple):
    """Error of interpolation along one axis, over wavelength and possibly other axes.

    Attributes
    ----------
    signed : float
        Best estimate, with its sign; without a measurement, the sign is only that relative to
        other wavelengths.
    magnitude : float
        Root mean square, at least as large.
    is_measured : bool
    """

    signed: np.ndarray
    magnitude: np.ndarray
    is_measured: bool


class AxisInterpolation:
    """Interpolation of a quantity along a numeric axis.

    Parameters
    ----------
    name : str
    nodes : float, shape (nodes,)
    n_wavelengths : int
    has_direction : bool
        See `splits.tables.interpolation.transform_axis`.
    comparison : xarray.DataArray, optional
        Values at the nodes and between them, for some nodes of the other axes, with the axis as
        the first dimension and the wavelength as the last one.
    other_transforms : mapping of str to str
        Default coordinate of each other numeric axis of the table.
    """

    def __init__(
        self,
        name: str,
        nodes: np.ndarray,
        n_wavelengths: int,
        *,
        has_direction: bool,
        comparison: xr.DataArray | None = None,
        other_transforms: Mapping[str, str] | None = None,
    ) -> None:
        self.name, self.nodes, self.has_direction = name, nodes, has_direction
        self.default = transform_axis(name, nodes, has_direction=has_direction)[0]
        self.comparison, self.other_transforms = comparison, other_transforms or {}
        if comparison is None:
            self._set_coordinates([COORDINATES[self.default]], np.zeros(n_wavelengths, dtype=int))
            return
        positions = comparison[name].values
        is_node = np.isin(positions, nodes)
        self.between = positions[~is_node]
        self.n_compared = len(self.between) // (len(nodes) - 1)
        values = comparison.values.astype(float)
        candidates = list_coordinates(name, nodes, has_direction=has_direction)
        choice, differences = _choose_coordinates(
            candidates, nodes, values[is_node], self.between, values[~is_node]
        )
        self._set_coordinates(candidates, choice)
        products = np.array([self.compute_weights(x).product for x in self.between])
        self._differences = np.abs(differences)
        shape = (len(self.between), *[1] * (differences.ndim - 2), -1)
        factor = differences / products.reshape(shape)
        self.other_axes = {str(n): comparison[n].values for n in comparison.dims[1:-1]}
        self.factors = np.stack([factor, self._estimate_remainder(factor)])

    def _set_coordinates(self, candidates: list[Coordinate], choice: np.ndarray) -> None:
        """Set the coordinates that some wavelength uses, from the choice of each wavelength."""
        used, self.choice = np.unique(choice, return_inverse=True)
        self.coordinates = [candidates[i] for i in used]
        self._coordinate_nodes = [one.apply(self.nodes) for one in self.coordinates]

    @property
    def is_measured(self) -> bool:
        """Whether the error was measured between the nodes."""
        return self.comparison is not None

    def _is_dense(self, name: str) -> bool:
        """Return whether an axis is an angle of a table with directions."""
        return self.has_direction and name in ANGLES

    def _estimate_remainder(self, factor: np.ndarray) -> np.ndarray:
        """Return what the squared error at a node has besides the square of its factor."""
        others = dict(enumerate(self.other_axes, start=1))
        angles = [axis for axis, name in others.items() if self._is_dense(name)]
        nearby = factor**2
        for axis in angles:
            ends = [0, *range(nearby.shape[axis]), -1]
            padded = np.take(nearby, ends, axis)
            nearby = np.lib.stride_tricks.sliding_window_view(padded, 3, axis) @ NEIGHBOUR_WEIGHTS
        mean = (factor**2).mean(axis=tuple(others.keys() - angles), keepdims=True)
        return VARIATION_SHARE * np.maximum(nearby - factor**2, 0.0) + MEAN_SHARE**2 * mean

    def compute_weights(self, value: float, *, with_slopes: bool = False) -> AxisWeights:
        """Return the weights of all nodes at a position within the axis.

        Raises
        ------
        ValueError
            With slopes, at the origin of a square root.
        """
        n_nodes = len(self.nodes)
        rows, slopes = np.zeros((2, len(self.coordinates), n_nodes))
        products, product_slopes = np.empty((2, len(self.coordinates)))
        for i, (coordinate, nodes) in enumerate(
            zip(self.coordinates, self._coordinate_nodes, strict=True)
        ):
            stencil = compute_stencil(nodes, float(coordinate.apply(np.array(value))))
            rate = coordinate.compute_rate(value) if with_slopes else np.nan
            if np.isinf(rate):
                hint = "reflectance varies as a square root there: use a larger value"
                raise invalid(
                    f"derivatives ({self.name})", value, "where the derivative is finite", hint
                )
            rows[i, stencil.nodes] = stencil.weights
            slopes[i, stencil.nodes] = rate * stencil.slopes
            products[i], product_slopes[i] = stencil.product, rate * stencil.product_slope
        return AxisWeights(
            rows[self.choice].T, slopes[self.choice].T,
            products[self.choice], product_slopes[self.choice],
        )  # fmt: skip

    def interpolate(self, values: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Return values at positions; both have the axis before the wavelength."""
        if np.array_equal(positions, self.nodes):
            return values
        weights = np.array([self.compute_weights(x).values for x in positions.tolist()])
        return np.einsum("pnw,...nw->...pw", weights, values, optimize=True)

    def refine_nodes(
        self, coordinate: Coordinate, max_steps: int = MAX_REFINEMENT
    ) -> tuple[int, np.ndarray, np.ndarray]:
        """Return nodes of which cubics in one coordinate agree with the interpolation.

        Parameters
        ----------
        coordinate : Coordinate
        max_steps : int
            Largest number of intervals between neighbouring nodes of the table.

        Returns
        -------
        int
            Number of intervals between neighbouring nodes of the table.
        float, shape (nodes,)
        float, shape (wavelengths,)
            Largest deviation of the cubics.
        """
        steps, refined = 1, self.nodes
        if self.comparison is None or self.coordinates == [coordinate]:
            return steps, refined, np.zeros(len(self.choice))
        is_node = np.isin(self.comparison[self.name].values, self.nodes)
        rows = np.moveaxis(self.comparison.values[is_node].astype(float), 0, -2)
        ends = coordinate.apply(self.nodes)
        allowed = np.sqrt((self._differences**2).mean(axis=tuple(range(rows.ndim - 1))))
        allowed = np.maximum(REFINEMENT_SHARE * allowed, REFINEMENT_TOLERANCE)
        while True:
            t = coordinate.apply(refined)
            middle = coordinate.invert(0.5 * (t[:-1] + t[1:]))
            matrix = make_stencil_matrix(t, coordinate.apply(middle))
            by_cubics = np.einsum("pn,...nw->...pw", matrix, self.interpolate(rows, refined))
            deviation = np.abs(by_cubics - self.interpolate(rows, middle))
            largest = deviation.max(axis=tuple(range(rows.ndim - 1)))
            if 2 * steps > max_steps or (largest <= allowed).all():
                return steps, refined, largest
            steps *= 2
            fractions = np.arange(steps) / steps
            inner = (ends[:-1, np.newaxis] + fractions * np.diff(ends)[:, np.newaxis]).ravel()
            refined = np.append(coordinate.invert(inner), self.nodes[-1])
            refined[::steps] = self.nodes

    def find_largest_difference(
        self, max_polar_deg: float
    ) -> tuple[float, float, float, int] | None:
        """Return the largest measured error, the ends of its interval, and its wavelength's index.

        Polar angles above a limit are left out.
        """
        if self.comparison is None:
            return None
        differences = self._differences
        if POLAR in self.comparison.dims:
            polar = self.between if self.name == POLAR else self.other_axes[POLAR]
            axis = self.comparison.dims.index(POLAR)
            differences = np.compress(polar <= max_polar_deg, differences, axis=axis)
        if not differences.size:
            return None
        place = np.unravel_index(differences.argmax(), differences.shape)
        interval = int(place[0]) // self.n_compared
        low, high = self.nodes[interval : interval + 2].tolist()
        return float(differences[place]), low, high, int(place[-1])

    def estimate_error_weights(self, value: float) -> np.ndarray:
        """Return the weights of estimates of an error that was not measured."""
        if len(self.nodes) == 1:
            return np.zeros((0, 1))
        return estimate_error_weights(
            self.name, self.nodes, value, has_direction=self.has_direction
        )

    def measure_error(self, value: float, weights: AxisWeights, at: Mapping[str, Any]) -> AxisError:
        """Return the measured error at a position.

        Parameters
        ----------
        value : float
            Position on the axis.
        weights : AxisWeights
            Weights at the position.
        at : mapping
            Position on every other axis, a number or a text; or its nodes, over which the error
            is then returned, in the order of the axes.
        """
        signed, squared, _ = self._interpolate_factors(value, at)
        product = weights.product
        return AxisError(product * signed, np.abs(product) * np.sqrt(squared), True)

    def measure_slope_error(
        self, value: float, weights: AxisWeights, at: Mapping[str, Any]
    ) -> np.ndarray:
        """Return the measured error of the derivative at a position, shape (wavelengths,)."""
        _, squared, factor_slope = self._interpolate_factors(value, at)
        return np.hypot(weights.product_slope * np.sqrt(squared), weights.product * factor_slope)

    def _interpolate_factors(
        self, value: float, at: Mapping[str, Any]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the signed and the squared factor at a position, and the derivative of it."""
        interval = min(max(int(np.searchsorted(self.nodes, value)) - 1, 0), len(self.nodes) - 2)
        first = self.n_compared * interval
        positions = self.between[first : first + self.n_compared]
        positions = apply_axis_transform(self.default, positions)
        x = float(apply_axis_transform(self.default, np.array(value)))
        left = min(max(int(np.searchsorted(positions, x)) - 1, 0), self.n_compared - 2)
        low, high = positions[left : left + 2]
        left += first
        fraction = (x - low) / (high - low)
        inside = min(max(fraction, 0.0), 1.0)
        pair = self.factors[:, left : left + 2]
        step = pair[0, 1] - pair[0, 0]
        signed, remainder = self._average(self.name, np.array([1.0 - inside, inside]), pair, 1)
        # Beyond the first and the last position, a trend may go on or not.
        remainder += (fraction - inside) ** 2 * step**2
        rows = np.stack([signed, remainder, step / (self.between[left + 1] - self.between[left])])
        kept = 0
        for name, nodes in self.other_axes.items():
            kind = self.other_transforms.get(name, "identity")
            # Axes with several targets stay in their order.
            several = np.ndim(at[name])
            targets = at[name] if several else [at[name]]
            weights = np.array([_interpolate_linearly(kind, nodes, one) for one in targets])
            rows = self._average(name, weights if several else weights[0], rows, 1 + kept)
            kept += several
        signed, remainder, slope = rows
        return signed, signed**2 + remainder, slope

    def _average(self, name: str, weights: np.ndarray, rows: np.ndarray, axis: int) -> np.ndarray:
        """Return means over an axis of factors, remainders and others, for rows of weights.

        The variance of the factors is added to their remainder.
        """

        def average(values: np.ndarray, axis: int) -> np.ndarray:
            means = np.tensordot(weights, np.moveaxis(values, axis, 0), 1)
            return np.moveaxis(means, 0, axis) if weights.ndim == 2 else means

        means = average(rows, axis)
        variance = average(rows[0] ** 2, axis - 1) - means[0] ** 2
        means[1] += (VARIATION_SHARE if self._is_dense(name) else 1.0) * np.maximum(variance, 0.0)
        return means


def _choose_coordinates(
    candidates: list[Coordinate],
    nodes: np.ndarray,
    node_values: np.ndarray,
    between: np.ndarray,
    between_values: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the best coordinate by wavelength, and the differences that remain with it.

    Differences are those of interpolated values from the values between the nodes.
    """
    n_wavelengths = node_values.shape[-1]
    smallest = np.full(n_wavelengths, np.inf)
    choice = np.zeros(n_wavelengths, dtype=int)
    best = np.empty_like(between_values)
    axes = tuple(range(between_values.ndim - 1))
    for i, coordinate in enumerate(candidates):
        matrix = make_stencil_matrix(coordinate.apply(nodes), coordinate.apply(between))
        differences = np.tensordot(matrix, node_values, 1) - between_values
        mean_square = np.maximum((differences**2).mean(axis=axes), ROUNDING**2)
        better = mean_square < smallest
        choice[better], smallest[better] = i, mean_square[better]
        best[..., better] = differences[..., better]
    return choice, best


def _interpolate_linearly(transform: str, nodes: np.ndarray, target: Any) -> np.ndarray:
    """Return the weights of linear interpolation in a coordinate; a text selects its node."""
    if nodes.dtype.kind != "f":
        return (nodes == str(target)).astype(float)
    if len(nodes) == 1:
        return np.ones(1)
    coordinates = apply_axis_transform(transform, nodes)
    x = float(apply_axis_transform(transform, np.array(target, dtype=float)))
    right = min(max(int(np.searchsorted(coordinates, x)), 1), len(nodes) - 1)
    weights = np.zeros(len(nodes))
    step = coordinates[right] - coordinates[right - 1]
    fraction = min(max((x - coordinates[right - 1]) / step, 0.0), 1.0)
    weights[right - 1 : right + 1] = 1.0 - fraction, fraction
    return weights
