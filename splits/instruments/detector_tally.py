"""Tally of next-event detectors: sums of batches, and the resulting BRDF and BTDF."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from splits.core.error_target import ErrorTarget
from splits.core.validation import invalid
from splits.instruments.angular_estimate import AngularEstimate, AngularTally, compute_anisotropy
from splits.instruments.linear_polarization import StokesEstimate
from splits.kernels.scene import Scene
from splits.kernels.transport.history import trace_to_detectors
from splits.kernels.transport.next_event import Detectors
from splits.media.medium import ParticleMedium
from splits.simulation.spectral_nodes import make_separate_nodes
from splits.simulation.strata import Evaluation, StoppingRule, Stratum
from splits.simulation.tally import LOST_MESSAGE, RAYS_PER_CHUNK, allow_for_unseen_rays

PILOT_BATCHES = 128
"""Batches of the first round."""
_EMPTY_PILOTS = 64
"""Multiple of the first round without any light after which a run ends."""


class DetectorTally(AngularTally):
    """Sums over batches of rays of their contributions to detectors.

    A batch is a chunk of rays; the layer is the same at all wavelengths.

    Parameters
    ----------
    layers : sequence of ParticleMedium
        See `splits.instruments.next_event.get_detected_layers`.
    scene : Scene
    detectors : Detectors
    target : ErrorTarget
    n_wavelengths : int

    Raises
    ------
    ValueError
        For the transmitted side of a medium whose lower boundary is not open.

    Attributes
    ----------
    sums, sums_of_squares, max_scores : float, shape (values,)
        Sums, sums of squares, and the score of largest magnitude of a batch, with its sign: of
        detectors [side, direction, Stokes parameter], then of [reflected, transmitted][all light,
        unscattered light].
    sums_of_products : float, shape (2, directions, 3)
        Of the scores of I and Q, I and U, and Q and U.
    """

    first_stream = 7_000_000

    def __init__(
        self,
        layers: Sequence[ParticleMedium],
        scene: Scene,
        detectors: Detectors,
        target: ErrorTarget,
        n_wavelengths: int,
    ) -> None:
        if target.side == 1 and not detectors.has_lower_side:
            allowed = "brdf with estimator = next_event"
            raise invalid("target", "btdf", allowed, "the lower boundary is not open")
        indices = [layer.compute_refractive_indices(np.zeros(1)) for layer in layers]
        index = np.concatenate(indices, axis=1)
        super().__init__(make_separate_nodes(index), np.zeros(index.shape))
        self.detectors, self.shape = detectors, detectors.sums.shape
        self.target, self.n_wavelengths = target, n_wavelengths
        self.has_lower_side, self.polarized = detectors.has_lower_side, scene.stokes is not None
        # Light that reaches the bottom has other angles than at detectors outside.
        self.undefined_variables = () if self.has_lower_side else ("btdf",)
        scatters = any(one.single_scattering_albedo * one.extinction_per_m > 0.0 for one in layers)
        self.no_signal = scene.opaque is not None or not (scatters or scene.bottom_albedo)
        conservative = all(layer.single_scattering_albedo == 1.0 for layer in layers)
        self.lossless = conservative and scene.bottom_albedo == 1.0
        self.values_per_row = math.prod(self.shape) + 4
        self.sums, self.sums_of_squares, self.max_scores = np.zeros((3, self.values_per_row))
        self.sums_of_products = np.zeros((*self.shape[:2], 3))
        # For forward-peaked phase functions few events dominate the estimate.
        g = max(abs(layer.kernel_phase_function.g) for layer in layers)
        self.pilot_rays = RAYS_PER_CHUNK * int(
            PILOT_BATCHES * np.clip((1.0 + g) / (1.0 - g) ** 2 / 64.0, 1.0, 64.0)
        )
        self.add_strata()

    def plan_first_round(self, stop: StoppingRule) -> np.ndarray:
        """Return the rays of the first round, at least two batches."""
        return np.maximum(super().plan_first_round(stop), 2 * RAYS_PER_CHUNK)

    def trace_chunk(
        self, seed: int, scene: Scene, stratum: Stratum, first_ray: int
    ) -> tuple[np.ndarray, int]:
        """Trace a batch of rays, and return its mean contributions and the segments traced.

        Raises
        ------
        RuntimeError
            If a ray was lost.
        """
        detectors = self.detectors._replace(
            sums=np.zeros_like(self.detectors.sums),
            peak_directions=np.zeros_like(self.detectors.peak_directions),
        )
        totals = np.zeros((2, 2))
        work = np.array([stratum.stream, first_ray, self.rays_per_chunk, stratum.max_order])
        scene = scene._replace(detectors=detectors)
        result = trace_to_detectors(seed, work, scene, stratum.optics, totals)
        if result.lost:
            raise RuntimeError(LOST_MESSAGE)
        sums = np.concatenate([detectors.sums.ravel(), totals.ravel()])
        return sums / self.rays_per_chunk, int(result.n_segments[0])

    def merge(self, stratum: Stratum, score: np.ndarray) -> None:
        """Add the score of the next batch."""
        self.sums += score
        self.sums_of_squares += score**2
        detected, _ = self._split(score)
        self.sums_of_products += _multiply_pairs(detected)
        self.max_scores = np.where(np.abs(score) > np.abs(self.max_scores), score, self.max_scores)

    def compute_errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the standard errors of all values, and those for the stopping rule.

        One more batch with the largest score so far is included; for the stopping rule, its scatter
        is computed about the mean without it, so that no run stops on batches that agree by chance.
        """
        n_batches = self.n_rays // RAYS_PER_CHUNK
        mean_square = (self.sums_of_squares + self.max_scores**2) / (n_batches + 1)
        centres = (self.sums + self.max_scores) / (n_batches + 1), self.sums / n_batches
        stderr, stopping_error = (
            np.sqrt(np.maximum(mean_square - centre**2, 0.0) / n_batches) for centre in centres
        )
        return stderr, stopping_error

    def make_estimate(self) -> AngularEstimate:
        """Return BRDF and BTDF, the same at all wavelengths."""
        *detectors, hemispherical = self._estimate_detectors()
        shape = (2, self.n_wavelengths, self.shape[1])
        mean, stderr, stopping_error = (
            np.broadcast_to(one[:, np.newaxis, :, 0], shape) for one in detectors
        )
        totals = np.repeat(hemispherical.reshape(4, 2, 1), self.n_wavelengths, axis=2)
        return AngularEstimate(
            mean, stderr, stopping_error, totals, np.zeros(shape[:2], dtype=int), np.zeros(shape),
            *compute_anisotropy(mean[0], stderr[0], totals[0, 0]),
        )  # fmt: skip

    def make_stokes(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the variables of polarized light, see `StokesEstimate`."""
        if not self.polarized:
            return {}
        mean, stderr, *_ = self._estimate_detectors()
        n_batches = self.n_rays // RAYS_PER_CHUNK
        batch_mean, _ = self._split(self.sums / n_batches)
        product = self.sums_of_products / n_batches
        covariance = (product - _multiply_pairs(batch_mean)) / n_batches
        shape = (4, 2, self.n_wavelengths, self.shape[1])
        by_component = [
            np.broadcast_to(np.moveaxis(one, -1, 0)[:, :, np.newaxis], (one.shape[-1], *shape[1:]))
            for one in (mean, stderr, covariance)
        ]
        return StokesEstimate(*by_component).make_variables()

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the largest relative error, infinite as long as no light reached the detectors."""
        estimate = self.make_estimate()
        if self.no_signal or estimate.mean[self.target.side].any():
            error = estimate.compute_max_error(self.target, use_stopping_error=True)
            return Evaluation(error, estimate)
        gave_up = self.n_rays >= _EMPTY_PILOTS * self.pilot_rays
        return Evaluation(np.inf, estimate, "no_light" if gave_up else "")

    def allocate_rays(self, stop: StoppingRule, evaluation: Evaluation) -> np.ndarray:
        """Return the rays with which the largest relative error is the requested one."""
        n_batches = self.n_rays // RAYS_PER_CHUNK
        wanted = 1.05 * (evaluation.error / stop.max_error) ** 2 * n_batches
        return RAYS_PER_CHUNK * np.array([np.floor(wanted)])

    def _estimate_detectors(self) -> tuple[np.ndarray, ...]:
        """Return means, errors and errors for the stopping rule, and the hemispherical quantities.

        Where nothing was scored, the error is that of one ray, except where no signal is possible,
        or no light can be lost.

        Returns
        -------
        mean, stderr, stopping_error : float, shape (2, detectors, 4)
        hemispherical : float, shape (2, 2, 2)
            [all light, unscattered light][mean, error][reflected, transmitted].
        """
        batch_mean = self.sums / (self.n_rays // RAYS_PER_CHUNK)
        (mean, hemispherical_mean), (stderr, hemispherical_stderr), (stopping_error, _) = (
            self._split(values) for values in (batch_mean, *self.compute_errors())
        )
        if not self.no_signal:
            unscored = mean[..., 0] == 0.0
            unscored[1] &= self.has_lower_side
            stderr[unscored] = stopping_error[unscored] = 1.0 / (np.pi * self.n_rays)
        if not self.lossless:
            hemispherical_stderr = np.sqrt(
                allow_for_unseen_rays(hemispherical_stderr**2, 1.0 / self.n_rays**2)
            )
        hemispherical = np.stack([hemispherical_mean.T, hemispherical_stderr.T], axis=1)
        return mean, stderr, stopping_error, hemispherical

    def _split(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the values of detectors, and the hemispherical ones."""
        n_scores = math.prod(self.shape)
        return values[:n_scores].reshape(self.shape), values[n_scores:].reshape(2, 2)


def _multiply_pairs(stokes: np.ndarray) -> np.ndarray:
    """Return the products of I and Q, I and U, and Q and U, along the last axis."""
    return stokes[..., [0, 0, 1]] * stokes[..., [1, 2, 2]]
