"""Packs that are cut, and the answer of the whole from that of the part above the cut."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from splits.media.medium import Medium
from splits.simulation.estimators import SpectralEstimate
from splits.simulation.path_tally import Derivatives

THEORY_UNCERTAINTY = 0.3
"""How far, as a part of itself, theory may be off in what the rest of a pack keeps."""
ERROR_BUDGET_FRACTION = 0.4
"""Part of the error asked for that the cut may take."""
MAX_ATTEMPTS = 3
"""Runs of a pack that is cut, each to half the error of the one before."""
NO_STEPS = np.zeros(0)


class TruncatedMedium(NamedTuple):
    """A pack that is cut, or several alike that share paths, all cut at one depth.

    Attributes
    ----------
    media : tuple of Medium
        Down to the cut, over grounds that stand for the rest.
    depth_m : float
        Of the cut (m).
    transmitted_fraction : float, shape (media, wavelengths)
        Share that the rest lets through of what it keeps.
    conservative : bool, shape (media, wavelengths)
        Whether nothing absorbs, below the cut and above, and the ground below lets pass what is
        not sent back.
    escape_probability : float, shape (media, wavelengths)
        Chance that light from the cut leaves at the top.
    ground_absorption : float, shape (media, wavelengths)
        Absorption of the ground that stands for the rest, −ln of its albedo.
    semi_infinite_depth_m : float
        Depth from which on the lowest layer reflects diffuse light like one without end, within
        the error asked for, to diffusion theory (m).
    """

    media: tuple[Medium, ...]
    depth_m: float
    transmitted_fraction: np.ndarray
    conservative: np.ndarray
    escape_probability: np.ndarray
    ground_absorption: np.ndarray
    semi_infinite_depth_m: float

    def estimate_to_error(
        self,
        estimate_above: Callable[[float], SpectralEstimate],
        max_stderr: float,
        steps: np.ndarray = NO_STEPS,
    ) -> SpectralEstimate:
        """Return the estimate of the whole pack to an error.

        More may reach the cut than was foreseen, so that theory misses more there: then the part
        above it is measured again, to a smaller error.

        Parameters
        ----------
        estimate_above : callable
            Takes a largest error, returns the estimate of the part above the cut.
        max_stderr : float
        steps : float, shape (parameters,)
            By how much parameters are moved in all media but the first, where derivatives are
            asked for: those of the estimate, and one more to what the ground at the cut absorbs.
        """
        goal = max_stderr * (1.0 - ERROR_BUDGET_FRACTION**2) ** 0.5
        for _ in range(MAX_ATTEMPTS):
            found = estimate_above(goal)
            result = self.complete_estimate(found, max_stderr)
            if result.converged or not found.converged:
                break
            goal *= 0.5
        return (
            replace(result, derivatives=self.complete_derivatives(found, steps))
            if steps.size
            else result
        )

    def complete_estimate(self, above: SpectralEstimate, max_stderr: float) -> SpectralEstimate:
        """Return the estimate of the whole pack from that of the part above the cut."""
        media = above.mean.shape[1] // self.transmitted_fraction.shape[1]
        passed, clear, escape = (
            x[:media].ravel()
            for x in (self.transmitted_fraction, self.conservative, self.escape_probability)
        )
        kept = above.mean[1]
        back = np.minimum(above.mean[0], 1.0)
        # Where nothing is absorbed, all that does not come back goes through, in error as in size.
        through = np.where(clear, 1.0 - back, np.minimum(kept * passed, 1.0 - back))
        mean = np.stack([back, through, 1.0 - back - through])
        doubt = THEORY_UNCERTAINTY * kept * escape
        below = np.where(passed == 1.0, doubt, THEORY_UNCERTAINTY * through)
        rest = np.where(clear, 0.0, np.hypot(doubt, below))
        missed = np.stack([doubt, below, rest])
        scale = np.stack([np.ones_like(kept), passed, np.ones_like(kept)])
        own = scale * above.stderr
        # Absorbed is what was so above the cut, and what the rest keeps for itself: all that is
        # neither reflected nor let through.
        own[2] = np.minimum(own[2] + (1.0 - passed) * above.stderr[1], own[0] + own[1])
        own[1], own[2] = np.where(clear, own[0], own[1]), np.where(clear, 0.0, own[2])
        stderr = np.hypot(own, missed)
        groups = above.batch_deviations * scale[:2]
        groups[:, 1] = np.where(clear, -groups[:, 0], groups[:, 1])
        bias = np.hypot(scale * above.interpolation_error, missed)
        converged = bool(stderr.max() <= max_stderr)
        return replace(
            above,
            mean=mean,
            stderr=stderr,
            interpolation_error=bias,
            batch_deviations=groups,
            converged=converged,
        )

    def complete_derivatives(self, above: SpectralEstimate, steps: np.ndarray) -> Derivatives:
        """Return derivatives of the whole pack's answer from those of the part above the cut.

        What the rest keeps and lets through is moved in theory, whose doubt holds for that part.
        """
        step = steps[:, np.newaxis]
        darker = (self.ground_absorption[1:] - self.ground_absorption[0]) / step
        passing = (self.transmitted_fraction[1:] - self.transmitted_fraction[0]) / step
        of_paths, ground = (
            above.derivatives.select(slice(None, -1)),
            above.derivatives.select(slice(-1, None)),
        )
        kept, passed = above.mean[1], self.transmitted_fraction[0]
        scale = np.stack([np.ones_like(passed), passed])[:, np.newaxis]
        more = np.stack([np.zeros_like(passing), kept * passing])
        groups = of_paths.batch_deviations * scale
        groups[:, 1] += above.batch_deviations[:, 1, np.newaxis] * passing
        doubt = THEORY_UNCERTAINTY * (scale * np.abs(darker * ground.mean) + np.abs(more))
        missed = np.hypot(scale * of_paths.bias_bound, doubt)
        return Derivatives(of_paths.mean * scale + more, groups, missed)
