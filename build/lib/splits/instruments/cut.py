"""Packs that are cut, and the answer of the whole from that of the part above the cut."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from splits.instruments.estimators import Estimate
from splits.instruments.shared_paths import Slopes
from splits.media.turbid import Medium

DOUBT = 0.3
"""How far, as a part of itself, theory may be off in what the rest of a pack keeps."""
SHARE = 0.4
"""Part of the error asked for that the cut may take."""
ATTEMPTS = 3
"""Runs of a pack that is cut, each to half the error of the one before."""
NO_STEPS = np.zeros(0)


class Cut(NamedTuple):
    """A pack that is cut, or several alike that share paths, all cut at one depth.

    Attributes
    ----------
    media : tuple of Medium
        Down to the cut, over grounds that stand for the rest.
    depth_m : float
        Of the cut (m).
    passed : float, shape (media, wavelengths)
        Share that the rest lets through of what it keeps.
    clear : bool, shape (media, wavelengths)
        Whether nothing absorbs, below the cut and above, and the ground below lets pass what is
        not sent back.
    escape : float, shape (media, wavelengths)
        Chance that light from the cut leaves at the top.
    below : float, shape (media, wavelengths)
        Absorption of the ground that stands for the rest, −ln of its albedo.
    enough_m : float
        Depth from which on the lowest layer reflects diffuse light like one without end, within
        the error asked for, to diffusion theory (m).
    """

    media: tuple[Medium, ...]
    depth_m: float
    passed: np.ndarray
    clear: np.ndarray
    escape: np.ndarray
    below: np.ndarray
    enough_m: float

    def reached(
        self, estimate: Callable[[float], Estimate], max_stderr: float, steps: np.ndarray = NO_STEPS
    ) -> Estimate:
        """Return the estimate of the whole pack to an error.

        More may reach the cut than was foreseen, so that theory misses more there: then the part
        above it is measured again, to a smaller error.

        Parameters
        ----------
        estimate : callable
            Takes a largest error, returns the estimate of the part above the cut.
        max_stderr : float
        steps : float, shape (parameters,)
            By how much parameters are moved in all media but the first, where derivatives are
            asked for: those of the estimate, and one more to what the ground at the cut absorbs.
        """
        goal = max_stderr * (1.0 - SHARE**2) ** 0.5
        for _ in range(ATTEMPTS):
            found = estimate(goal)
            result = self.completed(found, max_stderr)
            if result.converged or not found.converged:
                break
            goal *= 0.5
        return replace(result, slopes=self.slopes(found, steps)) if steps.size else result

    def completed(self, found: Estimate, max_stderr: float) -> Estimate:
        """Return the estimate of the whole pack from that of the part above the cut."""
        media = found.mean.shape[1] // self.passed.shape[1]
        passed, clear, escape = (x[:media].ravel() for x in (self.passed, self.clear, self.escape))
        kept = found.mean[1]
        back = np.minimum(found.mean[0], 1.0)
        # Where nothing is absorbed, all that does not come back goes through, in error as in size.
        through = np.where(clear, 1.0 - back, np.minimum(kept * passed, 1.0 - back))
        mean = np.stack([back, through, 1.0 - back - through])
        doubt = DOUBT * kept * escape
        below = np.where(passed == 1.0, doubt, DOUBT * through)
        rest = np.where(clear, 0.0, np.hypot(doubt, below))
        missed = np.stack([doubt, below, rest])
        scale = np.stack([np.ones_like(kept), passed, np.ones_like(kept)])
        own = scale * found.stderr
        # Absorbed is what was so above the cut, and what the rest keeps for itself: all that is
        # neither reflected nor let through.
        own[2] = np.minimum(own[2] + (1.0 - passed) * found.stderr[1], own[0] + own[1])
        own[1], own[2] = np.where(clear, own[0], own[1]), np.where(clear, 0.0, own[2])
        stderr = np.hypot(own, missed)
        groups = found.groups * scale[:2]
        groups[:, 1] = np.where(clear, -groups[:, 0], groups[:, 1])
        bias = np.hypot(scale * found.bias, missed)
        converged = bool(stderr.max() <= max_stderr)
        return replace(
            found, mean=mean, stderr=stderr, bias=bias, groups=groups, converged=converged
        )

    def slopes(self, found: Estimate, steps: np.ndarray) -> Slopes:
        """Return derivatives of the whole pack's answer from those of the part above the cut.

        What the rest keeps and lets through is moved in theory, whose doubt holds for that part.
        """
        step = steps[:, np.newaxis]
        darker = (self.below[1:] - self.below[0]) / step
        passing = (self.passed[1:] - self.passed[0]) / step
        of_paths, ground = found.slopes.of(slice(None, -1)), found.slopes.of(slice(-1, None))
        kept, passed = found.mean[1], self.passed[0]
        scale = np.stack([np.ones_like(passed), passed])[:, np.newaxis]
        more = np.stack([np.zeros_like(passing), kept * passing])
        groups = of_paths.groups * scale
        groups[:, 1] += found.groups[:, 1, np.newaxis] * passing
        doubt = DOUBT * (scale * np.abs(darker * ground.mean) + np.abs(more))
        missed = np.hypot(scale * of_paths.missed, doubt)
        return Slopes(of_paths.mean * scale + more, groups, missed)
