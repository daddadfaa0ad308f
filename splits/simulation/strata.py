"""Strata of rays: what they trace, how many rays each gets, and when tracing stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from splits.kernels.scene import NO_MAX_ORDER, Features, Optics, Scene

# --------------------------------------------------------------------------------------------------
# Strata: rays with one random stream, for some wavelengths or some orders of scattering.

STRATUM_BOUNDS = (-1.0, 0.0005, 0.0015, 0.004, 0.01, 0.03, 0.1)
"""Absorption over one mean distance between grains at which strata of wavelengths begin.  Visible
light needs few rays and long paths, the near infrared many rays and short paths."""
INITIAL_SEGMENTS = 400.0
"""Expected segments per ray, before tracing, of rays that little is absorbed of."""


@dataclass(eq=False)
class Stratum:
    """Rays with one random stream, for some node rows, or for some orders of scattering.

    Rays for strongly absorbed wavelengths only can be terminated early by roulette, and those for
    low orders of scattering after the last of these orders.

    Attributes
    ----------
    stream : int
        Number of the random streams.
    optics : Optics
    node_rows : slice
        Node rows that the rays serve.
    absorption : float, shape (node rows, columns)
        Their absorption coefficients (1/m).
    expected_segments : float
        Expected segments per ray before any was traced.
    max_order : int
        Largest order of scattering of a ray.
    features : Features or None
        Features of the vectorized kernel, None for the scalar kernel.
    n_rays, n_segments : int
        Traced so far.
    """

    stream: int
    optics: Optics
    node_rows: slice
    absorption: np.ndarray
    expected_segments: float = INITIAL_SEGMENTS
    max_order: int = NO_MAX_ORDER
    features: Features | None = None
    n_rays: int = 0
    n_segments: int = 0


def compute_absorption_per_mfp(scene: Scene, absorption: np.ndarray) -> np.ndarray:
    """Return the absorption over the smallest mean free path of a scene, by row.

    Parameters
    ----------
    scene : Scene
    absorption : float, shape (rows, columns)
        Absorption coefficients (1/m).
    """
    materials = np.arange(absorption.shape[1]) != scene.ground_column
    strength: np.ndarray = absorption[:, materials].max(axis=1)
    return strength / scene.layers.collision_coefficient.max()


# --------------------------------------------------------------------------------------------------
# When and why tracing stops.

STOP_REASONS = (
    "converged", "fixed_rays", "unresolved_lobe", "interpolation_bound", "solver_error", "no_light",
    "max_degree", "max_rays",
)  # fmt: skip
"""Why runs stop; "solver_error": discrete ordinates have a larger error than the requested one.
Where several runs serve one result, the last of their reasons is stated."""


class StoppingRule(NamedTuple):
    """When tracing stops.

    Attributes
    ----------
    max_error : float
        Largest error, absolute or relative as the tally defines it.
    max_rays : int
        Number of rays at which tracing stops in any case.
    fixed : bool
        Whether `max_rays` rays are traced whatever the error is.
    """

    max_error: float
    max_rays: int
    fixed: bool = False

    def find_reason(self, evaluation: Evaluation, n_rays: int) -> str:
        """Return why tracing stops after a number of rays, or an empty string."""
        exhausted = n_rays >= self.max_rays
        if self.fixed:
            return "fixed_rays" if exhausted else ""
        if evaluation.stop_reason:
            return evaluation.stop_reason
        if evaluation.error <= self.max_error:
            return "converged"
        return "max_rays" if exhausted else ""


class Evaluation(NamedTuple):
    """State of a run after a round of rays, and its result after the last.

    Attributes
    ----------
    error : float
        Largest error reached, as the tally defines it.
    estimate : object
        Estimate from all rays so far, which the tally defines.
    stop_reason : str
        One of `STOP_REASONS` once a run has stopped.  Before, a reason of the tally other than the
        error and the number of rays, or an empty string.
    """

    error: float
    estimate: Any = None
    stop_reason: str = ""


# --------------------------------------------------------------------------------------------------
# Allocation of rays to strata for the least cost.

LARGE_PROBLEM_ROWS = 4000
"""Number of rows up to which ray allocation considers all of them."""


class VarianceTerms(NamedTuple):
    """Terms whose sum over the strata and nodes is the variance of a column of results.

    Attributes
    ----------
    variances : float, shape (quantities, terms)
        Variances per ray, in units of the variance to reach.
    columns : int, shape (terms,)
        Column to whose variance a term contributes.
    contributes : bool, shape (strata, terms)
        Where the rays of a stratum contribute.
    """

    variances: np.ndarray
    columns: np.ndarray
    contributes: np.ndarray

    def sum_columns(self, values: np.ndarray) -> np.ndarray:
        """Return sums of the terms of each column, shape (quantities, columns)."""
        n_columns = int(self.columns.max()) + 1
        return np.stack([np.bincount(self.columns, value, n_columns) for value in values])


def allocate_rays(terms: VarianceTerms, strata: Sequence[Stratum]) -> np.ndarray:
    """Return the rays per stratum that bring all variances to their targets at the least cost.

    The cost of a ray is its number of segments.  At the optimum the marginal gain of a stratum,
    summed over columns with multipliers that are nonzero where the target binds, equals its cost;
    multipliers and rays are iterated by multiplicative updates, and then scaled to feasibility.

    Parameters
    ----------
    terms : VarianceTerms
    strata : sequence of Stratum
    """
    floor = np.array([stratum.n_rays for stratum in strata], dtype=float)
    cost = np.array([stratum.n_segments / stratum.n_rays for stratum in strata]) + 1.0
    columns = _select_binding_columns(terms)
    chosen = np.isin(terms.columns, columns)
    binding = VarianceTerms(
        terms.variances[:, chosen],
        np.searchsorted(columns, terms.columns[chosen]),
        terms.contributes[:, chosen],
    )
    mask = binding.contributes.astype(float)
    stratum_rays = floor.copy()
    multipliers = np.full((len(terms.variances), int(binding.columns.max()) + 1), 1.0)
    multipliers /= multipliers.size
    for _ in range(200):
        before = stratum_rays.copy()
        ratio = binding.sum_columns(binding.variances / np.maximum(stratum_rays @ mask, 1e-9))
        multipliers *= (ratio / ratio.max()) ** 0.5
        multipliers /= multipliers.sum()
        gain = (multipliers[:, binding.columns] * binding.variances).sum(axis=0)
        gain /= np.maximum(stratum_rays @ mask, 1e-9) ** 2
        stratum_rays *= np.sqrt((mask @ gain / cost).clip(1e-30))
        rays_per_term = np.maximum(stratum_rays @ mask, 1e-9)
        stratum_rays *= binding.sum_columns(binding.variances / rays_per_term).max()
        if (np.abs(stratum_rays - before) <= 1e-4 * before).all():
            break
    stratum_rays = np.maximum(stratum_rays, floor)
    # Rays above the optimum in one stratum allow fewer in others.  A margin of 3 % is added, but
    # only where more rays are needed, or strata that have enough would grow with every round.
    rays_per_term = np.maximum(stratum_rays @ terms.contributes, 1e-9)
    largest = terms.sum_columns(terms.variances / rays_per_term).max()
    target_rays = stratum_rays * max(largest, 0.1)
    more = target_rays > floor * (1.0 + 1e-6)
    return np.where(more, np.ceil(1.03 * target_rays), floor)


def _select_binding_columns(terms: VarianceTerms) -> np.ndarray:
    """Return the columns that determine the number of rays: of few columns all of them.

    Of many columns served by the same strata, those with the largest variance in a term or in
    total.
    """
    columns = np.unique(terms.columns)
    if len(columns) <= LARGE_PROBLEM_ROWS:
        return columns
    served = np.stack([np.bincount(terms.columns, one) > 0.0 for one in terms.contributes])
    _, pattern = np.unique(np.packbits(served, axis=0), axis=1, return_inverse=True)
    total = terms.sum_columns(terms.variances)
    chosen: list[int] = []
    for number in range(int(pattern.max()) + 1):
        same = np.flatnonzero(pattern.ravel() == number)
        chosen += same[total[:, same].argmax(axis=1)].tolist()
        members = np.flatnonzero(np.isin(terms.columns, same))
        first_stratum = terms.contributes[:, members].argmax(axis=0)
        for stratum in np.unique(first_stratum):
            part = members[first_stratum == stratum]
            chosen += terms.columns[part[terms.variances[:, part].argmax(axis=1)]].tolist()
    return np.unique(chosen)
