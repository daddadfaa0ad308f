"""Tally of next-event detectors: sums of batches, and the resulting BRDF and BTDF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splits.instruments.angular_estimate import AngularEstimate, compute_max_relative_error
from splits.simulation.runner import RAYS_PER_CHUNK


@dataclass(frozen=True)
class DetectorResult:
    """Result of detectors.

    Attributes
    ----------
    mean, stderr : float, shape (2, directions, 4)
        I, Q, U, V of the BRDF and the BTDF (1/sr) for unpolarized light.
    stopping_error : float, shape (2, directions)
        Errors of I for the stopping rule: larger, so that no run stops on batches that agree by
        chance.
    hemispherical, hemispherical_stderr : float, shape (2, 2)
        [reflected, transmitted][all light, unscattered light].
    n_rays : int
    stop_reason : str
        "converged" or "max_rays".
    polarized : bool
    has_lower_side : bool
        Whether light is detected below.
    """

    mean: np.ndarray
    stderr: np.ndarray
    stopping_error: np.ndarray
    hemispherical: np.ndarray
    hemispherical_stderr: np.ndarray
    n_rays: int
    stop_reason: str
    polarized: bool
    has_lower_side: bool

    def compute_max_error(self, side: int) -> float:
        """Return the largest relative error of one side for the stopping rule."""
        return compute_max_relative_error(
            self.to_angular_estimate(1), side, use_stopping_error=True
        )

    def to_angular_estimate(self, n_wavelengths: int) -> AngularEstimate:
        """Return BRDF and BTDF, the same at all wavelengths."""
        sums = np.empty((4, 2, n_wavelengths))
        sums[0::2] = self.hemispherical.T[:, :, np.newaxis]
        sums[1::2] = self.hemispherical_stderr.T[:, :, np.newaxis]
        mean, stderr, stopping_error = (
            np.repeat(x[:, np.newaxis], n_wavelengths, axis=1)
            for x in (self.mean[..., 0], self.stderr[..., 0], self.stopping_error)
        )
        degree = np.zeros((2, n_wavelengths), dtype=int)
        return AngularEstimate(mean, stderr, stopping_error, sums, degree, np.zeros_like(mean))

    def to_stokes(self, n_wavelengths: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return Q, U and V of BRDF and BTDF, each with its errors, by name."""
        return {
            f"{function}_{name}": (
                np.repeat(self.mean[np.newaxis, side, :, component], n_wavelengths, axis=0),
                np.repeat(self.stderr[np.newaxis, side, :, component], n_wavelengths, axis=0),
            )
            for side, function in enumerate(("brdf", "btdf")[: 1 + self.has_lower_side])
            for component, name in ((1, "q"), (2, "u"), (3, "v"))
        }


class DetectorTally:
    """Sums of batch scores in a fixed order.

    Attributes
    ----------
    n_batches : int
    sums, sums_of_squares, max_scores : float, shape (values,)
        Sums, sums of squares, and the score of largest magnitude of a batch, with its sign.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape
        self.n_batches = 0
        self.sums, self.sums_of_squares, self.max_scores = np.zeros((3, int(np.prod(shape)) + 4))

    def add_batch(self, score: np.ndarray) -> None:
        """Add the score of one batch."""
        self.n_batches += 1
        self.sums += score
        self.sums_of_squares += score**2
        self.max_scores = np.where(np.abs(score) > np.abs(self.max_scores), score, self.max_scores)

    def compute_result(
        self, has_lower_side: bool, polarized: bool, no_signal: bool, lossless: bool
    ) -> DetectorResult:
        """Return means and standard errors.

        One more batch with the largest score so far is included in the errors; where nothing was
        scored, one ray, except where no signal is possible (`no_signal`) or no light can be lost
        (`lossless`).
        """
        n, n_rays = self.n_batches, self.n_batches * RAYS_PER_CHUNK
        mean = self.sums / n
        mean_square = (self.sums_of_squares + self.max_scores**2) / (n + 1)
        # The additional batch enters the mean about which scatter is computed, but not the result.
        mean_with_extra = (self.sums + self.max_scores) / (n + 1)
        count = int(np.prod(self.shape))
        (scores, hemispherical), (stderr, hemispherical_stderr), (stopping_error, _) = (
            (values[:count].reshape(self.shape), values[count:].reshape(2, 2))
            for values in (
                mean,
                *(
                    np.sqrt(np.maximum(mean_square - centre**2, 0.0) / n)
                    for centre in (mean_with_extra, mean)
                ),
            )
        )
        for side in range(1 + has_lower_side) if not no_signal else ():
            unscored = scores[side, :, 0] == 0.0
            stderr[side, unscored, 0] = stopping_error[side, unscored, 0] = 1.0 / (np.pi * n_rays)
        if not lossless:
            hemispherical_stderr = np.maximum(hemispherical_stderr, 1.0 / n_rays)
        return DetectorResult(
            scores,
            stderr,
            stopping_error[..., 0],
            hemispherical,
            hemispherical_stderr,
            n_rays,
            "",
            polarized,
            has_lower_side,
        )
