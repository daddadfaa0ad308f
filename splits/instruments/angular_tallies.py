"""Tallies of a goniophotometer over all directions: expansion and bins of equal solid angle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import ErrorTarget
from splits.instruments.angular_estimate import (
    N_ANGULAR_BATCHES,
    AngularEstimate,
    AngularTally,
    DirectionGrid,
    add_interpolation_error,
    compute_anisotropy,
    estimate_row,
    join_wavelengths,
)
from splits.kernels.records import EXIT_ORDER, AngularSums
from splits.kernels.scene import NO_MAX_ORDER
from splits.kernels.tallies.distributions import (
    FIRST_PRODUCT,
    FIRST_STOKES,
    FIRST_STOKES_SQUARED,
    N_POLARIZED_SUMS,
    WEIGHT,
    tally_angular_bins,
    tally_expansion,
)
from splits.simulation.spectral_nodes import INTERPOLATION_FACTOR, IndexNodes
from splits.simulation.strata import Evaluation, StoppingRule, Stratum
from splits.simulation.tally import RAYS_PER_CHUNK, ExitTally

# --------------------------------------------------------------------------------------------------
# Degree and angle of linear polarization, from Stokes parameters with errors.

STOKES_NAMES = "quv"
FUNCTIONS = ("brdf", "btdf")
"""Distribution functions of reflected and of transmitted light."""
SMALLEST_INTENSITY = 1e-100
"""Intensity below which light has no known polarization, so that no square underflows."""
MAX_ANGLE_STDERR_DEG = 180.0 / np.sqrt(12.0)
"""Standard deviation of an unknown angle, which is uniform over 180 degrees."""


def make_stokes_variables(
    mean: np.ndarray, stderr: np.ndarray, covariance: np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return Q, U, V, degree and angle of polarization of light with their errors, by name.

    Parameters
    ----------
    mean, stderr : float, shape (4, 2, wavelengths, directions)
        I, Q, U and V of the reflected and of the transmitted light (1/sr), and their errors.
    covariance : float, shape (3, 2, wavelengths, directions)
        Covariances of I and Q, I and U, and Q and U.
    """
    variables = {
        f"{function}_{name}": (mean[component, side], stderr[component, side])
        for component, name in enumerate(STOKES_NAMES, start=1)
        for side, function in enumerate(FUNCTIONS)
    }
    polarization = compute_linear_polarization(mean, stderr, covariance)
    for side, function in enumerate(FUNCTIONS):
        degree, degree_stderr, angle, angle_stderr = (one[side] for one in polarization)
        variables[f"{function}_dolp"] = degree, degree_stderr
        variables[f"{function}_aolp"] = angle, angle_stderr
    return variables


class PolarizationEstimate(NamedTuple):
    """Degree (0 to 1) and angle (degrees, 0 to 180) of linear polarization, and their errors."""

    degree: np.ndarray
    degree_stderr: np.ndarray
    angle: np.ndarray
    angle_stderr: np.ndarray


def compute_linear_polarization(
    mean: np.ndarray, stderr: np.ndarray, covariance: np.ndarray
) -> PolarizationEstimate:
    """Return the degree and the angle of linear polarization.

    √(Q² + U²) is positive even where Q and U are noise.  With q = Q/I, u = U/I and p = √(q² + u²),
    the estimate with this bias removed is that of Plaszczynski et al. (2014),

        p − b² (1 − exp(−p²/b²))/(2p),

    where b is the standard error perpendicular to the direction of polarization in the plane of q
    and u.  For degrees above 2b the bias is below b/10.  Unpolarized light has an estimate of b on
    average, with a stated error of b.

    Parameters
    ----------
    mean, stderr : float, shape (3 or more, ...)
        I, Q and U, and their standard errors; further components are ignored.
    covariance : float, shape (3, ...)
        Covariances of I and Q, I and U, and Q and U.

    Returns
    -------
    PolarizationEstimate
        Without light, the degree is 0 with an error of 1.  The error of the angle is at most
        `MAX_ANGLE_STDERR_DEG`, that of an unknown angle.

    References
    ----------
    Plaszczynski, Montier, Levrier & Tristram (2014), Mon. Not. R. Astron. Soc. 439, 4048.
    """
    has_light = mean[0] > SMALLEST_INTENSITY
    per = np.divide(1.0, mean[0], out=np.zeros_like(mean[0]), where=has_light)
    q, u = mean[1] * per, mean[2] * per
    var_i, var_q, var_u = (stderr[:3] * per) ** 2
    cov_iq, cov_iu, cov_qu = covariance * per * per
    # Variances and covariance of the ratios q and u, in which noise shared with I cancels.
    qq = var_q + q * (q * var_i - 2.0 * cov_iq)
    uu = var_u + u * (u * var_i - 2.0 * cov_iu)
    qu = cov_qu - q * cov_iu - u * cov_iq + q * u * var_i
    square = q * q + u * u
    cos2 = np.divide(q * q, square, out=np.full_like(square, 0.5), where=square > 0.0)
    cos_sin = np.divide(q * u, square, out=np.zeros_like(square), where=square > 0.0)
    along = np.maximum(cos2 * qq + (1.0 - cos2) * uu + 2.0 * cos_sin * qu, 0.0)
    across = np.maximum((1.0 - cos2) * qq + cos2 * uu - 2.0 * cos_sin * qu, 0.0)
    # b² is `across`, and x = p²/b²; where Q and U have no scatter there is no bias.
    x = np.divide(square, across, out=np.full_like(square, np.inf), where=across > 0.0)
    relative_bias = np.divide(-np.expm1(-x), 2.0 * x, out=np.full_like(x, 0.5), where=x > 0.0)
    degree = np.sqrt(square) * (1.0 - relative_bias)
    degree_stderr = np.where(has_light, np.minimum(np.sqrt(along), 1.0), 1.0)
    angle = np.degrees(0.5 * np.arctan2(u, q)) % 180.0
    unknown = np.full_like(degree, np.radians(2.0 * MAX_ANGLE_STDERR_DEG))
    relative = np.divide(np.sqrt(across), degree, out=unknown, where=degree > 0.0)
    angle_stderr = np.minimum(np.degrees(0.5 * relative), MAX_ANGLE_STDERR_DEG)
    return PolarizationEstimate(np.clip(degree, 0.0, 1.0), degree_stderr, angle, angle_stderr)


# --------------------------------------------------------------------------------------------------
# Angular bins of equal solid angle, the estimator of the papers for a goniophotometer.
#
# SPLITSnow Eq 7: the BRDF of a bin is the fraction of rays collected in it over its projected solid
# angle.

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
        return tally_angular_bins(exits, stratum.absorption, *self.n_bins, self.polarized)

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
        (fraction, error), (unscattered, unscattered_error) = (
            self.combine_moments(*sums) for sums in (total, self.unscattered_sums)
        )
        estimate = AngularEstimate(
            mean, stderr, stderr, fraction, error, unscattered, unscattered_error,
            np.zeros((2, n_rows), dtype=int), np.zeros_like(mean),
            *compute_anisotropy(mean[0], stderr[0], fraction[0]),
        )  # fmt: skip
        return add_interpolation_error(estimate, self.nodes.interpolation_bound)

    def make_stokes(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the variables of polarized exits, see `make_stokes_variables`."""
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
        n_rays = self.count_rays()[:, np.newaxis, np.newaxis]
        i, q, u = self.bin_sums[[WEIGHT, FIRST_STOKES, FIRST_STOKES + 1]] / n_rays
        products = np.stack([i * q, i * u, q * u])
        per_node = (self.bin_sums[FIRST_PRODUCT:] / n_rays - products) / n_rays
        covariance = self.combine_nodes(np.moveaxis(per_node, 2, -1), power=2)
        return make_stokes_variables(mean, stderr, self._arrange_bins(covariance, 2))

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


# --------------------------------------------------------------------------------------------------
# Tally of a goniophotometer: polynomial coefficients by order of scattering.
#
# Low orders of scattering produce the structure of a BRDF and cost little; high orders make most of
# the light, cost most, and are nearly diffuse.  Orders of scattering are therefore grouped in
# classes.  Rays of a stratum are terminated after the last order of its class: they contribute to
# that class and all before it, so that low classes can have many times the rays of the high ones
# (correlated through common paths, which errors from batches account for).

MAX_DEGREE = 24
"""Largest degree of the polynomials, which resolve details of about 180°/24."""
ORDER_CLASSES = (2, 8, 32, 128, NO_MAX_ORDER)
"""Largest order of scattering of each class."""

RowVariances = tuple[np.ndarray, np.ndarray]
"""Nodes of a row, and their contributions to its variance, shape (nodes, classes, directions)."""


class ExpansionTally(AngularTally, ExitTally):
    """Tally of exits by direction, as coefficients of orthonormal polynomials.

    Parameters
    ----------
    nodes, absorption
        See `Tally`.
    directions : DirectionGrid
    incidence : float or "diffuse"
        Unscattered light of a beam leaves as a beam and is excluded from the polynomials; that of
        diffuse light is included.
    target : ErrorTarget

    Attributes
    ----------
    coefficient_sums : float, shape (batches, classes, 2, node rows, polynomials)
        See `splits.kernels.tallies.distributions.tally_expansion`.
    unscattered_sums : float, shape (batches, 2, node rows)
    """

    first_stream = 4_000_000
    rays_per_round = N_ANGULAR_BATCHES * RAYS_PER_CHUNK

    def __init__(
        self,
        nodes: IndexNodes,
        absorption: np.ndarray,
        directions: DirectionGrid,
        incidence: float | str,
        target: ErrorTarget,
    ) -> None:
        super().__init__(nodes, absorption)
        self.directions, self.incidence, self.target = directions, incidence, target
        self.basis = directions.basis
        self.max_orders = np.array(ORDER_CLASSES, dtype=np.int64)
        n_classes, n_rows = len(ORDER_CLASSES), len(self.rows)
        self.coefficient_sums = np.zeros(
            (N_ANGULAR_BATCHES, n_classes, 2, n_rows, self.basis.norms.size)
        )
        self.unscattered_sums = np.zeros((N_ANGULAR_BATCHES, 2, n_rows))
        self.values_per_row = 2 * (1 + n_classes * self.basis.norms.size)
        self.add_strata(ORDER_CLASSES)
        self._earlier_errors: list[tuple[int, float]] = []

    def plan_first_round(self, stop: StoppingRule) -> np.ndarray:
        """Return the rays of each stratum in the first round, from which the others follow."""
        return np.full(len(self.strata), self.rays_per_round)

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> AngularSums:
        """Return the sums of a chunk of exits."""
        scored_orders = self.max_orders[self.max_orders <= stratum.max_order]
        if self.incidence == "diffuse":
            exits[:, EXIT_ORDER] = np.maximum(exits[:, EXIT_ORDER], 1.0)
        return tally_expansion(exits, stratum.absorption, scored_orders, self.basis)

    def merge(self, stratum: Stratum, score: AngularSums) -> None:
        """Add the sums of the next chunk of a stratum."""
        batch, rows = self.get_batch(stratum, N_ANGULAR_BATCHES), stratum.node_rows
        self.coefficient_sums[batch, : len(score.scattered), :, rows] += score.scattered
        self.unscattered_sums[batch, :, rows] += score.unscattered

    def count_class_rays(self) -> np.ndarray:
        """Return the rays that contribute to each class, shape (nodes, classes)."""
        rays = self.stratum_rays.reshape(-1, len(ORDER_CLASSES))
        return np.cumsum(rays[:, ::-1], axis=1)[:, ::-1]

    def _estimate_rows(self) -> tuple[AngularEstimate, list[RowVariances]]:
        """Return the estimate, and the contributions to the variance of each wavelength."""
        class_rays = self.count_class_rays()[self.node_of_row]
        estimates, all_variances = [], []
        for row in range(len(self.absorption)):
            used = np.flatnonzero(self.rows == row)
            coefficients, unscattered = [], np.zeros((N_ANGULAR_BATCHES, 2))
            for one in used:
                weight, rays = self.weights[one], class_rays[one] / N_ANGULAR_BATCHES
                sums = self.coefficient_sums[:, :, :, one]
                coefficients.append(weight * sums / rays[:, np.newaxis, np.newaxis])
                unscattered += weight * self.unscattered_sums[:, :, one] / rays[0]
            n_rays = class_rays[used].min(axis=0)
            estimate, variances = estimate_row(
                coefficients, unscattered, n_rays, self.directions,
                self.incidence in (0.0, "diffuse"), self.target,
            )  # fmt: skip
            estimates.append(estimate)
            all_variances.append((self.node_of_row[used], np.stack(variances)))
        joined = join_wavelengths(estimates, np.stack)
        return add_interpolation_error(joined, self.nodes.interpolation_bound), all_variances

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the largest relative error, and why tracing stops if no rays would reduce it."""
        estimate, self.variances = self._estimate_rows()
        target, n_rays = self.target, self.n_rays
        error = estimate.compute_max_error(target, use_stopping_error=True)
        if error <= stop.max_error:
            resolved = estimate.compute_max_error(target) <= stop.max_error
            return Evaluation(error, estimate, "" if resolved else "unresolved_lobe")
        # Eight times the rays should reduce a statistical error by a factor of nearly three.
        stagnates = any(
            n_rays >= 8.0 * earlier_rays and error > 0.8 * earlier
            for earlier_rays, earlier in self._earlier_errors
        )
        self._earlier_errors.append((n_rays, error))
        limited = estimate.is_truncation_limited(target, stop.max_error)
        return Evaluation(error, estimate, "max_degree" if stagnates or limited else "")

    def allocate_rays(self, stop: StoppingRule, evaluation: Evaluation) -> np.ndarray:
        """Return the rays of every stratum for the least cost.

        With V the variance per ray and c the segments of a ray in a class, Σ V/M reaches a target
        at the least Σ c·M for M = √(V/c)·Σ √(V·c)/target (Neyman's allocation), M being the rays
        that contribute to a class; the largest M over directions is taken.  Rays contribute to all
        classes up to that of their stratum, so M must not increase from class to class.
        """
        class_rays = self.count_class_rays()
        segments = np.array([one.n_segments / max(one.n_rays, 1) for one in self.strata])
        costs = np.maximum(np.diff(segments.reshape(class_rays.shape), prepend=-1.0, axis=1), 0.01)
        interpolation_error = INTERPOLATION_FACTOR * self.nodes.interpolation_bound[:, np.newaxis]
        reference = evaluation.estimate.compute_reference(self.target)
        mean = evaluation.estimate.mean[self.target.side][:, self.target.direction_mask]
        targets = (stop.max_error * reference) ** 2 - (interpolation_error * mean) ** 2
        target_rays = np.zeros(class_rays.shape)
        for (nodes, row_variances), target in zip(self.variances, targets, strict=True):
            cost = costs[nodes][:, :, np.newaxis]
            per_ray = row_variances * class_rays[nodes][:, :, np.newaxis]
            root_cost = np.sqrt(per_ray * cost).sum(axis=(0, 1))
            # Directions without light need no rays.
            factor = np.divide(root_cost, target, out=np.zeros_like(root_cost), where=target > 0.0)
            required_rays = (np.sqrt(per_ray / cost) * factor).max(axis=-1)
            target_rays[nodes] = np.maximum(target_rays[nodes], required_rays)
        target_rays = np.maximum.accumulate(target_rays[:, ::-1], axis=1)[:, ::-1]
        stratum_rays = -np.diff(target_rays, axis=1, append=0.0).ravel()
        size = self.rays_per_round
        stratum_rays = np.maximum(np.ceil(1.1 * stratum_rays / size), 1.0) * size
        if stop.fixed:
            stratum_rays *= self._find_scale(stratum_rays, stop.max_rays)
        return stratum_rays

    def _find_scale(self, target_rays: np.ndarray, max_rays: int) -> float:
        """Return the factor of the required rays with which they add up to a number."""
        n_rays = self.stratum_rays
        low, high = 0.0, max_rays / target_rays.min()
        for _ in range(60):
            middle = 0.5 * (low + high)
            enough = np.maximum(middle * target_rays, n_rays).sum() >= max_rays
            low, high = (low, middle) if enough else (middle, high)
        return high
