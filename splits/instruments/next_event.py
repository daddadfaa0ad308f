"""Next-event estimation: every scattering contributes to each view direction.

Budak & Grimailo 2020, Eqs 4-5 (local estimation): the radiance on a circle above the layer,
without collectors of finite size.  Errors come from the scatter of batches of rays.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from splits.core.progress import Progress
from splits.core.validation import invalid
from splits.instruments.detector_tally import DetectorResult, DetectorTally
from splits.kernels.grains.scene import NO_MAX_ORDER, Optics, Scene, make_bounding_optics
from splits.kernels.optics.forward_peak import separate_peak
from splits.kernels.optics.polarized_interface import compute_fresnel_mueller
from splits.kernels.transport.history import trace_to_detectors
from splits.kernels.transport.next_event import Detectors
from splits.media.medium import LayeredMedium, Medium, ParticleMedium
from splits.simulation import random_streams
from splits.simulation.runner import RAYS_PER_CHUNK, Runner
from splits.simulation.scene import get_reflecting_ground
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

    def count_batches(self, pilot_batches: int) -> tuple[int, int]:
        """Return the numbers of batches of the first round and of the whole run at most."""
        if self.n_rays is None:
            return pilot_batches, max(2, self.max_rays // RAYS_PER_CHUNK)
        n_batches = max(2, -(-self.n_rays // RAYS_PER_CHUNK))
        return n_batches, n_batches


def get_detected_layers(medium: Medium) -> tuple[ParticleMedium, ...]:
    """Return the particle layers of a medium whose light reaches detectors along a single path.

    Raises
    ------
    ValueError
        For grains, for a rough surface, for layers of different refractive indices or with narrow
        phase functions in a stack, and for a phase function that is nearly all peak.
    """
    layers: Any = medium.scene_layers if isinstance(medium, LayeredMedium) else (medium,)
    allowed = "expansion or bins"
    if not all(isinstance(layer, ParticleMedium) for layer in layers):
        raise invalid("estimator", "next_event", f"{allowed} for grains")
    if layers[0].make_height_fields() is not None:
        raise invalid(
            "estimator", "next_event", f"{allowed} under a rough surface",
            "no single path leads through it to a given direction; bins have Stokes parameters",
        )  # fmt: skip
    peaks = [separate_peak(layer.kernel_phase_function) for layer in layers]
    if any(peak is not None and peak.fraction > MAX_PEAK_FRACTION for peak in peaks):
        raise invalid(
            "estimator", "next_event", f"{allowed} for this phase_function",
            f"more than {MAX_PEAK_FRACTION:.0%} of the scattered light goes into a narrow peak",
        )  # fmt: skip
    if len(layers) > 1:
        if len({layer.refractive_index for layer in layers}) > 1:
            raise invalid("estimator", "next_event", f"{allowed} for layers of different indices")
        if any(peak is not None for peak in peaks):
            hint = "narrow peaks require a single layer"
            raise invalid("estimator", "next_event", f"{allowed} for this phase_function", hint)
        if get_reflecting_ground(medium) is not None:
            raise invalid("estimator", "next_event", f"{allowed} over the ground of a stack")
    return tuple(layers)


def make_detectors(
    layers: Sequence[ParticleMedium], scene: Scene, polar: np.ndarray, azimuth: np.ndarray
) -> Detectors:
    """Return detectors on a grid of directions, azimuth running fastest.

    Parameters
    ----------
    layers : sequence of ParticleMedium
        See `get_detected_layers`.
    scene : Scene
    polar, azimuth : float
        Degrees, of the directions outside.
    """
    n, lowest = layers[0].refractive_index, layers[-1]
    outer_polar, azimuth_rad = np.radians(np.meshgrid(polar, azimuth, indexing="ij")).reshape(2, -1)
    sine = np.sin(outer_polar) / n
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    interfaces = [compute_fresnel_mueller(n, 1.0, c) for c in cosine]
    reflection = np.array([interface.reflection for interface in interfaces])
    transmission = np.array([interface.transmission for interface in interfaces])
    if scene.stokes is None:
        reflection = reflection * [1.0, 0.0, 0.0, 0.0]
        transmission = transmission * [1.0, 0.0, 0.0]
    thickness = float((-np.diff(scene.layers.boundaries)) @ scene.layers.collision_coefficient)
    is_open = scene.bottom_albedo is None and scene.opaque is None
    peak = separate_peak(lowest.kernel_phase_function)
    orders = 0 if peak is None else math.log(NEGLIGIBLE_PROBABILITY) / math.log(peak.fraction)
    return Detectors(
        np.stack([sine * np.cos(azimuth_rad), sine * np.sin(azimuth_rad), cosine], axis=1),
        np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=1),
        # dΩ inside/dΩ outside = cosθ/(n² cosθ'); a BRDF is per outer cosine.
        transmission / (n**2 * cosine[:, np.newaxis]),
        reflection,
        n,
        thickness,
        is_open and math.isfinite(thickness),
        np.zeros((2, len(cosine), 4)),
        lowest.kernel_phase_function,
        peak,
        0.0 if peak is None else peak.fraction * lowest.single_scattering_albedo,
        np.zeros((1 + math.ceil(orders), 3)),
    )


def estimate_at_detectors(
    medium: Medium,
    polar: np.ndarray,
    azimuth: np.ndarray,
    stopping_rule: StoppingRule,
    runner: Runner,
) -> DetectorResult:
    """Trace rays until every direction has the requested relative error, or a number of rays.

    Parameters
    ----------
    medium : Medium
        See `get_detected_layers`.
    polar, azimuth : float
        Degrees, see `make_detectors`.
    stopping_rule : StoppingRule
    runner : Runner
        For its seed, its threads and its progress callback.

    Raises
    ------
    ValueError
        See `get_detected_layers`.
    """
    layers = get_detected_layers(medium)
    detectors = make_detectors(layers, runner.tracer.scene, polar, azimuth)
    if stopping_rule.side == 1 and not detectors.has_lower_side:
        allowed = "brdf with estimator = next_event"
        raise invalid("target", "btdf", allowed, "the lower boundary is not open")
    index = medium.compute_refractive_indices(np.zeros(1))
    optics = make_bounding_optics(index[0], np.zeros(index.shape))
    scene = runner.tracer.scene._replace(detectors=detectors)
    tracer = _DetectorTracer(runner.seed, scene, optics)
    return _trace_to_error(tracer, layers, stopping_rule, runner)


class _DetectorTracer(NamedTuple):
    """Tracer of batches of rays that contribute to detectors."""

    seed: int
    scene: Scene
    optics: Optics

    def trace_batch(self, batch: int) -> np.ndarray:
        """Return the mean contributions to detectors, and to hemispherical quantities."""
        detectors = self.scene.detectors
        scores, hemispherical = np.zeros_like(detectors.sums), np.zeros((2, 2))
        scene = self.scene._replace(
            detectors=detectors._replace(
                sums=scores, peak_directions=np.zeros_like(detectors.peak_directions)
            )
        )
        work = np.array(
            [random_streams.NEXT_EVENT, batch * RAYS_PER_CHUNK, RAYS_PER_CHUNK, NO_MAX_ORDER]
        )
        trace_to_detectors(self.seed, work, scene, self.optics, hemispherical)
        return np.concatenate([scores.ravel(), hemispherical.ravel()]) / RAYS_PER_CHUNK

    def trace_up_to(self, tally: DetectorTally, n_batches: int, pool: DaemonThreadPool) -> None:
        """Trace further batches up to a number and add them in order."""
        while tally.n_batches < n_batches:
            last = min(n_batches, tally.n_batches + MAX_PENDING_BATCHES)
            for score in pool.map(self.trace_batch, range(tally.n_batches, last)):
                tally.add_batch(score)


def _trace_to_error(
    tracer: _DetectorTracer,
    layers: Sequence[ParticleMedium],
    stopping_rule: StoppingRule,
    runner: Runner,
) -> DetectorResult:
    """Trace batches until the stopping rule is satisfied."""
    start_time = time.perf_counter()
    scene = tracer.scene
    detectors, bottom_albedo = scene.detectors, scene.bottom_albedo
    # For forward-peaked phase functions few events dominate the estimate, so the pilot is longer.
    g = max(abs(layer.kernel_phase_function.g) for layer in layers)
    pilot_batches = int(PILOT_BATCHES * np.clip((1.0 + g) / (1.0 - g) ** 2 / 64.0, 1.0, 64.0))
    to_error = stopping_rule.n_rays is None
    target_batches, max_batches = stopping_rule.count_batches(pilot_batches)
    scatters = any(one.single_scattering_albedo * one.extinction_per_m > 0.0 for one in layers)
    no_signal = scene.opaque is not None or not (scatters or bottom_albedo)
    lossless = not runner.tracer.traits.extra_absorption and bottom_albedo == 1.0
    is_polarized = scene.stokes is not None
    tally = DetectorTally(detectors.sums.shape)
    with DaemonThreadPool(runner.threads) as pool:
        while True:
            tracer.trace_up_to(tally, target_batches, pool)
            n_batches = tally.n_batches
            result = tally.compute_result(
                detectors.has_lower_side, is_polarized, no_signal, lossless
            )
            error = result.compute_max_error(stopping_rule.side)
            is_empty = not no_signal and not result.mean[stopping_rule.side].any()
            converged = to_error and error <= stopping_rule.relative_stderr and not is_empty
            exhausted = n_batches >= max_batches or (is_empty and n_batches >= 64 * pilot_batches)
            if converged or exhausted:
                return replace(result, stop_reason="converged" if converged else "max_rays")
            factor = 1.05 * (error / stopping_rule.relative_stderr) ** 2
            needed_batches = n_batches * (_MAX_ROUND_GROWTH if is_empty else factor)
            target_batches = int(
                min(max(needed_batches, n_batches + 1), _MAX_ROUND_GROWTH * n_batches, max_batches)
            )
            if runner.progress_callback:
                seconds = time.perf_counter() - start_time
                seconds_left = seconds * (needed_batches / n_batches - 1.0)
                n_rays = target_batches * RAYS_PER_CHUNK
                relative_stderr = stopping_rule.relative_stderr
                runner.progress_callback(
                    Progress(n_rays, error, relative_stderr, seconds, seconds_left)
                )
