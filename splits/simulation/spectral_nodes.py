"""A few refractive indices that stand for a whole spectrum.

Absorption is a weight that a path carries for every wavelength at once; reflection and
refraction are not, but they depend on wavelength only through refractive indices that change
slowly.  Paths are therefore traced at a few *nodes*, the indices of some of the wavelengths, and
each wavelength takes its answer from one node or, linearly, from a pair.

What a node misses is judged by two vectors of interfaces that light meets.  The first holds their
contrasts, each weighted by its share; the contrast of an interface is that of the transparent pair
with the same reflectance at normal incidence,

    c = ± 2√F / (1 − √F),   F = |(m₂ − m₁)/(m₂ + m₁)|²,   with the sign of n₂ − n₁,

so n₂/n₁ − 1 where nothing absorbs and n₂ > n₁, and extinction counts as far as it reflects.  The
second holds the light that enters absorbing grains, 1 − F times their share: where most grains
are clear, few dark ones decide.  Faces of wet pores, with the air or with what particles lie in,
are judged one by one, times the share of the light that meets them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.media.medium import Interface

MAX_LOG_SLOPE = 0.3
MAX_LOG_CURVATURE = 0.25
"""Bounds on |df/d(ln x)| and |d²f/d(ln x)²| for f a reflectance, transmittance or absorptance and
x the mean contrast or the light that enters absorbing grains; `benchmarks/interpolation.py`
measures them for snow and sand."""

INTERFACE_WEIGHT = 0.5
"""A face in units of these bounds.  With its contrast c, external reflection moves by at most 0.04
per d(ln c), internal reflection of diffuse light by 0.3, and what escapes from a bright sample by
at most half of that."""

MIN_INTERFACE_CONTRAST = 0.25
"""Contrast of a face below which these bounds are in proportion to it: less is reflected."""

DENSE_SIDE_FACTOR = 2.0
"""How much more a face moves that light meets from its dense side, in units of `INTERFACE_WEIGHT`: what is
reflected there is total beyond the critical angle."""

CONTRAST_KINK = 4.0 / 3.0
"""Half the change of slope where a face's contrast c goes through 0: little contrast reflects c/3
of diffuse light from the thin side and 7c/3 from the dense one, and there these change places."""

ABSORBING_K = 1e-3
"""Extinction coefficient at which a material counts half as absorbing: a grain of a tenth of a
millimetre then absorbs most of the visible light that enters it."""

MAX_NODES = 64
"""Where more would be needed, every wavelength becomes a node of its own."""

MAX_SEPARATE_NODES = 2500
"""Wavelengths that can be nodes of their own: memory goes with the square of their number."""


@dataclass(frozen=True)
class IndexNodes:
    """Nodes and the weights with which wavelengths draw on them.

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


def compute_contrasts(index: np.ndarray, interfaces: Sequence[Interface]) -> np.ndarray:
    """Return the contrast of every interface times its share, shape (wavelengths, interfaces)."""
    return _compute_weighted_contrasts(
        *_get_interface_indices(index, select_grain_interfaces(interfaces))
    )


def select_grain_interfaces(interfaces: Sequence[Interface]) -> list[Interface]:
    """Return the interfaces that are no faces of layers."""
    return [i for i in interfaces if i.location != "face"]


def _compute_weighted_contrasts(
    near: np.ndarray, far: np.ndarray, fraction: np.ndarray
) -> np.ndarray:
    # 2√F/(1 − √F) without the difference, which has no digits left for perfect conductors.
    away, along = np.abs(far - near), np.abs(far + near)
    magnitude = away * (along + away) / (2.0 * (far * near.conj()).real)
    return fraction * np.sign(far.real - near.real) * magnitude


def compute_entering_light(index: np.ndarray, interfaces: Sequence[Interface]) -> np.ndarray:
    """Return the light that enters absorbing grains, shape (wavelengths, interfaces).

    Interfaces within grains do not count, nor do grains that hardly absorb at any wavelength.
    """
    interfaces = select_grain_interfaces(interfaces)
    near, far, share = _get_interface_indices(index, interfaces)
    outer = np.array([i.location == "outer" for i in interfaces])
    k = far.imag.max(axis=0)
    return outer * share * k / (k + ABSORBING_K) * (1.0 - np.abs((far - near) / (far + near)) ** 2)


def _get_interface_indices(
    index: np.ndarray, interfaces: Sequence[Interface]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    near = index[:, [i.outer_material for i in interfaces]]
    far = index[:, [i.inner_material for i in interfaces]]
    return near, far, np.array([i.fraction for i in interfaces])


def choose_nodes(
    index: np.ndarray, interfaces: Sequence[Interface], tolerance: float
) -> IndexNodes:
    """Return few nodes, such that the interpolation error stays below a tolerance everywhere.

    Nodes are added one by one, each the wavelength served worst so far.

    Parameters
    ----------
    index : complex, shape (wavelengths, materials)
        Refractive indices (see `splits.kernels.grains.scene`).
    interfaces : sequence of Interface
        What light meets, and how often.
    tolerance : float
        Largest `Nodes.bias` allowed.
    """
    distinct, which = np.unique(index, axis=0, return_inverse=True)
    which = which.reshape(-1)
    u = compute_contrasts(distinct, interfaces)
    start = int(np.abs(u).sum(axis=1).argmax())
    draws = _NodeAssignment(distinct, interfaces, start)
    chosen = [int(draws.first[0])]
    while draws.interpolation_bound.max() > tolerance:
        new = int(draws.interpolation_bound.argmax())
        draws.try_node(new, chosen)
        chosen.append(new)
        if len(chosen) > MAX_NODES:
            _check_separate_nodes(len(distinct), tolerance)
            draws.assign_separate_nodes()
    rows = draws.get_used_nodes()
    return IndexNodes(
        distinct[rows], draws.compute_weights(rows)[:, which], draws.interpolation_bound[which]
    )


def _check_separate_nodes(n_wavelengths: int, tolerance: float) -> None:
    """Refuse more wavelengths than can have an ensemble of paths each."""
    if n_wavelengths > MAX_SEPARATE_NODES:
        raise invalid(
            "wavelength_nm", f"{n_wavelengths} wavelengths", f"at most {MAX_SEPARATE_NODES} at so small an error",
            f"with interpolation errors up to {tolerance:.1g} each takes paths of its own; "
            "ask for a larger error or fewer wavelengths",
        )  # fmt: skip


def make_nodes(
    index: np.ndarray, interfaces: Sequence[Interface], rows: Sequence[int]
) -> IndexNodes:
    """Return the nodes at given wavelengths, each wavelength served by the best of them.

    All of `rows` are kept, in their order, even if no wavelength draws on one.

    Parameters
    ----------
    index : complex, shape (wavelengths, materials)
        Refractive indices.
    interfaces : sequence of Interface
        What light meets, and how often.
    rows : sequence of int
        Different rows of `index`, at least one.
    """
    draws = _NodeAssignment(index, interfaces, rows[0])
    for i, row in enumerate(rows):
        draws.try_node(row, rows[:i])
    return IndexNodes(index[list(rows)], draws.compute_weights(rows), draws.interpolation_bound)


class _NodeAssignment:
    """Which nodes every wavelength draws on: one, or two with shares.

    Attributes
    ----------
    first, second : int, shape (wavelengths,)
        Rows of the nodes drawn on.
    first_weight : float, shape (wavelengths,)
        Weight of the first; the second has the rest.
    interpolation_bound : float, shape (wavelengths,)
        Bound on what this misses.
    """

    def __init__(self, index: np.ndarray, interfaces: Sequence[Interface], start: int) -> None:
        self.grain_contrasts = compute_contrasts(index, interfaces)
        self.layer_criteria = [
            _make_criteria(index, [i for i in interfaces if i.layer == layer])
            for layer in sorted({i.layer for i in interfaces})
        ]
        count = len(index)
        self.first, self.second = np.full((2, count), start)
        self.first_weight = np.ones(count)
        self.interpolation_bound = self._compute_bound(start, start, self.first_weight)

    def try_node(self, new: int, partners: Sequence[int]) -> None:
        """Let every wavelength use a new node, alone or with one of the others, if that helps."""
        for partner in [new, *partners]:
            u = self.grain_contrasts
            t = _project_on_chord(u, u[new], u[partner])
            trial = self._compute_bound(new, partner, t)
            better = trial < self.interpolation_bound
            self.first[better], self.second[better] = new, partner
            self.first_weight[better], self.interpolation_bound[better] = t[better], trial[better]

    def _compute_bound(self, a: int, b: int, t: np.ndarray) -> np.ndarray:
        # What all layers miss together is at most what the worst would, alone in its place.
        worst = np.zeros(len(t))
        for parts in self.layer_criteria:
            missed = (
                part.weight * _bound_smooth_error(part, a, b, t) + _bound_kink_error(part, a, b, t)
                for part in parts
            )
            worst = np.maximum(worst, sum(missed, np.zeros(len(t))))
        return worst

    def assign_separate_nodes(self) -> None:
        """Make every wavelength a node of its own."""
        count = len(self.first_weight)
        self.first = self.second = np.arange(count)
        self.first_weight, self.interpolation_bound = np.ones(count), np.zeros(count)

    def get_used_nodes(self) -> np.ndarray:
        """Return the rows of the nodes that some wavelength draws on, in order."""
        return np.unique(
            np.concatenate([self.first[self.first_weight > 0], self.second[self.first_weight < 1]])
        )

    def compute_weights(self, rows: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return convex weights, shape (rows, wavelengths), of nodes that hold all drawn on."""
        place = np.full(len(self.first_weight), -1)
        place[np.asarray(rows)] = np.arange(len(rows))
        every = np.arange(len(self.first_weight))
        weights = np.zeros((len(rows), len(every)))
        for node, share in (
            (self.first, self.first_weight),
            (self.second, 1.0 - self.first_weight),
        ):
            used = share > 0.0
            weights[place[node[used]], every[used]] += share[used]
        return weights


class _Criterion(NamedTuple):
    """What a layer is judged by.

    Attributes
    ----------
    weight : float
        Of what first and second order miss.
    values : float, shape (wavelengths, n)
    min_scale : float
        Scale below which changes count in proportion to themselves no more.
    kink : float
        Half the change of slope where the value, the only one, goes through 0.
    """

    weight: float
    values: np.ndarray
    min_scale: float = 0.0
    kink: float = 0.0


def _make_criteria(index: np.ndarray, interfaces: Sequence[Interface]) -> list[_Criterion]:
    """Return what a layer is judged by."""
    parts = [
        _Criterion(1.0, compute_contrasts(index, interfaces)),
        _Criterion(1.0, compute_entering_light(index, interfaces)),
    ]
    for face in (i for i in interfaces if i.location == "face"):
        near, far, share = _get_interface_indices(index, [face])
        values = _compute_weighted_contrasts(near, far, np.ones_like(share))
        weight = (
            INTERFACE_WEIGHT * face.fraction * (DENSE_SIDE_FACTOR if (values < 0.0).any() else 1.0)
        )
        parts.append(
            _Criterion(weight, values, MIN_INTERFACE_CONTRAST, CONTRAST_KINK * face.fraction)
        )
    return parts


def _project_on_chord(u: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the weight of a in the convex combination of a and b nearest to each row of u."""
    along = a - b
    square = along @ along
    if square == 0.0:
        return np.ones(len(u))
    return np.clip((u - b) @ along / square, 0.0, 1.0)


def _bound_smooth_error(
    criterion: _Criterion, first: int, second: int, t: np.ndarray
) -> np.ndarray:
    """Bound what t·f(a) + (1 − t)·f(b) misses of f(u), for every row u, of two rows a and b.

    The first order is SLOPE times the relative distance of u from the chord; the second, the gap
    of Jensen's inequality, CURVATURE/2 times the mean square of the relative distances from both
    ends.
    """
    u, a, b = criterion.values, criterion.values[first], criterion.values[second]
    strength = np.abs(u).sum(axis=1)

    def relative(distance: np.ndarray, other: np.ndarray | float) -> np.ndarray:
        least = np.maximum(np.minimum(strength, other), criterion.min_scale)
        away = distance > 0.0
        return np.divide(
            distance, least, out=np.where(away, np.inf, 0.0), where=away & (least > 0.0)
        )

    chord = t[:, np.newaxis] * a + (1.0 - t)[:, np.newaxis] * b
    off = relative(np.abs(chord - u).sum(axis=1), np.inf)
    total = MAX_LOG_SLOPE * off
    for end, weight in ((a, t), (b, 1.0 - t)):
        apart = relative(np.abs(end - u).sum(axis=1), np.abs(end).sum())
        gap = np.multiply(weight, apart**2, out=np.zeros(len(u)), where=weight > 0.0)
        total += 0.5 * MAX_LOG_CURVATURE * gap
    return total


def _bound_kink_error(criterion: _Criterion, first: int, second: int, t: np.ndarray) -> np.ndarray:
    """Bound what a kink at 0 adds to `_bound_smooth_error`: nothing, if all values have one sign."""
    if criterion.kink == 0.0:
        return np.zeros(len(t))
    a, b = criterion.values[first], criterion.values[second]
    chord = t[:, np.newaxis] * a + (1.0 - t)[:, np.newaxis] * b
    apart = t * np.abs(a).sum() + (1.0 - t) * np.abs(b).sum() - np.abs(chord).sum(axis=1)
    crossed = np.sign(chord) * np.sign(criterion.values) < 0.0
    beyond = np.where(crossed, np.minimum(np.abs(chord), np.abs(criterion.values)), 0.0).sum(axis=1)
    return criterion.kink * (np.maximum(apart, 0.0) + 2.0 * beyond)
