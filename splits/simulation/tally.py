"""Ensembles of paths, and those of a spectrophotometer: sums of weights, means, variances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from splits.kernels.grains.scene import NO_GROUND, NO_MAX_ORDER, Optics, make_bounding_optics
from splits.kernels.tallies.exits import BLOCK_SIZE, N_BATCHES, tally_weights
from splits.simulation import random_streams

STRATUM_BOUNDS = (-1.0, 0.0005, 0.0015, 0.004, 0.01, 0.03, 0.1)
"""Absorption over one mean distance between grains from which wavelengths have rays of their own.
Visible light needs few rays and long paths, the near infrared many rays and short paths."""

_INITIAL_SEGMENTS = 400.0
"""Legs per ray to expect at first at the level of least absorption; a third fewer at the next."""

RAYS_PER_CHUNK = 128
"""Rays whose weights are added up together: fixed, so that sums do not depend on who adds them."""
RAYS_PER_LARGE_CHUNK = 1024
"""So many where sums are of many rows: they take more memory than the rays."""

SpectralScore = tuple[np.ndarray, np.ndarray, np.ndarray, int]
"""What a batch yields here: moments, least weight, sums of blocks, rays."""


@dataclass(eq=False)
class Stratum:
    """Rays of an ensemble that serve only some wavelengths, or only some orders of scattering.

    They may end paths early where nobody listens: by roulette, because the wavelengths that need
    long paths do not, or once they have met as many grains as somebody listens to.

    Attributes
    ----------
    stream : int
        Names the random streams.
    optics : Optics
    wavelength_mask : bool, shape (wavelengths,)
    expected_segments : float
        Legs per ray to expect before any was traced.
    max_order : int
        Grains that a ray may meet.
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
    """How rays are traced, as far as those who add them up must know it.

    Attributes
    ----------
    attenuation : float
        Scatterings to expect per metre.
    ground_column : int
        Column of meetings with the ground, see `splits.kernels.grains.scene.Scene`.
    extra_absorption : bool
        Whether a ray's weight may fall for another reason than absorption by materials.
    analog : bool
        Whether absorption is a coin toss, so that any ray might have been absorbed.
    """

    attenuation: float
    ground_column: int = NO_GROUND
    extra_absorption: bool = False
    analog: bool = False


class Tally(Protocol):
    """What a `splits.simulation.runner.Runner` asks of an ensemble."""

    absorption: np.ndarray
    strata: list[Stratum]

    def count_score_values(self) -> int:
        """Return how many numbers a tally holds."""
        ...

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> Any:
        """Return what a batch of a level's exits and notes, from that ray on, adds up to."""
        ...

    def add_scores(self, stratum: Stratum, scores: Sequence[Any]) -> None:
        """Add the tallies of successive batches."""
        ...


def compute_absorption_per_mfp(absorption: np.ndarray, traits: TransportTraits) -> np.ndarray:
    """Return the absorption over one mean distance between scatterings, by wavelength."""
    materials = np.arange(absorption.shape[1]) != traits.ground_column
    strength: np.ndarray = absorption[:, materials].max(axis=1) / traits.attenuation
    return strength


def make_strata(
    first_stream: int,
    index: np.ndarray,
    absorption: np.ndarray,
    wavelength_mask: np.ndarray,
    traits: TransportTraits,
    bounds: Sequence[float],
) -> list[Stratum]:
    """Return levels for wavelengths that absorb more and more, numbered from `first_stream` on.

    For the other parameters see `PathTally`.
    """
    strength = compute_absorption_per_mfp(absorption, traits)
    levels: list[Stratum] = []
    for step, threshold in enumerate(bounds):
        part = wavelength_mask & (strength >= threshold)
        if not part.any() or (levels and part.sum() == levels[-1].wavelength_mask.sum()):
            continue
        optics = make_bounding_optics(index, absorption[part])
        levels.append(Stratum(first_stream + step, optics, part, _INITIAL_SEGMENTS / 1.5**step))
    return levels


class PathTally:
    """Paths traced with one set of refractive indices.

    Parameters
    ----------
    number : int
        Names the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Absorption coefficients of all wavelengths (1/m).
    served : bool, shape (wavelengths,)
        Wavelengths that draw on this ensemble.
    traits : TransportTraits
    strata : sequence of float
        Absorption from which wavelengths have rays of their own, at most as many as `STRATUM_BOUNDS`; an
        analog ensemble has one level only.

    Attributes
    ----------
    strata : list of Stratum
    rows : int, shape (drawing,)
        The wavelengths that draw on it, from the palest to the darkest, so that those which a
        level serves are the last ones.
    moments : float, shape (3, 3, drawing)
        Over the rays that each of them listens to, [reflected, transmitted, both][Σ weight,
        Σ weight², largest weight].
    min_weight : float, shape (drawing,)
        Smallest weight with which any of those left; 0 once one was absorbed.
    batch_sums : float, shape (GROUPS, 2, drawing)
        Σ weight of the rays of every group, reflected and transmitted.
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
        used = bounds[:1] if traits.analog else bounds
        first = random_streams.ANALOG if traits.analog else random_streams.SPECTRAL
        first += stream_index * len(STRATUM_BOUNDS)
        self.strata = make_strata(first, index, absorption, wavelength_mask, traits, used)

    def count_score_values(self) -> int:
        """Return how many numbers a tally holds at most, those of blocks being half as long."""
        return (10 + N_BATCHES) * len(self.rows)

    def select_rows(self, stratum: Stratum) -> slice:
        """Return which of the rows a level serves."""
        return slice(len(self.rows) - int(stratum.wavelength_mask.sum()), None)

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> SpectralScore:
        """Return the sums of a batch of a level, for the rows it serves."""
        absorption = self.absorption[self.rows[self.select_rows(stratum)]]
        weighted, ground = not self.traits.analog, self.traits.ground_column
        return *tally_weights(exits, crossings, absorption, weighted, ground), len(exits)

    def add_scores(self, stratum: Stratum, scores: Sequence[SpectralScore]) -> None:
        """Add the tallies of batches one by one: sums do not depend on who traced them."""
        part = self.select_rows(stratum)
        moments, least = self.moments[:, :, part], self.min_weight[part]
        groups = self.batch_sums[:, :, part]
        for more, lightest, blocks, rays in scores:
            first = stratum.n_rays // BLOCK_SIZE % N_BATCHES
            groups[first : first + len(blocks)] += blocks
            stratum.n_rays += rays
            moments[:, :2] += more[:, :2]
            np.maximum(moments[:, 2], more[:, 2], out=moments[:, 2])
            np.minimum(least, lightest, out=least)

    @property
    def n_rays(self) -> np.ndarray:
        """Rays that each row listens to, shape (drawing,)."""
        count = np.zeros(len(self.rows))
        for level in self.strata:
            count[self.select_rows(level)] += level.n_rays
        return count

    def expand_to_all_rows(self, values: np.ndarray) -> np.ndarray:
        """Return what is known of the rows for all wavelengths, 0 for those that do not draw."""
        found = np.zeros((*values.shape[:-1], len(self.absorption)))
        found[..., self.rows] = values
        return found

    def compute_means(self) -> np.ndarray:
        """Return the mean weight, shape (2, drawing): reflected, transmitted."""
        return self.moments[:2, 0] / np.maximum(self.n_rays, 1.0)

    def compute_batch_deviations(self) -> np.ndarray:
        """Return how far each group of rays takes the means off, shape (GROUPS, 2, drawing).

        Sums over groups of products of two of them estimate covariances of means (random groups;
        Wolter 2007, Introduction to Variance Estimation, chapter 2).
        """
        off = self.batch_sums - self.count_rays_per_batch()[:, np.newaxis] * self.compute_means()
        return off / np.maximum(self.n_rays, 1.0)

    def count_rays_per_batch(self) -> np.ndarray:
        """Return how many rays of each group every row listens to, (GROUPS, drawing)."""
        rays = np.zeros((N_BATCHES, len(self.rows)))
        for level in self.strata:
            turns, rest = divmod(level.n_rays // BLOCK_SIZE, N_BATCHES)
            rays[:, self.select_rows(level)] += (
                BLOCK_SIZE * (turns + (np.arange(N_BATCHES) < rest))[:, np.newaxis]
            )
        return rays

    def compute_variances(self) -> np.ndarray:
        """Return the variance per ray of reflected, transmitted and absorbed weight, (3, …).

        Two rays are added, of the largest and of the smallest weight possible by what was seen
        (after Agresti & Coull 1998): few or no arrivals then do not look like certainty.
        """
        total, square, largest = self.moments[:, 0], self.moments[:, 1], self.moments[:, 2]
        largest = np.where(largest == 0.0, 1.0, largest)
        smallest = np.zeros_like(largest)
        absorbs = self.absorption[self.rows].max(axis=1) > 0.0
        tossed = self.traits.extra_absorption | (self.traits.analog & absorbs)
        smallest[2] = np.where(tossed | (self.n_rays == 0.0), 0.0, self.min_weight)
        n = self.n_rays + 2.0
        mean = (total + largest + smallest) / n
        return np.maximum((square + largest**2 + smallest**2) / n - mean**2, 0.0)


def rescale_deviations(deviations: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return deviations of groups whose squares add up to a variance known better than they tell.

    Their correlations stay; where no group deviates at all, none does after.

    Parameters
    ----------
    deviations : float, shape (groups, ...)
    variance : float, shape (...)
    """
    square = (deviations**2).sum(axis=0)
    seen = square > 0.0
    return deviations * np.sqrt(np.divide(variance, square, out=np.zeros_like(square), where=seen))
