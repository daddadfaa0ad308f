"""Interpolation along one axis of a table, in the best coordinate and with its error.

Values between nodes are those of the cubic through the four nearest nodes, in a coordinate in which
reflectance varies smoothly.  Which coordinate this is depends on what else is in the medium:
reflectance is nearly linear in the square root of absorption, so that near zero soot the square
root of soot is the best coordinate for ice that does not absorb, and soot itself for ice that
absorbs much more.  Coordinates are therefore powers and logarithms of the distance from an origin
(`list_coordinates`), and a table with spectra between its nodes chooses among them for every
wavelength (`AxisInterpolation`).

The error of a cubic at x is f⁗/24 times the product of the distances of its nodes from x.  A table
has spectra at two or more positions between all neighbouring nodes of an axis, for a few nodes of
the other axes (`splits.tables.comparison`).  At every wavelength, the coordinate is the one that
predicts these spectra best.  The differences that remain, divided by the product of the distances,
give the factor f⁗/24.  Without spectra between nodes, the error of predicting a node from its
neighbours gives an estimate of f⁗ near it, and the differences between coordinates one of the error
next to the ends of an axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.validation import as_scalar, check_number, invalid, snap_to_limits
from splits.illumination.bands import RESOLVED_STEP_NM
from splits.kernels.interpolation import STENCIL_SIZE, find_first_node, set_lagrange_weights
from splits.tables.axes import ANGLES, POLAR

N_VALIDATION_NODES = 2
"""Number of nodes that are predicted from others.  All nodes of the stencil are with directions,
because distributions have details, such as halos, in a few intervals only."""
TINY = 1e-300


class Coordinate(NamedTuple):
    """Coordinate of an axis: a power or the logarithm of the distance from an origin.

    Attributes
    ----------
    is_cosine : bool
        Whether the distance is that of −cos(angle), rather than of the value itself.
    power : float
        1 for the value itself, 0 for the logarithm of the distance.
    origin : float
        Outside the nodes, or at the first one for positive powers.
    """

    is_cosine: bool
    power: float
    origin: float

    def _measure_distance(self, values: np.ndarray) -> np.ndarray:
        values = np.asarray(values, dtype=float)
        return (-np.cos(np.radians(values)) if self.is_cosine else values) - self.origin

    def apply(self, values: np.ndarray) -> np.ndarray:
        """Return the coordinates of values; they increase with the values."""
        distance = self._measure_distance(values)
        if self.power == 1.0:
            return distance
        size, side = np.abs(distance), np.where(distance < 0.0, -1.0, 1.0)
        transformed = np.log(size) if self.power == 0.0 else size**self.power
        return side * (-transformed if self.power < 0.0 else transformed)

    def invert(self, coordinates: np.ndarray) -> np.ndarray:
        """Return the values of coordinates, for origins that are not above the values."""
        distance = np.asarray(coordinates, dtype=float)
        if self.power != 1.0:
            distance = np.exp(distance) if self.power == 0.0 else distance ** (1.0 / self.power)
        values = self.origin + distance
        if self.is_cosine:
            values = np.degrees(np.arccos(np.clip(-values, -1.0, 1.0)))
        return values

    def compute_rate(self, value: float) -> float:
        """Return the derivative of the coordinate with respect to the value."""
        distance = abs(float(self._measure_distance(np.array(value))))
        rate = 1.0
        if self.power != 1.0:
            if distance < TINY:
                return np.inf
            rate = (abs(self.power) or 1.0) * distance ** (self.power - 1.0)
        return rate * (np.radians(1.0) * np.sin(np.radians(value)) if self.is_cosine else 1.0)


COORDINATES = {
    "identity": Coordinate(False, 1.0, 0.0),
    "cosine": Coordinate(True, 1.0, 0.0),
    "logarithm": Coordinate(False, 0.0, 0.0),
    "square_root": Coordinate(False, 0.5, 0.0),
}
"""Coordinates without an origin of their own, by name."""
ORIGIN_RATIOS = {-1: 4.0 ** np.arange(-5, 4), 1: 4.0 ** np.arange(-3, 3)}
"""Distances of origins below the first node (−1) and above the last one (1), relative to the
adjacent interval."""
DIRECTION_ORIGINS = (0.03, 0.1, 0.4)
"""Distances of origins beyond the cosine of 90°, for angles of directions."""


def transform_axis(
    name: str, nodes: np.ndarray, *, has_direction: bool = False
) -> tuple[str, np.ndarray]:
    """Return the default coordinate of an axis by name, and the coordinates of its nodes.

    Positive amounts that span at least a factor of three are transformed to logarithms.  Amounts
    that begin with 0 are transformed to square roots, because reflectance is nearly linear in the
    square root of absorption.  Polar angles remain as they are, with incidences for one direction
    of observation (`has_direction`): the distributions vary linearly with them at the normal.
    """
    kind = "identity"
    if name == "azimuth_deg" or (name == "incidence_deg" and not has_direction):
        kind = "cosine"
    elif name not in ("polar_deg", "incidence_deg", "wavelength"):
        if nodes[0] > 0.0 and nodes[-1] >= 3.0 * nodes[0]:
            kind = "logarithm"
        elif nodes[0] == 0.0 and nodes.size > 2:
            kind = "square_root"
    return kind, apply_axis_transform(kind, nodes)


def apply_axis_transform(transform: str, values: np.ndarray) -> np.ndarray:
    """Return the coordinates of values."""
    return COORDINATES[transform].apply(values)


def list_coordinates(
    name: str, nodes: np.ndarray, *, has_direction: bool = False
) -> list[Coordinate]:
    """Return the coordinates among which a table chooses, the default one first."""
    kind, _ = transform_axis(name, nodes, has_direction=has_direction)
    default, identity = COORDINATES[kind], COORDINATES["identity"]
    if name in ("azimuth_deg", "polar_deg") or (name == "incidence_deg" and has_direction):
        others = [COORDINATES["cosine"], identity]
        if name != "azimuth_deg":
            others += [Coordinate(True, p, s) for p in (-1.0, 0.0) for s in DIRECTION_ORIGINS]
        return [*dict.fromkeys([default, *others])]
    is_cosine = kind == "cosine"
    ends = Coordinate(is_cosine, 1.0, 0.0).apply(nodes)
    origins = [
        *(ends[0] - (ends[1] - ends[0]) * ORIGIN_RATIOS[-1]),
        *(ends[-1] + (ends[-1] - ends[-2]) * ORIGIN_RATIOS[1]),
    ]
    powers = (-1.0, 0.0, 0.5)
    shifted = [Coordinate(is_cosine, power, float(one)) for one in origins for power in powers]
    return [*dict.fromkeys([default, identity, *shifted])]


def check_within_axis(name: str, nodes: np.ndarray, value: object) -> float:
    """Return a position on an axis of a table as a number within the axis.

    Raises
    ------
    ValueError
        For a value outside the axis.
    """
    allowed, hint = f"from {nodes[0]:g} to {nodes[-1]:g}, as far as the table goes", ""
    if np.ndim(as_scalar(value)):
        allowed = f"one number {allowed}"
        hint = "repeat the call for each, such as for the parts of an image with one sun"
    else:
        x = float(snap_to_limits(check_number(name, value), nodes[0], nodes[-1]))
        if nodes[0] <= x <= nodes[-1]:
            return x
    raise invalid(name, value, allowed, hint)


class InterpolationWeights(NamedTuple):
    """Interpolation stencil of a value on an axis in one coordinate.

    Attributes
    ----------
    nodes : int, shape (stencil,)
        Nodes of the stencil.
    weights : float, shape (stencil,)
        Interpolation weights, with a sum of 1.
    slopes : float, shape (stencil,)
        Derivatives of the weights with respect to the coordinate.
    product, product_slope : float
        Product of the distances of the nodes from the value in the coordinate, and its derivative.
    """

    nodes: np.ndarray
    weights: np.ndarray
    slopes: np.ndarray
    product: float
    product_slope: float


def compute_stencil(coordinates: np.ndarray, x: float) -> InterpolationWeights:
    """Return the stencil of a position among the coordinates of nodes."""
    first = int(find_first_node(coordinates, len(coordinates), x))
    stencil = np.arange(first, first + min(STENCIL_SIZE, len(coordinates)))
    return InterpolationWeights(stencil, *compute_lagrange_weights(coordinates[stencil], x))


def make_stencil_matrix(coordinates: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return the weights of all nodes at positions, shape (positions, nodes)."""
    matrix = np.zeros((len(positions), len(coordinates)))
    for row, x in zip(matrix, positions.tolist(), strict=True):
        stencil = compute_stencil(coordinates, x)
        row[stencil.nodes] = stencil.weights
    return matrix


def compute_lagrange_weights(
    nodes: np.ndarray, x: float
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return the weights of the Lagrange polynomial at x, their derivatives, and the product.

    The product is that of the distances of the nodes from x; its derivative is the last item.
    """
    points = nodes.tolist()
    weights, slopes = np.empty((2, len(points)))
    set_lagrange_weights(points, 0, len(points), x, weights, slopes)
    product, product_slope = 1.0, 0.0
    for node in points:
        product_slope = product_slope * (x - node) + product
        product *= x - node
    return weights, slopes, product, product_slope


def compute_interpolation_weights(
    name: str, nodes: np.ndarray, value: object, *, has_direction: bool = False
) -> InterpolationWeights:
    """Return the interpolation weights of a value on an axis in its default coordinate.

    Parameters
    ----------
    name : str
    nodes : float, shape (nodes,)
    value : object
        Number within the axis.
    has_direction : bool
        Whether distributions over directions, or values of them, are interpolated.

    Raises
    ------
    ValueError
        For a value outside the axis.
    """
    kind, coordinates = transform_axis(name, nodes, has_direction=has_direction)
    x = check_within_axis(name, nodes, value)
    return compute_stencil(coordinates, float(apply_axis_transform(kind, np.array(x))))


def make_weight_matrix(
    name: str, nodes: np.ndarray, values: np.ndarray, *, has_direction: bool = False
) -> np.ndarray:
    """Return the weights of all nodes at several values in the default coordinate of an axis."""
    kind, coordinates = transform_axis(name, nodes, has_direction=has_direction)
    inside = (check_within_axis(name, nodes, value) for value in values.tolist())
    # One by one, as single values are transformed: powers of arrays are rounded differently.
    positions = np.array([apply_axis_transform(kind, np.array(x)) for x in inside])
    return make_stencil_matrix(coordinates, positions)


def estimate_error_weights(
    name: str, nodes: np.ndarray, value: float, *, has_direction: bool = False
) -> np.ndarray:
    """Return the weights of all nodes in estimates of the interpolation error of a value.

    The estimates are the errors of predicting nearby nodes from others, scaled to the position of
    the value, and the differences from linear interpolation in other coordinates in the first and
    the last interval.  With at most four nodes, the contribution of the farthest node
    replaces that of an additional node.  Wavelengths that are so far apart that they do not resolve
    absorption bands have the whole error of predicting a node, as it does not decrease with the
    interval there.

    Parameters
    ----------
    name, nodes, has_direction
        As for `compute_interpolation_weights`.
    value : float
        Position within the axis.

    Returns
    -------
    float, shape (estimates, nodes)
        No estimates at a node.
    """
    kind, coordinates = transform_axis(name, nodes, has_direction=has_direction)
    value = check_within_axis(name, nodes, value)
    x = float(apply_axis_transform(kind, np.array(value)))
    stencil, weights, _, product, _ = compute_stencil(coordinates, x)
    if product == 0.0:
        return np.zeros((0, len(nodes)))
    rows, least_scale = [], 0.0
    right = int(np.searchsorted(nodes, value))
    neighbours = nodes[right - 1 : right + 1]
    if name == "wavelength":
        # Up to 1 in the middle of a wide interval.
        interval = float(neighbours[1] - neighbours[0])
        middle = 4.0 * (value - neighbours[0]) * (neighbours[1] - value) / interval**2
        least_scale = middle * min(1.0, (interval / RESOLVED_STEP_NM) ** 2)
    if len(nodes) == 2:
        # No node can be omitted; the estimate is a quarter of the difference at the midpoint.
        rows.append(max(np.prod(weights), least_scale) * np.array([-1.0, 1.0]))
    ordered = stencil[np.argsort(np.abs(coordinates[stencil] - x), kind="stable")]
    if 2 < len(nodes) <= STENCIL_SIZE and name != "wavelength":
        row = np.zeros(len(nodes))
        row[stencil] += weights
        row[ordered[:-1]] -= compute_lagrange_weights(coordinates[ordered[:-1]], x)[0]
        rows.append(row)
    elif len(nodes) > 2:
        for node in ordered if has_direction else ordered[:N_VALIDATION_NODES]:
            remaining = np.delete(np.arange(len(nodes)), node)
            omitted = compute_stencil(coordinates[remaining], coordinates[node])
            row = np.zeros(len(nodes))
            scale = max(abs(product / omitted.product), least_scale)
            row[node] += scale
            row[remaining[omitted.nodes]] -= scale * omitted.weights
            rows.append(row)
    compared = []
    if value < nodes[1] or value > nodes[-2]:
        # The first and the last node are never left out.
        compared = list_compared_coordinates(name, nodes, kind)
    if has_direction and len(nodes) > 2:
        # A detail such as a halo may be narrower than an interval.
        compared = [*compared, COORDINATES[kind]]
    for other in compared:
        row = np.zeros(len(nodes))
        row[stencil] += weights
        ends, position = other.apply(neighbours), float(other.apply(np.array(value)))
        row[right - 1 : right + 1] -= compute_lagrange_weights(ends, position)[0]
        rows.append(row)
    return np.array(rows)


def list_compared_coordinates(name: str, nodes: np.ndarray, kind: str) -> list[Coordinate]:
    """Return the coordinates whose differences from the default one estimate its error."""
    if name in ("wavelength", "polar_deg", "incidence_deg") or kind in ("logarithm", "cosine"):
        return []
    low = float(nodes[0] - 0.25 * (nodes[1] - nodes[0]))
    high = float(nodes[-1] + 0.25 * (nodes[-1] - nodes[-2]))
    others = [COORDINATES["identity"], *(Coordinate(False, 0.0, one) for one in (low, high))]
    return [one for one in others if one != COORDINATES[kind]]


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
