"""Degree and angle of linear polarization, from Stokes parameters with errors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

STOKES_NAMES = "quv"
FUNCTIONS = ("brdf", "btdf")
"""Distribution functions of reflected and of transmitted light."""
SMALLEST_INTENSITY = 1e-100
"""Intensity below which light has no known polarization, so that no square underflows."""
MAX_ANGLE_STDERR_DEG = 180.0 / np.sqrt(12.0)
"""Standard deviation of an unknown angle, which is uniform over 180 degrees."""


class StokesEstimate(NamedTuple):
    """Stokes parameters of the light in each direction.

    Attributes
    ----------
    mean, stderr : float, shape (4, 2, wavelengths, directions)
        I, Q, U and V of the reflected and of the transmitted light (1/sr), and their errors.
    covariance : float, shape (3, 2, wavelengths, directions)
        Covariances of I and Q, I and U, and Q and U.
    """

    mean: np.ndarray
    stderr: np.ndarray
    covariance: np.ndarray

    def make_variables(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return Q, U, V, degree and angle of polarization with their errors, by name."""
        variables = {
            f"{function}_{name}": (self.mean[component, side], self.stderr[component, side])
            for component, name in enumerate(STOKES_NAMES, start=1)
            for side, function in enumerate(FUNCTIONS)
        }
        polarization = compute_linear_polarization(*self)
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
