"""Angular bins of equal solid angle, the estimator of the papers for a goniophotometer.

SPLITSnow Eq 7: the BRDF of a bin is the fraction of rays collected in it over its projected solid
angle.
"""

from __future__ import annotations

import numpy as np

from splits.instruments.angular_estimate import (
    AngularEstimate,
    AngularTally,
    add_interpolation_error,
    compute_anisotropy,
)
from splits.kernels.tallies.angular import AngularSums, tally_angular_bins
from splits.kernels.tallies.exits import EXIT_LENGTH, N_STOKES_COLUMNS
from splits.simulation.exit_tally import ExitTally
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.stopping_rule import Evaluation, StoppingRule
from splits.simulation.stratum import Stratum

DEFAULT_N_BINS = (18, 72)
"""Bins in polar and in azimuth angle: as many as bins of 5° by 5°."""
STOKES_NAMES = "quv"


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
    bin_sums : float, shape (components, 2, 2, node rows, polar, azimuth)
        Of I and, for polarized exits, of Q, U and V; see
        `splits.kernels.tallies.angular.tally_angular_bins`.
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
        self.factor_columns = (-1, *range(first, first + N_STOKES_COLUMNS * polarized))
        n_rows = len(self.rows)
        self.bin_sums = np.zeros((len(self.factor_columns), 2, 2, n_rows, *n_bins))
        self.unscattered_sums = np.zeros((2, 2, n_rows))
        self.values_per_row = 4 * (1 + len(self.factor_columns) * n_bins[0] * n_bins[1])
        self.add_strata()

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> AngularSums:
        """Return the sums of a chunk of exits."""
        by_component = [
            tally_angular_bins(exits, stratum.absorption, *self.n_bins, column)
            for column in self.factor_columns
        ]
        scattered = np.stack([sums.scattered for sums in by_component])
        return AngularSums(scattered, by_component[0].unscattered)

    def merge(self, stratum: Stratum, score: AngularSums) -> None:
        """Add the sums of the next chunk of a stratum."""
        self.bin_sums[:, :, :, stratum.node_rows] += score.scattered
        self.unscattered_sums[:, :, stratum.node_rows] += score.unscattered

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the estimate, from a fixed number of rays."""
        return Evaluation(np.inf, self.make_estimate())

    def make_estimate(self) -> AngularEstimate:
        """Estimate BRDF and BTDF of every bin, starting at the zenith."""
        mean, stderr = self._compute_bin_means(0)
        n_rows = len(self.absorption)
        total = self.bin_sums[0].sum(axis=(-2, -1)) + self.unscattered_sums
        hemispherical = np.concatenate(
            [self.combine_moments(*sums) for sums in (total, self.unscattered_sums)]
        )
        estimate = AngularEstimate(
            mean, stderr, stderr, hemispherical, np.zeros((2, n_rows), dtype=int),
            np.zeros_like(mean), *compute_anisotropy(mean[0], stderr[0], hemispherical[0, 0]),
        )  # fmt: skip
        return add_interpolation_error(estimate, self.nodes.interpolation_bound)

    def make_stokes(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return Q, U and V of BRDF and BTDF with their errors, by name, for polarized exits."""
        return {
            f"{function}_{name}": (mean[side], stderr[side])
            for component, name in enumerate(STOKES_NAMES[: len(self.bin_sums) - 1], start=1)
            for mean, stderr in [self._compute_bin_means(component)]
            for side, function in enumerate(("brdf", "btdf"))
        }

    def _compute_bin_means(self, component: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a distribution function and its standard errors, shape (2, rows, directions)."""
        total, square = np.moveaxis(self.bin_sums[component], 2, -1)
        # Q, U and V of unseen rays are as small as those of seen ones.
        largest = 1.0 if component == 0 else 0.0
        # Shape (2, rows, polar, azimuth), starting at the zenith.
        mean, stderr = (
            np.moveaxis(one, -1, 1)[:, :, ::-1]
            for one in self.combine_moments(total, square, largest)
        )
        polar, azimuth = self.n_bins
        edges = np.arange(polar + 1) / polar
        projected_solid_angle = (np.pi / azimuth * np.diff(edges**2))[::-1, np.newaxis]
        shape = (2, len(self.absorption), polar * azimuth)
        mean, stderr = mean / projected_solid_angle, stderr / projected_solid_angle
        return mean.reshape(shape), stderr.reshape(shape)


def compute_bin_centres(n_bins: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the polar and azimuth angles (degrees) of bin centres, starting at the zenith."""
    polar, azimuth = n_bins
    cosine = (np.arange(polar)[::-1] + 0.5) / polar
    return np.degrees(np.arccos(cosine)), np.arange(azimuth) * (360.0 / azimuth)
