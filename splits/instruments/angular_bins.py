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
from splits.instruments.linear_polarization import SMALLEST_INTENSITY, StokesEstimate
from splits.kernels.tallies.distributions import (
    FIRST_PRODUCT,
    FIRST_STOKES,
    FIRST_STOKES_SQUARED,
    N_POLARIZED_SUMS,
    WEIGHT,
    AngularSums,
    tally_angular_bins,
)
from splits.simulation.spectral_nodes import INTERPOLATION_FACTOR, IndexNodes
from splits.simulation.strata import Evaluation, StoppingRule, Stratum
from splits.simulation.tally import ExitTally

DEFAULT_N_BINS = (18, 72)
"""Bins in polar and in azimuth angle: as many as bins of 5° by 5°."""


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
    bin_sums : float, shape (2 or more, 2, node rows, polar, azimuth)
        See `splits.kernels.tallies.distributions.tally_angular_bins`.
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
        self.n_bins, self.polarized = n_bins, polarized
        n_rows, n_sums = len(self.rows), N_POLARIZED_SUMS if polarized else 2
        self.bin_sums = np.zeros((n_sums, 2, n_rows, *n_bins))
        self.unscattered_sums = np.zeros((2, 2, n_rows))
        self.values_per_row = 4 + 2 * n_sums * n_bins[0] * n_bins[1]
        self.add_strata()

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> AngularSums:
        """Return the sums of a chunk of exits."""
        sums: AngularSums = tally_angular_bins(
            exits, stratum.absorption, *self.n_bins, self.polarized
        )
        return sums

    def merge(self, stratum: Stratum, score: AngularSums) -> None:
        """Add the sums of the next chunk of a stratum."""
        self.bin_sums[:, :, stratum.node_rows] += score.scattered
        self.unscattered_sums[:, :, stratum.node_rows] += score.unscattered

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the estimate, from a fixed number of rays."""
        return Evaluation(np.inf, self.make_estimate())

    def make_estimate(self) -> AngularEstimate:
        """Estimate BRDF and BTDF of every bin, starting at the zenith."""
        mean, stderr = self._compute_bin_means(*self.bin_sums[:FIRST_STOKES])
        n_rows = len(self.absorption)
        total = self.bin_sums[:FIRST_STOKES].sum(axis=(-2, -1)) + self.unscattered_sums
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
        if not self.polarized:
            return {}
        intensity, square = self.bin_sums[:FIRST_STOKES]
        # Unseen rays may be fully polarized.  Their weight is taken as the mean of seen rays,
        # weighted by themselves.
        largest = np.divide(
            square, intensity, out=np.zeros_like(square), where=intensity > SMALLEST_INTENSITY
        )
        stokes = self.bin_sums[FIRST_STOKES:FIRST_STOKES_SQUARED]
        squares = self.bin_sums[FIRST_STOKES_SQUARED:FIRST_PRODUCT]
        components = [
            self._compute_bin_means(intensity, square),
            *(
                self._compute_bin_means(*sums, largest)
                for sums in zip(stokes, squares, strict=True)
            ),
        ]
        mean, stderr = (np.stack(one) for one in zip(*components, strict=True))
        bound = INTERPOLATION_FACTOR * self.nodes.interpolation_bound[:, np.newaxis]
        stderr = np.hypot(stderr, bound * mean[0])
        return StokesEstimate(mean, stderr, self._compute_covariances()).make_variables()

    def _compute_covariances(self) -> np.ndarray:
        """Return the covariances of I and Q, I and U, and Q and U, see `StokesEstimate`."""
        n_rays = self.count_rays()[:, np.newaxis, np.newaxis]
        intensity, q, u = self.bin_sums[[WEIGHT, FIRST_STOKES, FIRST_STOKES + 1]] / n_rays
        products = np.stack([intensity * q, intensity * u, q * u])
        per_node = (self.bin_sums[FIRST_PRODUCT:] / n_rays - products) / n_rays
        return self._arrange_bins(self.combine_nodes(np.moveaxis(per_node, 2, -1), power=2), 2)

    def _compute_bin_means(
        self, total: np.ndarray, square: np.ndarray, largest: np.ndarray | float = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a distribution function and its standard errors, shape (2, rows, directions).

        Parameters
        ----------
        total, square : float, shape (2, node rows, polar, azimuth)
            Sums of the weights and of their squares.
        largest : float
            See `combine_moments`.
        """
        if isinstance(largest, np.ndarray):
            largest = np.moveaxis(largest, 1, -1)
        moments = np.moveaxis(total, 1, -1), np.moveaxis(square, 1, -1)
        mean, stderr = self.combine_moments(*moments, largest)
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
