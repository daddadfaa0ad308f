"""Truncated media: results of a whole medium from those of the part above a truncation depth."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from splits.simulation.spectral_rows import GROUND_DERIVATIVE, PathSharingMedia
from splits.simulation.spectral_tally import Derivatives, SpectralEstimate

THEORY_UNCERTAINTY = 0.3
"""Relative uncertainty of the diffusion-theory absorptance below the truncation depth."""
ERROR_BUDGET_FRACTION = 0.4
"""Fraction of the requested error that the truncation may contribute."""


class TruncatedMedium(NamedTuple):
    """A truncated medium, or several that share paths, with one truncation depth.

    Attributes
    ----------
    path_sharing : PathSharingMedia
        Media down to the truncation depth, over grounds that replace the rest.
    depth_m : float
        Truncation depth (m).
    transmitted_fraction : float, shape (media, wavelengths)
        Fraction of the light that enters the rest which leaves it at the bottom.
    conservative : bool, shape (media, wavelengths)
        Whether nothing absorbs, below the truncation depth and above, and the ground below
        transmits what it does not reflect.
    escape_probability : float, shape (media, wavelengths)
        Probability that light from the truncation depth escapes at the top.
    ground_absorption : float, shape (media, wavelengths)
        Absorption of the ground that replaces the rest, −ln of its albedo.
    semi_infinite_depth_m : float
        Depth above which the lowest layer reflects diffuse light like a semi-infinite one, within
        the requested error, by diffusion theory (m).
    """

    path_sharing: PathSharingMedia
    depth_m: float
    transmitted_fraction: np.ndarray
    conservative: np.ndarray
    escape_probability: np.ndarray
    ground_absorption: np.ndarray
    semi_infinite_depth_m: float

    def complete_estimate(self, above: SpectralEstimate) -> SpectralEstimate:
        """Return the estimate of whole media, but for the perturbed ones, from the parts above."""
        n_media = self.path_sharing.n_reported
        transmitted_fraction, conservative, escape = (
            x[:n_media].ravel()
            for x in (self.transmitted_fraction, self.conservative, self.escape_probability)
        )
        entering = above.mean[1]
        reflected = np.minimum(above.mean[0], 1.0)
        # Where nothing is absorbed, transmittance is 1 − reflectance, and has the same error.
        transmitted = np.where(
            conservative,
            1.0 - reflected,
            np.minimum(entering * transmitted_fraction, 1.0 - reflected),
        )
        mean = np.stack([reflected, transmitted, 1.0 - reflected - transmitted])
        reflected_error = THEORY_UNCERTAINTY * entering * escape
        transmitted_error = np.where(
            transmitted_fraction == 1.0, reflected_error, THEORY_UNCERTAINTY * transmitted
        )
        absorbed_error = np.where(conservative, 0.0, np.hypot(reflected_error, transmitted_error))
        theory_error = np.stack([reflected_error, transmitted_error, absorbed_error])
        scale = np.stack([np.ones_like(entering), transmitted_fraction, np.ones_like(entering)])
        statistical_error = scale * above.stderr
        # The absorptance is that above the truncation depth plus that of the rest: everything
        # that is neither reflected nor transmitted.
        statistical_error[2] = np.minimum(
            statistical_error[2] + (1.0 - transmitted_fraction) * above.stderr[1],
            statistical_error[0] + statistical_error[1],
        )
        statistical_error[1, conservative] = statistical_error[0, conservative]
        statistical_error[2, conservative] = 0.0
        stderr = np.hypot(statistical_error, theory_error)
        batch_deviations = above.batch_deviations * scale[:2]
        batch_deviations[:, 1, conservative] = -batch_deviations[:, 0, conservative]
        interpolation_error = np.hypot(scale * above.interpolation_error, theory_error)
        return replace(
            above,
            mean=mean,
            stderr=stderr,
            interpolation_error=interpolation_error,
            batch_deviations=batch_deviations,
        )

    def complete_derivatives(self, above: SpectralEstimate, steps: np.ndarray) -> Derivatives:
        """Return derivatives of the whole first medium from those of the part above.

        Changes of the reflectance and transmittance of the rest follow from diffusion theory, whose
        relative uncertainty applies to them.
        """
        step = steps[:, np.newaxis]
        ground_change = (self.ground_absorption[1:] - self.ground_absorption[0]) / step
        transmitted_change = (self.transmitted_fraction[1:] - self.transmitted_fraction[0]) / step
        along_paths = above.derivatives.select(slice(None, GROUND_DERIVATIVE))
        ground_mean = above.derivatives.mean[:, GROUND_DERIVATIVE, np.newaxis]
        entering, transmitted_fraction = above.mean[1], self.transmitted_fraction[0]
        scale = np.stack([np.ones_like(transmitted_fraction), transmitted_fraction])[:, np.newaxis]
        theory_term = np.stack([np.zeros_like(transmitted_change), entering * transmitted_change])
        batch_deviations = along_paths.batch_deviations * scale
        batch_deviations[:, 1] += above.batch_deviations[:, 1, np.newaxis] * transmitted_change
        theory_error = THEORY_UNCERTAINTY * (
            scale * np.abs(ground_change * ground_mean) + np.abs(theory_term)
        )
        bias_bound = np.hypot(scale * along_paths.bias_bound, theory_error)
        return Derivatives(along_paths.mean * scale + theory_term, batch_deviations, bias_bound)
