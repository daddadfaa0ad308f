"""Interpolation along one axis of a table, and what it misses.

Values between nodes are those of the cubic through the four nearest nodes, in a coordinate along
which light changes evenly: the logarithm of a size, the cosine of an angle.  What a cubic misses at
x is f⁗/24 times the product of the distances of its nodes from x.  So every node that is left out,
and found again from its neighbours, tells f⁗ near it.  Where there are no more than four nodes,
what the last of them adds stands for what one more would.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.validation import check_number, invalid, snap_to_limits

STENCIL_SIZE = 4
"""Nodes that a value is drawn from."""


class InterpolationWeights(NamedTuple):
    """How a value between nodes is drawn from them.

    Attributes
    ----------
    nodes : int, shape (drawn,)
    weights : float, shape (drawn,)
        Their sum is 1.
    validation_nodes : int, shape (near,)
        Nodes nearby that are to be found again from others.
    error_weights : float, shape (near, nodes of the axis)
        What is to be added up for what these others miss there, as large as what is missed here.
    """

    nodes: np.ndarray
    weights: np.ndarray
    validation_nodes: np.ndarray
    error_weights: np.ndarray

    def restrict_to(self, kept_nodes: np.ndarray) -> InterpolationWeights:
        """Return the same of an axis that has only some of its nodes, in their order."""
        nodes, left_out = (
            np.searchsorted(kept_nodes, row) for row in (self.nodes, self.validation_nodes)
        )
        return InterpolationWeights(
            nodes, self.weights, left_out, self.error_weights[:, kept_nodes]
        )


def transform_axis(name: str, nodes: np.ndarray) -> tuple[str, np.ndarray]:
    """Return by which law an axis is interpolated, and its nodes so.

    Of amounts: logarithms where all are positive and the largest is three times the smallest;
    roots where they begin with 0, as absorption goes.
    """
    if name == "incidence_deg":
        return "cosine", apply_axis_transform("cosine", nodes)
    if name != "wavelength" and nodes[0] > 0.0 and nodes[-1] >= 3.0 * nodes[0]:
        return "logarithm", apply_axis_transform("logarithm", nodes)
    if name != "wavelength" and nodes[0] == 0.0 and nodes.size > 2:
        return "root", apply_axis_transform("root", nodes)
    return "itself", apply_axis_transform("itself", nodes)


def apply_axis_transform(transform: str, values: np.ndarray) -> np.ndarray:
    """Return values as a law has them."""
    values = np.asarray(values, dtype=float)
    if transform == "cosine":
        return -np.cos(np.radians(values))
    if transform == "logarithm":
        return np.log(values)
    return np.sqrt(values) if transform == "root" else values


def check_within_axis(name: str, nodes: np.ndarray, value: object) -> float:
    """Return a place on the axis of a table as a number, or refuse it.

    Raises
    ------
    ValueError
        Outside the axis.
    """
    allowed = f"from {nodes[0]:g} to {nodes[-1]:g}, as far as the table goes"
    x = float(snap_to_limits(check_number(name, value), nodes[0], nodes[-1]))
    if not nodes[0] <= x <= nodes[-1]:
        raise invalid(name, value, allowed)
    return x


def compute_interpolation_weights(
    name: str, nodes: np.ndarray, value: object
) -> InterpolationWeights:
    """Return how a value is drawn from the nodes of an axis.

    Raises
    ------
    ValueError
        Outside the axis.
    """
    kind, at = transform_axis(name, nodes)
    x = float(apply_axis_transform(kind, np.array(check_within_axis(name, nodes, value))))
    drawn = _find_nearest_nodes(at, x, STENCIL_SIZE)
    share = _compute_lagrange_weights(at[drawn], x)
    beyond = float(np.prod(x - at[drawn]))
    if len(at) == 2 and beyond != 0.0:
        # No node can be left out: a quarter of the difference, in the middle.
        return InterpolationWeights(
            drawn, share, drawn[:1], np.prod(share) * np.array([[-1.0, 1.0]])
        )
    if beyond == 0.0:
        # At a node nothing is missed.
        return InterpolationWeights(drawn, share, drawn[:0], np.zeros((0, len(at))))
    ordered = drawn[np.argsort(np.abs(at[drawn] - x), kind="stable")]
    if len(at) <= STENCIL_SIZE:
        # All are needed: what the farthest of them adds stands for what one more would.
        last = np.zeros((1, len(at)))
        last[0, drawn] += share
        last[0, ordered[:-1]] -= _compute_lagrange_weights(at[ordered[:-1]], x)
        return InterpolationWeights(drawn, share, ordered[-1:], last)
    near = ordered[:2]
    others = np.zeros((len(near), len(at)))
    for row, node in enumerate(near):
        rest = np.delete(np.arange(len(at)), node)
        few = rest[_find_nearest_nodes(at[rest], at[node], STENCIL_SIZE)]
        scale = abs(beyond / float(np.prod(at[node] - at[few])))
        others[row, node] += scale
        others[row, few] -= scale * _compute_lagrange_weights(at[few], at[node])
    return InterpolationWeights(drawn, share, near, others)


def _find_nearest_nodes(nodes: np.ndarray, x: float, n_nodes: int) -> np.ndarray:
    """Return the nodes around x, as many on either side as there are."""
    n_nodes = min(n_nodes, len(nodes))
    right = int(np.searchsorted(nodes, x))
    first = min(max(right - n_nodes // 2, 0), len(nodes) - n_nodes)
    return np.arange(first, first + n_nodes)


def _compute_lagrange_weights(nodes: np.ndarray, x: float) -> np.ndarray:
    """Return the weights of Lagrange's polynomial."""
    share = np.ones(len(nodes))
    for i, one in enumerate(nodes):
        for j, other in enumerate(nodes):
            if i != j:
                share[i] *= (x - other) / (one - other)
    return share
