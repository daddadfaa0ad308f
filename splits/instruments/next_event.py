"""Next-event estimation: every scattering contributes to each view direction.

Budak & Grimailo 2020, Eqs 4-5 (local estimation): the radiance on a circle above the layer,
without collectors of finite size.  Errors come from the scatter of batches of rays.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from splits.core.progress import Progress
from splits.core.validation import invalid
from splits.instruments.angular_estimate import AngularEstimate, compute_max_relative_error
from splits.kernels.grains.scene import NO_MAX_ORDER
from splits.kernels.optics.forward_peak import PhaseFunctionPeak, separate_peak
from splits.kernels.optics.polarized_interface import compute_fresnel_mueller
from splits.kernels.optics.source import Source
from splits.kernels.optics.stokes import UNPOLARIZED
from splits.kernels.particle_layer import particle_history as kernels
from splits.kernels.particle_layer.next_event import Detectors
from splits.kernels.particle_layer.scene import OPEN_BOTTOM, LayerScene
from splits.media.medium import Medium, ParticleMedium
from splits.simulation import random_streams
from splits.simulation.runner import RAYS_PER_CHUNK, Runner
from splits.simulation.threads import DaemonThreadPool

PILOT_BATCHES = 128
"""Batches of the first round."""
_MAX_ROUND_GROWTH = 8.0
NEGLIGIBLE_PROBABILITY = 1e-16
"""Probability of more successive scatterings into a peak than are stored."""
MAX_PEAK_FRACTION = 0.99
"""Largest probability of scattering into a peak: above it, light needs hundreds of scatterings to
change its direction."""
MAX_PENDING_BATCHES = 4096
"""Largest number of batches that wait for a thread."""


@dataclass(frozen=True)
class StoppingRule:
    """Stopping rule of a run: a relative error on one side, or a number of rays."""

    side: int
    relative_stderr: float
    n_rays: int | None
    max_rays: int


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


def make_detectors(medium: ParticleMedium, polar: np.ndarray, azimuth: np.ndarray) -> Detectors:
    """Return detectors on a grid of directions, azimuth running fastest.

    Parameters
    ----------
    medium : ParticleMedium
    polar, azimuth : float
        Degrees, of the directions outside.
    """
    layer = medium.make_scattering_layer(False)
    outer_polar, azimuth_rad = np.radians(np.meshgrid(polar, azimuth, indexing="ij")).reshape(2, -1)
    sine = np.sin(outer_polar) / layer.refractive_index
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    directions = np.stack([sine * np.cos(azimuth_rad), sine * np.sin(azimuth_rad), cosine], axis=1)
    interfaces = [compute_fresnel_mueller(layer.refractive_index, 1.0, c) for c in cosine]
    reflection = np.array([interface.reflection for interface in interfaces])
    transmission = np.array([interface.transmission for interface in interfaces])
    if not medium.polarized:
        reflection = reflection * [1.0, 0.0, 0.0, 0.0]
        transmission = transmission * [1.0, 0.0, 0.0]
    # dΩ inside/dΩ outside = cosθ/(n² cosθ'); a BRDF is per outer cosine.
    transmission = transmission / (layer.refractive_index**2 * cosine[:, np.newaxis])
    has_lower_side = layer.bottom_albedo == OPEN_BOTTOM and np.isfinite(layer.depth)
    sums = np.zeros((2, len(directions), 4))
    plane = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=1)
    peak = _check_forward_peak(medium)
    orders = (
        0 if peak is None else math.ceil(math.log(NEGLIGIBLE_PROBABILITY) / math.log(peak.fraction))
    )
    peak_directions = np.zeros((1 + orders, 3))
    return Detectors(
        directions,
        plane,
        transmission,
        reflection,
        bool(has_lower_side),
        sums,
        peak,
        peak_directions,
    )


def _check_forward_peak(medium: ParticleMedium) -> PhaseFunctionPeak | None:
    """Return the narrow peak of the phase function, which must not hold nearly all light."""
    peak = separate_peak(medium.kernel_phase_function)
    if peak is not None and peak.fraction > MAX_PEAK_FRACTION:
        raise invalid(
            "estimator", "next_event", "expansion or bins for this phase_function",
            f"more than {MAX_PEAK_FRACTION:.0%} of the scattered light goes into a narrow peak",
        )  # fmt: skip
    return peak


def estimate_at_detectors(
    medium: Medium,
    incidence_deg: float,
    polar: np.ndarray,
    azimuth: np.ndarray,
    stopping_rule: StoppingRule,
    runner: Runner,
) -> DetectorResult:
    """Trace rays until every direction has the requested relative error, or a number of rays.

    Parameters
    ----------
    medium : ParticleMedium
    incidence_deg : float
    polar, azimuth : float
        Degrees, see `make_detectors`.
    stopping_rule : StoppingRule
    runner : Runner
        For its seed, its threads and its progress callback.

    Raises
    ------
    ValueError
        For grains, for a rough surface, and for a phase function that is nearly all peak.
    """
    if not isinstance(medium, ParticleMedium):
        raise invalid("estimator", "next_event", "expansion or bins for grains and stacks")
    if medium.make_height_fields() is not None:
        raise invalid(
            "estimator", "next_event", "expansion or bins under a rough surface",
            "no single path leads through it to a given direction; bins have Stokes parameters",
        )  # fmt: skip
    source = Source(float(np.cos(np.radians(incidence_deg))), 0.0)
    layer = medium.make_scattering_layer(False)
    stokes = UNPOLARIZED if medium.polarized else None
    scene = LayerScene(source, layer, medium.kernel_phase_function, None, stokes)
    detectors = make_detectors(medium, polar, azimuth)
    if stopping_rule.side == 1 and not detectors.has_lower_side:
        raise invalid(
            "target",
            "btdf",
            "brdf with estimator = next_event",
            "the layer has no open lower boundary",
        )
    tally = _DetectorTally(detectors.sums.shape)
    start_time = time.perf_counter()

    def trace_batch(batch: int) -> np.ndarray:
        scores, hemispherical = np.zeros_like(detectors.sums), np.zeros((2, 2))
        batch_detectors = detectors._replace(
            sums=scores, peak_directions=np.zeros_like(detectors.peak_directions)
        )
        work = np.array(
            [random_streams.NEXT_EVENT, batch * RAYS_PER_CHUNK, RAYS_PER_CHUNK, NO_MAX_ORDER]
        )
        kernels.trace_to_detectors(runner.seed, work, scene, batch_detectors, hemispherical)
        return np.concatenate([scores.ravel(), hemispherical.ravel()]) / RAYS_PER_CHUNK

    # For forward-peaked phase functions few events dominate the estimate, so the pilot is longer.
    g = abs(medium.kernel_phase_function.g)
    pilot_batches = int(PILOT_BATCHES * np.clip((1.0 + g) / (1.0 - g) ** 2 / 64.0, 1.0, 64.0))
    target_batches = (
        pilot_batches
        if stopping_rule.n_rays is None
        else max(2, -(-stopping_rule.n_rays // RAYS_PER_CHUNK))
    )
    max_batches = (
        max(2, stopping_rule.max_rays // RAYS_PER_CHUNK)
        if stopping_rule.n_rays is None
        else target_batches
    )
    no_signal = not (layer.albedo > 0.0 and layer.extinction > 0.0) and layer.bottom_albedo <= 0.0
    with DaemonThreadPool(runner.threads) as pool:
        while True:
            while tally.n_batches < target_batches:
                for score in pool.map(
                    trace_batch,
                    range(
                        tally.n_batches, min(target_batches, tally.n_batches + MAX_PENDING_BATCHES)
                    ),
                ):
                    tally.add_batch(score)
            lossless = not runner.tracer.traits.extra_absorption and layer.bottom_albedo == 1.0
            result = tally.compute_result(
                detectors.has_lower_side, medium.polarized, no_signal, lossless
            )
            error = result.compute_max_error(stopping_rule.side)
            is_empty = not no_signal and not result.mean[stopping_rule.side].any()
            converged = (
                stopping_rule.n_rays is None
                and error <= stopping_rule.relative_stderr
                and not is_empty
            )
            if (
                converged
                or tally.n_batches >= max_batches
                or (is_empty and tally.n_batches >= 64 * pilot_batches)
            ):
                return replace(result, stop_reason="converged" if converged else "max_rays")
            factor = (
                _MAX_ROUND_GROWTH
                if is_empty
                else 1.05 * (error / stopping_rule.relative_stderr) ** 2
            )
            needed_batches = tally.n_batches * factor
            target_batches = int(
                min(
                    max(needed_batches, tally.n_batches + 1),
                    _MAX_ROUND_GROWTH * tally.n_batches,
                    max_batches,
                )
            )
            if runner.progress_callback:
                seconds = time.perf_counter() - start_time
                seconds_left = seconds * (needed_batches / tally.n_batches - 1.0)
                progress = Progress(
                    target_batches * RAYS_PER_CHUNK,
                    error,
                    stopping_rule.relative_stderr,
                    seconds,
                    seconds_left,
                )
                runner.progress_callback(progress)


class _DetectorTally:
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
