"""Interpolation along one axis of a table, with an estimate of its error.

Values between nodes are those of the cubic through the four nearest nodes, in a coordinate in which
reflectance varies smoothly.  Which coordinate this is depends on what else is in the medium:
reflectance is nearly linear in the square root of absorption, so that near zero soot the square
root of soot is the best coordinate for ice that does not absorb, and soot itself for ice that
absorbs much more.  Coordinates are therefore powers and logarithms of the distance from an origin
(`list_coordinates`), and a table with spectra between its nodes chooses among them for every
wavelength (`splits.tables.axis_interpolation`).

The error of a cubic at x is f⁗/24 times the product of the distances of its nodes from x.  Without
spectra between nodes, the error of predicting a node from its neighbours gives an estimate of f⁗
near it, and the differences between coordinates one of the error next to the ends of an axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.validation import as_scalar, check_number, invalid, snap_to_limits
from splits.illumination.bands import RESOLVED_STEP_NM
from splits.kernels.interpolation import STENCIL_SIZE, find_first_node, set_lagrange_weights

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
    allowed = f"from {nodes[0]:g} to {nodes[-1]:g}, as far as the table goes"
    if np.ndim(as_scalar(value)):
        hint = "repeat the call for each, such as for the parts of an image with one sun"
        raise invalid(name, value, f"one number {allowed}", hint)
    x = float(snap_to_limits(check_number(name, value), nodes[0], nodes[-1]))
    if not nodes[0] <= x <= nodes[-1]:
        raise invalid(name, value, allowed)
    return x


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
