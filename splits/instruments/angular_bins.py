"""A goniophotometer's collectors: cells of equal solid angle, the papers' estimator.

SPLITSnow Eq 7: the BRDF of a cell is the share of rays that it collects over its projected solid
angle.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.instruments.angular_estimate import (
    INTERPOLATION_FACTOR,
    AngularEstimate,
    bound_interpolation_error,
)
from splits.kernels.grains.scene import make_bounding_optics
from splits.kernels.tallies.angular import tally_angular_bins
from splits.simulation import random_streams
from splits.simulation.runner import RAYS_PER_CHUNK
from splits.simulation.tally import Stratum

DEFAULT_N_BINS = (18, 72)
"""Cells between horizon and zenith, and around: as many as 5° by 5° would be."""

BinScore = tuple[np.ndarray, np.ndarray]
"""What a batch yields: sums by cells, sums of weights that met no grain."""


class AngularBinTally:
    """Paths traced with one set of refractive indices, collected by cells.

    Parameters
    ----------
    number : int
        Names the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Absorption coefficients (1/m) of all wavelengths.
    weights : float, shape (wavelengths,)
        How much each wavelength draws on this ensemble.
    n_bins : (int, int)
        Cells between horizon and zenith, and around.
    stokes : sequence of int
        Columns of exits that hold Q, U, V over I, or nothing.

    Attributes
    ----------
    strata : list of Stratum
        One: every ray is followed to its end.
    """

    def __init__(
        self,
        stream_index: int,
        index: np.ndarray,
        absorption: np.ndarray,
        weights: np.ndarray,
        n_bins: tuple[int, int],
        stokes_columns: Sequence[int] = (),
    ) -> None:
        self.absorption = absorption
        self.weights = weights
        self.n_bins = n_bins
        self.stokes_columns = (-1, *stokes_columns)
        self.bin_sums = np.zeros((len(self.stokes_columns), 2, 2, len(absorption), *n_bins))
        self.unscattered_sums = np.zeros((2, 2, len(absorption)))
        served = weights > 0.0
        optics = make_bounding_optics(index, absorption[served])
        self.strata = [Stratum(random_streams.ANGULAR_BINS + stream_index, optics, served, 400.0)]

    def count_score_values(self) -> int:
        """Return how many numbers a tally holds."""
        return int(self.bin_sums.size + self.unscattered_sums.size)

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> BinScore:
        """Return the sums of a batch of exits."""
        found = [
            tally_angular_bins(exits, self.absorption, *self.n_bins, part)
            for part in self.stokes_columns
        ]
        return np.stack([sums for sums, _ in found]), found[0][1]

    def add_scores(self, stratum: Stratum, scores: Sequence[BinScore]) -> None:
        """Add the sums of batches one by one: they do not depend on who traced them."""
        stratum.n_rays += RAYS_PER_CHUNK * len(scores)
        for sums, straight in scores:
            self.bin_sums += sums
            self.unscattered_sums += straight


def compute_bin_centres(n_bins: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the polar and azimuth angles (degrees) of the middle of cells, from the zenith on."""
    polar, azimuth = n_bins
    cosine = (np.arange(polar)[::-1] + 0.5) / polar
    return np.degrees(np.arccos(cosine)), np.arange(azimuth) * (360.0 / azimuth)


def estimate_bin_brdf(
    tallies: Sequence[AngularBinTally], interpolation_bound: np.ndarray
) -> AngularEstimate:
    """Estimate BRDF and BTDF of every cell, from the zenith on.

    Parameters
    ----------
    tallies : sequence of Cells
    interpolation_bound : float, shape (wavelengths,)
        See `splits.simulation.spectral_nodes.IndexNodes`.
    """
    polar, azimuth = tallies[0].n_bins
    mean, stderr = _compute_bin_means(tallies, 0)
    sums = np.zeros((4, 2, len(interpolation_bound)))
    for e in tallies:
        share = 1.0 / e.strata[0].n_rays
        whole = e.bin_sums[0].sum(axis=(-2, -1)) + e.unscattered_sums
        for row, part in ((0, whole), (2, e.unscattered_sums)):
            sums[row] += e.weights * share * part[0]
            sums[row + 1] += (e.weights * share) ** 2 * (part[1] - share * part[0] ** 2)
    sums[1::2] = np.sqrt(np.maximum(sums[1::2], 0.0))
    sums[1::2] = np.hypot(sums[1::2], bound_interpolation_error(interpolation_bound, sums[::2]))
    missed = INTERPOLATION_FACTOR * interpolation_bound[:, np.newaxis, np.newaxis] * mean
    shape = (2, len(interpolation_bound), polar * azimuth)
    stderr = np.hypot(stderr, missed).reshape(shape)
    return AngularEstimate(
        mean.reshape(shape),
        stderr,
        stderr,
        sums,
        np.zeros((2, len(interpolation_bound)), dtype=int),
        np.zeros(shape),
    )


def estimate_bin_stokes(
    tallies: Sequence[AngularBinTally],
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return Q, U and V of BRDF and BTDF with their errors, by name, where exits tell them."""
    found = {}
    for place, name in enumerate("quv"[: len(tallies[0].stokes_columns) - 1], start=1):
        pair = _compute_bin_means(tallies, place)
        for side, function in enumerate(("brdf", "btdf")):
            mean, stderr = (x[side].reshape(len(x[side]), -1) for x in pair)
            found[f"{function}_{name}"] = (mean, stderr)
    return found


def _compute_projected_solid_angles(n_bins: tuple[int, int]) -> np.ndarray:
    """Return the projected solid angle of cells from the zenith on, shape (polar, 1)."""
    polar, azimuth = n_bins
    edges = np.arange(polar + 1) / polar
    return (np.pi / azimuth * np.diff(edges**2))[::-1, np.newaxis]


def _compute_bin_means(
    tallies: Sequence[AngularBinTally], component: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return a distribution function and its standard errors, from the zenith on."""
    mean, variance = np.zeros((2, *tallies[0].bin_sums.shape[2:]))
    for e in tallies:
        share, weights = 1.0 / e.strata[0].n_rays, e.weights[:, np.newaxis, np.newaxis]
        total, square = e.bin_sums[component]
        mean += weights * share * total
        variance += weights**2 * share**2 * (square - share * total**2)
    projected = _compute_projected_solid_angles(tallies[0].n_bins)
    # An empty cell is not certain: as if a ray had come.
    unseen = max(1.0 / e.strata[0].n_rays for e in tallies)
    stderr = np.where(variance > 0.0, np.sqrt(np.maximum(variance, 0.0)), unseen)
    return mean[:, :, ::-1] / projected, stderr[:, :, ::-1] / projected
