"""Angular bins of equal solid angle, the estimator of the papers for a goniophotometer.

SPLITSnow Eq 7: the BRDF of a bin is the fraction of rays collected in it over its projected solid
angle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.instruments.angular_estimate import (
    AngularEstimate,
    AngularTally,
    add_interpolation_error,
    compute_anisotropy,
)
from splits.instruments.linear_polarization import StokesEstimate
from splits.kernels.tallies.angular import (
    WEIGHT,
    WEIGHT_PRODUCT,
    tally_angular_bins,
)
from splits.kernels.tallies.exits import EXIT_LENGTH, N_STOKES_COLUMNS
from splits.simulation.exit_tally import ExitTally
from splits.simulation.interpolation_bounds import INTERPOLATION_FACTOR
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.stopping_rule import Evaluation, StoppingRule
from splits.simulation.stratum import Stratum

DEFAULT_N_BINS = (18, 72)
"""Bins in polar and in azimuth angle: as many as bins of 5° by 5°."""


class BinScore(NamedTuple):
    """Sums over the rays of a chunk, see `AngularBinTally`."""

    bins: np.ndarray
    stokes: np.ndarray
    unscattered: np.ndarray


class AngularBinTally(AngularTally, ExitTally):
    """Tally of exits by angular bin.

    Parameters
    ----------
    nodes, absorption
        See `Tally`.
    n_bins : (int, int)
        Bins in polar and in azimuth angle.
    polarized : bool
        Whether exits have Stokes parameters.

    Attributes
    ----------
    bin_sums : float, shape (2, 2, node rows, polar, azimuth)
        Of I, see `splits.kernels.tallies.angular.tally_angular_bins`.
    stokes_sums : float, shape (3, 3, 2, node rows, polar, azimuth)
        Of Q, U and V, with products; shape (0, ...) for exits without polarization.
    unscattered_sums : float, shape (2, 2, node rows)
    """

    first_stream = 5_000_000

    def __init__(
        self,
        nodes: IndexNodes,
        absorption: np.ndarray,
        n_bins: tuple[int, int],
        polarized: bool,
    ) -> None:
        super().__init__(nodes, absorption)
        self.n_bins = n_bins
        first = EXIT_LENGTH + absorption.shape[1]
        self.stokes_columns = range(first, first + N_STOKES_COLUMNS * polarized)
        n_rows, n_components = len(self.rows), len(self.stokes_columns)
        self.bin_sums = np.zeros((2, 2, n_rows, *n_bins))
        self.stokes_sums = np.zeros((n_components, 3, 2, n_rows, *n_bins))
        self.unscattered_sums = np.zeros((2, 2, n_rows))
        self.values_per_row = 4 + (4 + 6 * n_components) * n_bins[0] * n_bins[1]
        self.add_strata()

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> BinScore:
        """Return the sums of a chunk of exits."""
        scattered, unscattered = tally_angular_bins(exits, stratum.absorption, *self.n_bins, -1)
        stokes = np.zeros((len(self.stokes_columns), 3, *scattered.shape[1:]))
        for sums, column in zip(stokes, self.stokes_columns, strict=True):
            sums[:] = tally_angular_bins(exits, stratum.absorption, *self.n_bins, column).scattered
        return BinScore(scattered, stokes, unscattered)

    def merge(self, stratum: Stratum, score: BinScore) -> None:
        """Add the sums of the next chunk of a stratum."""
        self.bin_sums[:, :, stratum.node_rows] += score.bins
        self.stokes_sums[:, :, :, stratum.node_rows] += score.stokes
        self.unscattered_sums[:, :, stratum.node_rows] += score.unscattered

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the estimate, from a fixed number of rays."""
        return Evaluation(np.inf, self.make_estimate())

    def make_estimate(self) -> AngularEstimate:
        """Estimate BRDF and BTDF of every bin, starting at the zenith."""
        mean, stderr = self._compute_bin_means(self.bin_sums)
        n_rows = len(self.absorption)
        total = self.bin_sums.sum(axis=(-2, -1)) + self.unscattered_sums
        hemispherical = np.concatenate(
            [self.combine_moments(*sums) for sums in (total, self.unscattered_sums)]
        )
        estimate = AngularEstimate(
            mean, stderr, stderr, hemispherical, np.zeros((2, n_rows), dtype=int),
            np.zeros_like(mean), *compute_anisotropy(mean[0], stderr[0], hemispherical[0, 0]),
        )  # fmt: skip
        return add_interpolation_error(estimate, self.nodes.interpolation_bound)

    def make_stokes(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the variables of polarized exits, see `StokesEstimate`."""
        if not len(self.stokes_sums):
            return {}
        # Q, U and V of unseen rays are as small as those of seen ones.
        components = [
            self._compute_bin_means(self.bin_sums),
            *(self._compute_bin_means(sums[:WEIGHT_PRODUCT], 0.0) for sums in self.stokes_sums),
        ]
        mean, stderr = (np.stack(one) for one in zip(*components, strict=True))
        bound = INTERPOLATION_FACTOR * self.nodes.interpolation_bound[:, np.newaxis]
        stderr = np.hypot(stderr, bound * mean[0])
        n_rays = self.count_rays()[:, np.newaxis, np.newaxis]
        per_node = (
            self.stokes_sums[:, WEIGHT_PRODUCT] / n_rays
            - self.stokes_sums[:, WEIGHT] * self.bin_sums[WEIGHT] / n_rays**2
        ) / n_rays
        covariance = self._arrange_bins(
            self.combine_nodes(np.moveaxis(per_node, 2, -1), power=2), 2
        )
        return StokesEstimate(mean, stderr, covariance).make_variables()

    def _compute_bin_means(
        self, sums: np.ndarray, largest: float = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a distribution function and its standard errors, shape (2, rows, directions).

        Parameters
        ----------
        sums : float, shape (2, 2, node rows, polar, azimuth)
        largest : float
            See `combine_moments`.
        """
        total, square = np.moveaxis(sums, 2, -1)
        mean, stderr = self.combine_moments(total, square, largest)
        return self._arrange_bins(mean, 1), self._arrange_bins(stderr, 1)

    def _arrange_bins(self, values: np.ndarray, power: int) -> np.ndarray:
        """Return fractions of light per projected solid angle, starting at the zenith.

        Parameters
        ----------
        values : float, shape (..., polar, azimuth, rows)
        power : int
            Power of the fraction, 2 for a variance.

        Returns
        -------
        float, shape (..., rows, directions)
        """
        polar, azimuth = self.n_bins
        edges = np.arange(polar + 1) / polar
        projected_solid_angle = (np.pi / azimuth * np.diff(edges**2))[::-1, np.newaxis]
        values = np.moveaxis(values, -1, -3)[..., ::-1, :] / projected_solid_angle**power
        return values.reshape(*values.shape[:-2], polar * azimuth)


def compute_bin_centres(n_bins: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the polar and azimuth angles (degrees) of bin centres, starting at the zenith."""
    polar, azimuth = n_bins
    cosine = (np.arange(polar)[::-1] + 0.5) / polar
    return np.degrees(np.arccos(cosine)), np.arange(azimuth) * (360.0 / azimuth)
