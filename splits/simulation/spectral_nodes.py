"""Index nodes: a few refractive indices from which a whole spectrum is interpolated.

The weight of a path includes absorption at every wavelength at once; reflection and refraction
depend on wavelength only through refractive indices, which change slowly.  Paths are therefore
traced at a few *nodes*, the indices of some of the wavelengths, and each wavelength is estimated
from one node or, linearly, from a pair.

The interpolation error is bounded by means of two vectors of interfaces.  The first holds their
contrasts, each weighted by the fraction of interactions at it; the contrast of an interface is that
of the transparent pair with the same reflectance at normal incidence,

    c = ± 2√F / (1 − √F),   F = |(m₂ − m₁)/(m₂ + m₁)|²,   with the sign of n₂ − n₁,

so n₂/n₁ − 1 where nothing absorbs and n₂ > n₁, and extinction counts as far as it reflects.  The
second holds the light that enters absorbing grains, 1 − F times their fraction: where most grains
are clear, few absorbing ones determine the result.  Boundaries of wet pores, with the air or with
the matrix of particles, are considered one by one, times the fraction of the light that reaches
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splits.core.validation import invalid
from splits.media.medium import Interface
from splits.simulation.interpolation_bounds import (
    bound_kink_error,
    bound_smooth_error,
    compute_contrasts,
    make_criteria,
    project_on_chord,
)

MAX_NODES = 64
"""Number of nodes above which every wavelength becomes a node of its own."""

INTERPOLATION_FRACTION = 0.4
"""Fraction of the requested error of a spectrum that interpolation between indices may be."""
MAX_SEPARATE_NODES = 2500
"""Largest number of wavelengths that can be nodes of their own: memory is proportional to its
square."""


@dataclass(frozen=True)
class IndexNodes:
    """Index nodes and the weights with which wavelengths use them.

    Attributes
    ----------
    index : complex, shape (nodes, materials)
        Refractive indices to trace with.
    weights : float, shape (nodes, wavelengths)
        Convex weights; each column sums to 1.
    interpolation_bound : float, shape (wavelengths,)
        Bound on the error of interpolation.
    """

    index: np.ndarray
    weights: np.ndarray
    interpolation_bound: np.ndarray


def choose_nodes(
    index: np.ndarray, interfaces: Sequence[Interface], tolerance: float
) -> IndexNodes:
    """Return few nodes, such that the interpolation error stays below a tolerance everywhere.

    Nodes are added one by one, each at the wavelength with the largest error bound so far.

    Parameters
    ----------
    index : complex, shape (wavelengths, materials)
        Refractive indices (see `splits.kernels.base.scene`).
    interfaces : sequence of Interface
        Interfaces of the medium and their fractions.
    tolerance : float
        Largest `IndexNodes.interpolation_bound` allowed.
    """
    distinct, inverse = np.unique(index, axis=0, return_inverse=True)
    inverse = inverse.reshape(-1)
    contrasts = compute_contrasts(distinct, interfaces)
    start = int(np.abs(contrasts).sum(axis=1).argmax())
    assignment = _NodeAssignment(distinct, interfaces, start)
    chosen = [int(assignment.first[0])]
    while assignment.interpolation_bound.max() > tolerance:
        new = int(assignment.interpolation_bound.argmax())
        assignment.try_node(new, chosen)
        chosen.append(new)
        if len(chosen) > MAX_NODES:
            _check_separate_nodes(len(distinct), tolerance)
            assignment.assign_separate_nodes()
    rows = assignment.get_used_nodes()
    return IndexNodes(
        distinct[rows],
        assignment.compute_weights(rows)[:, inverse],
        assignment.interpolation_bound[inverse],
    )


def _check_separate_nodes(n_wavelengths: int, tolerance: float) -> None:
    """Check that there are not too many wavelengths for an ensemble of paths each."""
    if n_wavelengths > MAX_SEPARATE_NODES:
        raise invalid(
            "wavelength_nm", f"{n_wavelengths} wavelengths",
            f"at most {MAX_SEPARATE_NODES} for this error",
            f"interpolation errors up to {tolerance:.1g} require separate paths for each; "
            "choose a larger error or fewer wavelengths",
        )  # fmt: skip


def make_nodes(
    index: np.ndarray, interfaces: Sequence[Interface], rows: Sequence[int]
) -> IndexNodes:
    """Return the nodes at given wavelengths, each wavelength assigned to the best of them.

    All of `rows` are kept, in their order, even if no wavelength uses one.

    Parameters
    ----------
    index : complex, shape (wavelengths, materials)
        Refractive indices.
    interfaces : sequence of Interface
        Interfaces of the medium and their fractions.
    rows : sequence of int
        Different rows of `index`, at least one.
    """
    assignment = _NodeAssignment(index, interfaces, rows[0])
    for i, row in enumerate(rows):
        assignment.try_node(row, rows[:i])
    return IndexNodes(
        index[list(rows)], assignment.compute_weights(rows), assignment.interpolation_bound
    )


def make_separate_nodes(index: np.ndarray) -> IndexNodes:
    """Return a node for each wavelength, see `choose_nodes`."""
    if len(index) > MAX_SEPARATE_NODES:
        raise invalid(
            "wavelength_nm", f"{len(index)} wavelengths", f"at most {MAX_SEPARATE_NODES}",
            "each is traced separately",
        )  # fmt: skip
    return IndexNodes(index, np.eye(len(index)), np.zeros(len(index)))


class _NodeAssignment:
    """Assignment of wavelengths to nodes: one, or a weighted pair.

    Attributes
    ----------
    first, second : int, shape (wavelengths,)
        Rows of the nodes used.
    first_weight : float, shape (wavelengths,)
        Weight of the first; the second has the rest.
    interpolation_bound : float, shape (wavelengths,)
        Bound on the interpolation error.
    """

    def __init__(self, index: np.ndarray, interfaces: Sequence[Interface], start: int) -> None:
        self.grain_contrasts = compute_contrasts(index, interfaces)
        self.layer_criteria = [
            make_criteria(index, [i for i in interfaces if i.layer == layer])
            for layer in sorted({i.layer for i in interfaces})
        ]
        count = len(index)
        self.first, self.second = np.full((2, count), start)
        self.first_weight = np.ones(count)
        self.interpolation_bound = self._compute_bound(start, start, self.first_weight)

    def try_node(self, new: int, partners: Sequence[int]) -> None:
        """Assign wavelengths to a new node, alone or paired, where that lowers the error bound."""
        for partner in [new, *partners]:
            contrasts = self.grain_contrasts
            weight = project_on_chord(contrasts, contrasts[new], contrasts[partner])
            bound = self._compute_bound(new, partner, weight)
            better = bound < self.interpolation_bound
            self.first[better], self.second[better] = new, partner
            self.first_weight[better] = weight[better]
            self.interpolation_bound[better] = bound[better]

    def _compute_bound(self, a: int, b: int, t: np.ndarray) -> np.ndarray:
        # The error of all layers together is at most the largest that one alone would have.
        largest = np.zeros(len(t))
        for criteria in self.layer_criteria:
            errors = (
                criterion.weight * bound_smooth_error(criterion, a, b, t)
                + bound_kink_error(criterion, a, b, t)
                for criterion in criteria
            )
            largest = np.maximum(largest, sum(errors, np.zeros(len(t))))
        return largest

    def assign_separate_nodes(self) -> None:
        """Make every wavelength a node of its own."""
        count = len(self.first_weight)
        self.first = self.second = np.arange(count)
        self.first_weight, self.interpolation_bound = np.ones(count), np.zeros(count)

    def get_used_nodes(self) -> np.ndarray:
        """Return the rows of the nodes that some wavelength uses, in order."""
        return np.unique(
            np.concatenate([self.first[self.first_weight > 0], self.second[self.first_weight < 1]])
        )

    def compute_weights(self, rows: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return convex weights, shape (rows, wavelengths), of nodes that include all used ones."""
        wavelengths = np.arange(len(self.first_weight))
        # Nodes that are not used have no weight in any row.
        position = np.zeros_like(wavelengths)
        position[np.asarray(rows)] = np.arange(len(rows))
        weights = np.zeros((len(rows), len(wavelengths)))
        weights[position[self.first], wavelengths] += self.first_weight
        weights[position[self.second], wavelengths] += 1.0 - self.first_weight
        return weights
