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
from typing import NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.media.medium import Interface

# --------------------------------------------------------------------------------------------------
# Bounds on the error of interpolation between refractive indices.

MAX_LOG_SLOPE = 0.3
MAX_LOG_CURVATURE = 0.25
"""Bounds on |df/d(ln x)| and |d²f/d(ln x)²| for f a reflectance, transmittance or absorptance and
x the mean contrast or the light that enters absorbing grains; `benchmarks/accuracy.py`
measures them for snow and sand."""
INTERFACE_WEIGHT = 0.5
"""Weight of a boundary in units of these bounds.  For its contrast c, external reflection changes
by at most 0.04 per d(ln c), internal reflection of diffuse light by 0.3, and the light that escapes
from a weakly absorbing sample by at most half of that."""
MIN_INTERFACE_CONTRAST = 0.25
"""Contrast of a boundary below which these bounds are proportional to it, as it reflects less."""
DENSE_SIDE_FACTOR = 2.0
"""Factor on `INTERFACE_WEIGHT` for light incident from the dense side: its reflection is total
above the critical angle."""
CONTRAST_KINK = 4.0 / 3.0
"""Half the change of slope where the contrast c of a boundary is 0: weak contrasts reflect c/3
of diffuse light from the thin side and 7c/3 from the dense one, and the sides change at 0."""
INTERPOLATION_FACTOR = 8.0
"""Relative error of a BRDF, or of a fraction near 0, in units of the bound for a fraction near 1/2.
It allows for elasticities up to 2.4; that of a single reflection is 4/(2 + c)."""
ABSORBING_K = 1e-3
"""Extinction coefficient at which a material counts half as absorbing: a grain of a tenth of a
millimetre then absorbs most of the visible light that enters it."""


def compute_contrasts(index: np.ndarray, interfaces: Sequence[Interface]) -> np.ndarray:
    """Return the contrasts of interfaces times their fractions, shape (wavelengths, interfaces)."""
    return _compute_weighted_contrasts(
        *_get_interface_indices(index, select_grain_interfaces(interfaces))
    )


def select_grain_interfaces(interfaces: Sequence[Interface]) -> list[Interface]:
    """Return the interfaces of grains, without the boundaries of layers."""
    return [interface for interface in interfaces if interface.location != "boundary"]


def _compute_weighted_contrasts(
    near: np.ndarray, far: np.ndarray, fraction: np.ndarray
) -> np.ndarray:
    # 2√F/(1 − √F) without the difference, which cancels for nearly perfect conductors.
    difference, total = np.abs(far - near), np.abs(far + near)
    magnitude = difference * (total + difference) / (2.0 * (far * near.conj()).real)
    return fraction * np.sign(far.real - near.real) * magnitude


def compute_entering_light(index: np.ndarray, interfaces: Sequence[Interface]) -> np.ndarray:
    """Return the light that enters absorbing grains, shape (wavelengths, interfaces).

    Interfaces within grains, and grains that hardly absorb at any wavelength, count as 0.
    """
    interfaces = select_grain_interfaces(interfaces)
    near, far, fraction = _get_interface_indices(index, interfaces)
    is_outer = np.array([i.location == "outer" for i in interfaces])
    k = far.imag.max(axis=0)
    entering = 1.0 - np.abs((far - near) / (far + near)) ** 2
    return is_outer * fraction * k / (k + ABSORBING_K) * entering


def _get_interface_indices(
    index: np.ndarray, interfaces: Sequence[Interface]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    near = index[:, [i.outer_material for i in interfaces]]
    far = index[:, [i.inner_material for i in interfaces]]
    return near, far, np.array([i.fraction for i in interfaces])


def bound_fraction_error(interpolation_bound: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return a bound on the interpolation error of a fraction of the light, or of a moment.

    Near 0 and 1 a fraction changes in proportion to its distance from there.
    """
    relative_slope = np.abs(INTERPOLATION_FACTOR * value * (1.0 - value))
    return interpolation_bound * np.clip(relative_slope, 0.0, 1.0)


def bound_derivative_error(interpolation_bound: np.ndarray, derivative: np.ndarray) -> np.ndarray:
    """Return a bound on the interpolation error of a derivative.

    Its relative error is that of light that is nearly all reflected or nearly all absorbed.
    """
    return np.clip(INTERPOLATION_FACTOR * interpolation_bound, 0.0, 1.0) * np.abs(derivative)


class Criterion(NamedTuple):
    """Criterion for the interpolation error of a layer.

    Attributes
    ----------
    weight : float
        Of the first- and second-order errors.
    values : float, shape (wavelengths, n)
    min_scale : float
        Scale below which changes are absolute instead of relative.
    kink : float
        Half the change of slope where the value, the only one, is 0.
    """

    weight: float
    values: np.ndarray
    min_scale: float = 0.0
    kink: float = 0.0


def make_criteria(index: np.ndarray, interfaces: Sequence[Interface]) -> list[Criterion]:
    """Return the criteria of a layer."""
    criteria = [
        Criterion(1.0, compute_contrasts(index, interfaces)),
        Criterion(1.0, compute_entering_light(index, interfaces)),
    ]
    for boundary in (interface for interface in interfaces if interface.location == "boundary"):
        near, far, fraction = _get_interface_indices(index, [boundary])
        values = _compute_weighted_contrasts(near, far, np.ones_like(fraction))
        weight, kink = INTERFACE_WEIGHT * boundary.fraction, CONTRAST_KINK * boundary.fraction
        if (values < 0.0).any():
            weight *= DENSE_SIDE_FACTOR
        criteria.append(Criterion(weight, values, MIN_INTERFACE_CONTRAST, kink))
    return criteria


def project_on_chord(u: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the weight of a in the convex combination of a and b nearest to each row of u."""
    along = a - b
    square = along @ along
    if square == 0.0:
        return np.ones(len(u))
    return np.clip((u - b) @ along / square, 0.0, 1.0)


def bound_smooth_error(criterion: Criterion, first: int, second: int, t: np.ndarray) -> np.ndarray:
    """Return a bound on |t·f(a) + (1 − t)·f(b) − f(u)| for every row u, of two rows a and b.

    The first order is `MAX_LOG_SLOPE` times the relative distance of u from the chord; the second,
    the gap of Jensen's inequality, `MAX_LOG_CURVATURE`/2 times the mean square of the relative
    distances from both ends.
    """
    u, a, b = criterion.values, criterion.values[first], criterion.values[second]
    size = np.abs(u).sum(axis=1)

    def compute_relative_distance(distance: np.ndarray, other: np.ndarray | float) -> np.ndarray:
        scale = np.maximum(np.minimum(size, other), criterion.min_scale)
        is_positive = distance > 0.0
        relative = np.where(is_positive, np.inf, 0.0)
        return np.divide(distance, scale, out=relative, where=is_positive & (scale > 0.0))

    chord = t[:, np.newaxis] * a + (1.0 - t)[:, np.newaxis] * b
    chord_distance = compute_relative_distance(np.abs(chord - u).sum(axis=1), np.inf)
    total = MAX_LOG_SLOPE * chord_distance
    for end, weight in ((a, t), (b, 1.0 - t)):
        end_distance = compute_relative_distance(np.abs(end - u).sum(axis=1), np.abs(end).sum())
        gap = np.multiply(weight, end_distance**2, out=np.zeros(len(u)), where=weight > 0.0)
        total += 0.5 * MAX_LOG_CURVATURE * gap
    return total


def bound_kink_error(criterion: Criterion, first: int, second: int, t: np.ndarray) -> np.ndarray:
    """Return the additional bound for a kink at 0: nothing, if all values have one sign."""
    if criterion.kink == 0.0:
        return np.zeros(len(t))
    a, b = criterion.values[first], criterion.values[second]
    chord = t[:, np.newaxis] * a + (1.0 - t)[:, np.newaxis] * b
    end_gap = t * np.abs(a).sum() + (1.0 - t) * np.abs(b).sum() - np.abs(chord).sum(axis=1)
    crossed = np.sign(chord) * np.sign(criterion.values) < 0.0
    overlap = np.minimum(np.abs(chord), np.abs(criterion.values))
    overshoot = np.where(crossed, overlap, 0.0).sum(axis=1)
    return criterion.kink * (np.maximum(end_gap, 0.0) + 2.0 * overshoot)


# --------------------------------------------------------------------------------------------------
# Index nodes: a few refractive indices from which a whole spectrum is interpolated.

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
        Refractive indices (see `splits.kernels.scene`).
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
            if len(distinct) > MAX_SEPARATE_NODES:
                raise invalid(
                    "wavelength_nm", f"{len(distinct)} wavelengths",
                    f"at most {MAX_SEPARATE_NODES} for this error",
                    f"interpolation errors up to {tolerance:.1g} require separate paths for each; "
                    "choose a larger error or fewer wavelengths",
                )  # fmt: skip
            assignment.assign_separate_nodes()
    rows = assignment.get_used_nodes()
    return IndexNodes(
        distinct[rows],
        assignment.compute_weights(rows)[:, inverse],
        assignment.interpolation_bound[inverse],
    )


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
