"""Angular bins of equal solid angle, the estimator of the papers for a goniophotometer.

SPLITSnow Eq 7: the BRDF of a bin is the fraction of rays collected in it over its projected solid
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
"""Bins in polar and in azimuth angle: as many as bins of 5° by 5°."""

BinScore = tuple[np.ndarray, np.ndarray]
"""Score of a chunk: sums by bin, sums of unscattered weights."""


class AngularBinTally:
    """Tally of paths traced with one set of refractive indices, by angular bin.

    Parameters
    ----------
    stream_index : int
        Position among the tallies of a run, which determines the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Absorption coefficients (1/m) of all wavelengths.
    weights : float, shape (wavelengths,)
        Weight of this tally at each wavelength.
    n_bins : (int, int)
        Bins in polar and in azimuth angle.
    stokes_columns : sequence of int
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
        wavelength_mask = weights > 0.0
        optics = make_bounding_optics(index, absorption[wavelength_mask])
        self.strata = [
            Stratum(random_streams.ANGULAR_BINS + stream_index, optics, wavelength_mask, 400.0)
        ]

    def count_score_values(self) -> int:
        """Return the number of values in the score of a chunk."""
        return int(self.bin_sums.size + self.unscattered_sums.size)

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> BinScore:
        """Return the sums of a chunk of exits."""
        sums_by_component = [
            tally_angular_bins(exits, self.absorption, *self.n_bins, component)
            for component in self.stokes_columns
        ]
        return np.stack([sums for sums, _ in sums_by_component]), sums_by_component[0][1]

    def add_scores(self, stratum: Stratum, scores: Sequence[BinScore]) -> None:
        """Add the sums of chunks one by one: they do not depend on the threads."""
        stratum.n_rays += RAYS_PER_CHUNK * len(scores)
        for sums, unscattered in scores:
            self.bin_sums += sums
            self.unscattered_sums += unscattered


def compute_bin_centres(n_bins: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the polar and azimuth angles (degrees) of bin centres, starting at the zenith."""
    polar, azimuth = n_bins
    cosine = (np.arange(polar)[::-1] + 0.5) / polar
    return np.degrees(np.arccos(cosine)), np.arange(azimuth) * (360.0 / azimuth)


def estimate_bin_brdf(
    tallies: Sequence[AngularBinTally], interpolation_bound: np.ndarray
) -> AngularEstimate:
    """Estimate BRDF and BTDF of every bin, starting at the zenith.

    Parameters
    ----------
    tallies : sequence of AngularBinTally
    interpolation_bound : float, shape (wavelengths,)
        See `splits.simulation.spectral_nodes.IndexNodes`.
    """
    polar, azimuth = tallies[0].n_bins
    mean, stderr = _compute_bin_means(tallies, 0)
    sums = np.zeros((4, 2, len(interpolation_bound)))
    for tally in tallies:
        ray_weight = 1.0 / tally.strata[0].n_rays
        total = tally.bin_sums[0].sum(axis=(-2, -1)) + tally.unscattered_sums
        for row, moments in ((0, total), (2, tally.unscattered_sums)):
            sums[row] += tally.weights * ray_weight * moments[0]
            sums[row + 1] += (tally.weights * ray_weight) ** 2 * (
                moments[1] - ray_weight * moments[0] ** 2
            )
    sums[1::2] = np.sqrt(np.maximum(sums[1::2], 0.0))
    sums[1::2] = np.hypot(sums[1::2], bound_interpolation_error(interpolation_bound, sums[::2]))
    interpolation_error = (
        INTERPOLATION_FACTOR * interpolation_bound[:, np.newaxis, np.newaxis] * mean
    )
    shape = (2, len(interpolation_bound), polar * azimuth)
    stderr = np.hypot(stderr, interpolation_error).reshape(shape)
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
    """Return Q, U and V of BRDF and BTDF with their errors, by name, for polarized exits."""
    stokes = {}
    for component, name in enumerate("quv"[: len(tallies[0].stokes_columns) - 1], start=1):
        means = _compute_bin_means(tallies, component)
        for side, function in enumerate(("brdf", "btdf")):
            mean, stderr = (x[side].reshape(len(x[side]), -1) for x in means)
            stokes[f"{function}_{name}"] = (mean, stderr)
    return stokes


def _compute_projected_solid_angles(n_bins: tuple[int, int]) -> np.ndarray:
    """Return the projected solid angles of bins, starting at the zenith, shape (polar, 1)."""
    polar, azimuth = n_bins
    edges = np.arange(polar + 1) / polar
    return (np.pi / azimuth * np.diff(edges**2))[::-1, np.newaxis]


def _compute_bin_means(
    tallies: Sequence[AngularBinTally], component: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return a distribution function and its standard errors, starting at the zenith."""
    mean, variance = np.zeros((2, *tallies[0].bin_sums.shape[2:]))
    for tally in tallies:
        ray_weight, weights = 1.0 / tally.strata[0].n_rays, tally.weights[:, np.newaxis, np.newaxis]
        total, square = tally.bin_sums[component]
        mean += weights * ray_weight * total
        variance += weights**2 * ray_weight**2 * (square - ray_weight * total**2)
    projected = _compute_projected_solid_angles(tallies[0].n_bins)
    # The error of an empty bin is the contribution of one ray.
    single_ray_error = max(1.0 / tally.strata[0].n_rays for tally in tallies)
    stderr = np.where(variance > 0.0, np.sqrt(np.maximum(variance, 0.0)), single_ray_error)
    return mean[:, :, ::-1] / projected, stderr[:, :, ::-1] / projected
