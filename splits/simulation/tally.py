"""Tallies of paths for spectra: sums of weights, means and variances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from splits.kernels.grains.scene import NO_GROUND, NO_MAX_ORDER, Optics, make_bounding_optics
from splits.kernels.tallies.exits import BLOCK_SIZE, N_BATCHES, tally_weights
from splits.simulation import random_streams

STRATUM_BOUNDS = (-1.0, 0.0005, 0.0015, 0.004, 0.01, 0.03, 0.1)
"""Absorption over one mean distance between grains at which strata of wavelengths begin.  Visible
light needs few rays and long paths, the near infrared many rays and short paths."""

_INITIAL_SEGMENTS = 400.0
"""Expected segments per ray, before tracing, of the stratum with the least absorption; a third
fewer in each further stratum."""

RAYS_PER_CHUNK = 128
"""Rays whose weights are added up together: fixed, so that sums do not depend on the threads."""
RAYS_PER_LARGE_CHUNK = 1024
"""The same for sums over many rows, which take more memory than the rays."""

SpectralScore = tuple[np.ndarray, np.ndarray, np.ndarray, int]
"""Score of a chunk: moments, smallest weight, sums of blocks, rays."""


@dataclass(eq=False)
class Stratum:
    """Rays of a tally for a subset of the wavelengths, or of the orders of scattering.

    Rays of a stratum for strongly absorbed wavelengths only can be terminated early by roulette,
    and those for low orders of scattering after the last of these orders.

    Attributes
    ----------
    stream : int
        Number of the random streams.
    optics : Optics
    wavelength_mask : bool, shape (wavelengths,)
    expected_segments : float
        Expected segments per ray before any was traced.
    max_order : int
        Largest order of scattering of a ray.
    n_rays, n_segments : int
        Traced so far.
    """

    stream: int
    optics: Optics
    wavelength_mask: np.ndarray
    expected_segments: float
    max_order: int = NO_MAX_ORDER
    n_rays: int = 0
    n_segments: int = 0


class TransportTraits(NamedTuple):
    """Properties of the transport that tallies depend on.

    Attributes
    ----------
    collision_coefficient : float
        Expected scatterings per metre.
    ground_column : int
        Column of hits of the ground, see `splits.kernels.grains.scene.Scene`.
    extra_absorption : bool
        Whether a ray loses weight other than by absorption in materials.
    analog : bool
        Whether absorption is analog, so that any ray may be absorbed.
    """

    collision_coefficient: float
    ground_column: int = NO_GROUND
    extra_absorption: bool = False
    analog: bool = False


class Tally(Protocol):
    """Interface of tallies that a `splits.simulation.runner.Runner` uses."""

    absorption: np.ndarray
    strata: list[Stratum]

    def count_score_values(self) -> int:
        """Return the number of values in the score of a chunk."""
        ...

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> Any:
        """Return the score of a chunk of a stratum's exits and crossings, from a ray on."""
        ...

    def add_scores(self, stratum: Stratum, scores: Sequence[Any]) -> None:
        """Add the scores of successive chunks."""
        ...


def compute_absorption_per_mfp(absorption: np.ndarray, traits: TransportTraits) -> np.ndarray:
    """Return the absorption over one mean distance between scatterings, by wavelength."""
    materials = np.arange(absorption.shape[1]) != traits.ground_column
    strength: np.ndarray = absorption[:, materials].max(axis=1) / traits.collision_coefficient
    return strength


def make_strata(
    first_stream: int,
    index: np.ndarray,
    absorption: np.ndarray,
    wavelength_mask: np.ndarray,
    traits: TransportTraits,
    bounds: Sequence[float],
) -> list[Stratum]:
    """Return strata for increasingly absorbed wavelengths, numbered from `first_stream` on.

    For the other parameters see `PathTally`.
    """
    strength = compute_absorption_per_mfp(absorption, traits)
    strata: list[Stratum] = []
    for step, threshold in enumerate(bounds):
        mask = wavelength_mask & (strength >= threshold)
        if not mask.any() or (strata and mask.sum() == strata[-1].wavelength_mask.sum()):
            continue
        optics = make_bounding_optics(index, absorption[mask])
        strata.append(Stratum(first_stream + step, optics, mask, _INITIAL_SEGMENTS / 1.5**step))
    return strata


class PathTally:
    """Tally of paths traced with one set of refractive indices.

    Parameters
    ----------
    stream_index : int
        Position among the tallies of a run, which determines the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Absorption coefficients of all wavelengths (1/m).
    wavelength_mask : bool, shape (wavelengths,)
        Wavelengths that use this tally.
    traits : TransportTraits
    bounds : sequence of float
        Absorption at which strata begin, at most as many as `STRATUM_BOUNDS`; an analog tally has
        one stratum only.

    Attributes
    ----------
    strata : list of Stratum
    rows : int, shape (used,)
        The wavelengths that use this tally, in order of increasing absorption, so that those of a
        stratum are the last ones.
    moments : float, shape (3, 3, used)
        Over the rays of each row, [reflected, transmitted, both][Σ weight, Σ weight², largest
        weight].
    min_weight : float, shape (used,)
        Smallest weight of a ray that left the medium; 0 once one was absorbed.
    batch_sums : float, shape (N_BATCHES, 2, used)
        Σ weight of the rays of every batch, reflected and transmitted.
    """

    def __init__(
        self,
        stream_index: int,
        index: np.ndarray,
        absorption: np.ndarray,
        wavelength_mask: np.ndarray,
        traits: TransportTraits,
        bounds: Sequence[float] = STRATUM_BOUNDS,
    ) -> None:
        self.absorption = absorption
        self.traits = traits
        rows = np.flatnonzero(wavelength_mask)
        self.rows = rows[
            np.argsort(compute_absorption_per_mfp(absorption[rows], traits), kind="stable")
        ]
        self.moments = np.zeros((3, 3, len(rows)))
        self.min_weight = np.full(len(rows), np.inf)
        self.batch_sums = np.zeros((N_BATCHES, 2, len(rows)))
        stratum_bounds = bounds[:1] if traits.analog else bounds
        first_stream = random_streams.ANALOG if traits.analog else random_streams.SPECTRAL
        first_stream += stream_index * len(STRATUM_BOUNDS)
        self.strata = make_strata(
            first_stream, index, absorption, wavelength_mask, traits, stratum_bounds
        )

    def count_score_values(self) -> int:
        """Return the largest number of values in the score of a chunk."""
        return (10 + N_BATCHES) * len(self.rows)

    def select_rows(self, stratum: Stratum) -> slice:
        """Return the rows of a stratum."""
        return slice(len(self.rows) - int(stratum.wavelength_mask.sum()), None)

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> SpectralScore:
        """Return the sums of a chunk of a stratum, for its rows."""
        absorption = self.absorption[self.rows[self.select_rows(stratum)]]
        weighted, ground = not self.traits.analog, self.traits.ground_column
        return *tally_weights(exits, crossings, absorption, weighted, ground), len(exits)

    def add_scores(self, stratum: Stratum, scores: Sequence[SpectralScore]) -> None:
        """Add the scores of chunks one by one: sums do not depend on the threads."""
        rows = self.select_rows(stratum)
        moments, min_weight = self.moments[:, :, rows], self.min_weight[rows]
        batch_sums = self.batch_sums[:, :, rows]
        for chunk_moments, chunk_min_weight, block_sums, n_rays in scores:
            first = stratum.n_rays // BLOCK_SIZE % N_BATCHES
            batch_sums[first : first + len(block_sums)] += block_sums
            stratum.n_rays += n_rays
            moments[:, :2] += chunk_moments[:, :2]
            np.maximum(moments[:, 2], chunk_moments[:, 2], out=moments[:, 2])
            np.minimum(min_weight, chunk_min_weight, out=min_weight)

    @property
    def n_rays(self) -> np.ndarray:
        """Number of rays of each row, shape (used,)."""
        count = np.zeros(len(self.rows))
        for stratum in self.strata:
            count[self.select_rows(stratum)] += stratum.n_rays
        return count

    def expand_to_all_rows(self, values: np.ndarray) -> np.ndarray:
        """Return values of the rows for all wavelengths, 0 for those that do not use this tally."""
        expanded = np.zeros((*values.shape[:-1], len(self.absorption)))
        expanded[..., self.rows] = values
        return expanded

    def compute_means(self) -> np.ndarray:
        """Return the mean weight, shape (2, used): reflected, transmitted."""
        return self.moments[:2, 0] / np.maximum(self.n_rays, 1.0)

    def compute_batch_deviations(self) -> np.ndarray:
        """Return contributions of batches to the deviations of means, (N_BATCHES, 2, used).

        Sums over batches of products of two of them estimate covariances of means (random groups;
        Wolter 2007, Introduction to Variance Estimation, chapter 2).
        """
        deviations = (
            self.batch_sums - self.count_rays_per_batch()[:, np.newaxis] * self.compute_means()
        )
        return deviations / np.maximum(self.n_rays, 1.0)

    def count_rays_per_batch(self) -> np.ndarray:
        """Return the number of rays of each batch by row, (N_BATCHES, used)."""
        n_rays = np.zeros((N_BATCHES, len(self.rows)))
        for stratum in self.strata:
            n_cycles, remainder = divmod(stratum.n_rays // BLOCK_SIZE, N_BATCHES)
            n_rays[:, self.select_rows(stratum)] += (
                BLOCK_SIZE * (n_cycles + (np.arange(N_BATCHES) < remainder))[:, np.newaxis]
            )
        return n_rays

    def compute_variances(self) -> np.ndarray:
        """Return the variance per ray of reflected, transmitted and absorbed weight, (3, …).

        Two rays are added, of the largest and of the smallest weight that the data allow (after
        Agresti & Coull 1998), so that few or no arrivals do not give a zero variance.
        """
        total, square, largest = self.moments[:, 0], self.moments[:, 1], self.moments[:, 2]
        largest = np.where(largest == 0.0, 1.0, largest)
        smallest = np.zeros_like(largest)
        is_absorbing = self.absorption[self.rows].max(axis=1) > 0.0
        may_vanish = self.traits.extra_absorption | (self.traits.analog & is_absorbing)
        smallest[2] = np.where(may_vanish | (self.n_rays == 0.0), 0.0, self.min_weight)
        n = self.n_rays + 2.0
        mean = (total + largest + smallest) / n
        return np.maximum((square + largest**2 + smallest**2) / n - mean**2, 0.0)


def rescale_deviations(deviations: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return batch deviations whose squares add up to a more precisely known variance.

    Their correlations are preserved; zero deviations remain zero.

    Parameters
    ----------
    deviations : float, shape (batches, ...)
    variance : float, shape (...)
    """
    sum_of_squares = (deviations**2).sum(axis=0)
    nonzero = sum_of_squares > 0.0
    return deviations * np.sqrt(
        np.divide(variance, sum_of_squares, out=np.zeros_like(sum_of_squares), where=nonzero)
    )
