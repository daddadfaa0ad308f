"""Interpolation along one axis of a table, with an estimate of its error.

Values between nodes are those of the cubic through the four nearest nodes, in a transformed
coordinate in which reflectance varies smoothly: the logarithm of a size, the cosine of an angle.
The error of a cubic at x is f⁗/24 times the product of the distances of its nodes from x.  The
error of predicting a node from its neighbours therefore gives an estimate of f⁗ near it.  For axes
of at most four nodes, the contribution of the farthest node replaces that of an additional node.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.validation import check_number, invalid, snap_to_limits

STENCIL_SIZE = 4
"""Largest number of nodes in an interpolation stencil."""
N_VALIDATION_NODES = 2
"""Number of nodes that are predicted from others.  All nodes of the stencil are with directions,
because distributions have details, such as halos, in a few intervals only."""


class InterpolationWeights(NamedTuple):
    """Interpolation stencil of a value on an axis, with the weights of error estimates.

    Attributes
    ----------
    nodes : int, shape (stencil,)
        Nodes of the stencil.
    weights : float, shape (stencil,)
        Interpolation weights, with a sum of 1.
    validation_nodes : int, shape (validation,)
        Nearby nodes that are predicted from others.
    error_weights : float, shape (validation, nodes)
        Weights of all nodes of the axis in each error estimate: the error of the prediction of a
        validation node, scaled to the position of the value.
    """

    nodes: np.ndarray
    weights: np.ndarray
    validation_nodes: np.ndarray
    error_weights: np.ndarray

    def restrict_to(self, kept_nodes: np.ndarray) -> InterpolationWeights:
        """Return the weights for an axis reduced to some of its nodes, in order."""
        nodes, validation = (
            np.searchsorted(kept_nodes, row) for row in (self.nodes, self.validation_nodes)
        )
        return InterpolationWeights(
            nodes, self.weights, validation, self.error_weights[:, kept_nodes]
        )


def transform_axis(
    name: str, nodes: np.ndarray, *, has_direction: bool = False
) -> tuple[str, np.ndarray]:
    """Return the transform of an axis for interpolation, and its transformed nodes.

    Positive amounts that span at least a factor of three are transformed to logarithms.  Amounts
    that begin with 0 are transformed to square roots, because reflectance is nearly linear in the
    square root of absorption.  Polar angles remain as they are, with incidences for one direction
    of observation (`has_direction`): the distributions vary linearly with them at the normal.
    """
    if name == "azimuth_deg" or (name == "incidence_deg" and not has_direction):
        return "cosine", apply_axis_transform("cosine", nodes)
    if name in ("polar_deg", "incidence_deg"):
        return "identity", apply_axis_transform("identity", nodes)
    if name != "wavelength" and nodes[0] > 0.0 and nodes[-1] >= 3.0 * nodes[0]:
        return "logarithm", apply_axis_transform("logarithm", nodes)
    if name != "wavelength" and nodes[0] == 0.0 and nodes.size > 2:
        return "square_root", apply_axis_transform("square_root", nodes)
    return "identity", apply_axis_transform("identity", nodes)


def apply_axis_transform(transform: str, values: np.ndarray) -> np.ndarray:
    """Return transformed values."""
    values = np.asarray(values, dtype=float)
    if transform == "cosine":
        return -np.cos(np.radians(values))
    if transform == "logarithm":
        return np.log(values)
    return np.sqrt(values) if transform == "square_root" else values


def check_within_axis(name: str, nodes: np.ndarray, value: object) -> float:
    """Return a position on an axis of a table as a number within the axis.

    Raises
    ------
    ValueError
        For a value outside the axis.
    """
    allowed = f"from {nodes[0]:g} to {nodes[-1]:g}, as far as the table goes"
    x = float(snap_to_limits(check_number(name, value), nodes[0], nodes[-1]))
    if not nodes[0] <= x <= nodes[-1]:
        raise invalid(name, value, allowed)
    return x


def compute_interpolation_weights(
    name: str, nodes: np.ndarray, value: object, *, has_direction: bool = False
) -> InterpolationWeights:
    """Return the interpolation weights of a value on an axis.

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
    x = float(apply_axis_transform(kind, np.array(check_within_axis(name, nodes, value))))
    stencil = _find_nearest_nodes(coordinates, x, STENCIL_SIZE)
    weights = _compute_lagrange_weights(coordinates[stencil], x)
    node_product = float(np.prod(x - coordinates[stencil]))
    if len(coordinates) == 2 and node_product != 0.0:
        # No node can be omitted; the estimate is a quarter of the difference at the midpoint.
        return InterpolationWeights(
            stencil, weights, stencil[:1], np.prod(weights) * np.array([[-1.0, 1.0]])
        )
    if node_product == 0.0:
        # No error at a node.
        return InterpolationWeights(stencil, weights, stencil[:0], np.zeros((0, len(coordinates))))
    ordered = stencil[np.argsort(np.abs(coordinates[stencil] - x), kind="stable")]
    if len(coordinates) <= STENCIL_SIZE:
        # All nodes are needed; the contribution of the farthest replaces that of one more.
        error_row = np.zeros((1, len(coordinates)))
        error_row[0, stencil] += weights
        error_row[0, ordered[:-1]] -= _compute_lagrange_weights(coordinates[ordered[:-1]], x)
        return InterpolationWeights(stencil, weights, ordered[-1:], error_row)
    validation = ordered if has_direction else ordered[:N_VALIDATION_NODES]
    error_weights = np.zeros((len(validation), len(coordinates)))
    for row, node in enumerate(validation):
        remaining = np.delete(np.arange(len(coordinates)), node)
        neighbours = remaining[
            _find_nearest_nodes(coordinates[remaining], coordinates[node], STENCIL_SIZE)
        ]
        scale = abs(node_product / float(np.prod(coordinates[node] - coordinates[neighbours])))
        error_weights[row, node] += scale
        error_weights[row, neighbours] -= scale * _compute_lagrange_weights(
            coordinates[neighbours], coordinates[node]
        )
    return InterpolationWeights(stencil, weights, validation, error_weights)


def _find_nearest_nodes(nodes: np.ndarray, x: float, n_nodes: int) -> np.ndarray:
    """Return the nodes around x, with equal numbers on both sides where possible."""
    n_nodes = min(n_nodes, len(nodes))
    right = int(np.searchsorted(nodes, x))
    first = min(max(right - n_nodes // 2, 0), len(nodes) - n_nodes)
    return np.arange(first, first + n_nodes)


def _compute_lagrange_weights(nodes: np.ndarray, x: float) -> np.ndarray:
    """Return the weights of the Lagrange polynomial at x."""
    weights = np.ones(len(nodes))
    for i, node in enumerate(nodes):
        for j, other_node in enumerate(nodes):
            if i != j:
                weights[i] *= (x - other_node) / (node - other_node)
    return weights
