"""Local estimation: directions hear of every scattering under a smooth surface.

Budak & Grimailo 2020, Eqs 4-5: the radiance on a circle above the layer, without collectors of
finite size.  Errors come from the scatter of batches of rays.
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
"""Probability of more scatterings into a peak than there is room for."""
MAX_PEAK_FRACTION = 0.99
"""Of scattering into a peak: with more of it, light takes hundreds of scatterings to turn."""
MAX_PENDING_BATCHES = 4096
"""Batches that wait for a thread at most."""


@dataclass(frozen=True)
class StoppingRule:
    """How far a run goes: to a relative error on one side, or to a number of rays."""

    side: int
    relative_stderr: float
    n_rays: int | None
    max_rays: int


@dataclass(frozen=True)
class DetectorResult:
    """What detectors heard.

    Attributes
    ----------
    mean, stderr : float, shape (2, directions, 4)
        I, Q, U, V of the BRDF and the BTDF (1/sr) for unpolarized light.
    stopping_error : float, shape (2, directions)
        Errors of I by which runs are steered: larger, so that none stops on batches that happen
        to agree.
    hemispherical, hemispherical_stderr : float, shape (2, 2)
        [reflected, transmitted][all light, light that met nothing but smooth faces].
    n_rays : int
    stop_reason : str
        "converged" or "max_rays".
    polarized : bool
    has_lower_side : bool
        Whether there was something to hear below.
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
        """Return the largest error that steers, of one side, relative to `angular.reference`."""
        return compute_max_relative_error(
            self.to_angular_estimate(1), side, use_stopping_error=True
        )

    def to_angular_estimate(self, n_wavelengths: int) -> AngularEstimate:
        """Return BRDF and BTDF, the same at so many wavelengths."""
        sums = np.empty((4, 2, n_wavelengths))
        sums[0::2] = self.hemispherical.T[:, :, np.newaxis]
        sums[1::2] = self.hemispherical_stderr.T[:, :, np.newaxis]
        mean, stderr, steering = (
            np.repeat(x[:, np.newaxis], n_wavelengths, axis=1)
            for x in (self.mean[..., 0], self.stderr[..., 0], self.stopping_error)
        )
        degree = np.zeros((2, n_wavelengths), dtype=int)
        return AngularEstimate(mean, stderr, steering, sums, degree, np.zeros_like(mean))

    def to_stokes(self, n_wavelengths: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return Q, U and V of BRDF and BTDF, each with its errors, by name."""
        return {
            f"{function}_{name}": (
                np.repeat(self.mean[np.newaxis, side, :, place], n_wavelengths, axis=0),
                np.repeat(self.stderr[np.newaxis, side, :, place], n_wavelengths, axis=0),
            )
            for side, function in enumerate(("brdf", "btdf")[: 1 + self.has_lower_side])
            for place, name in ((1, "q"), (2, "u"), (3, "v"))
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
    outer, turn = np.radians(np.meshgrid(polar, azimuth, indexing="ij")).reshape(2, -1)
    sine = np.sin(outer) / layer.refractive_index
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    toward = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
    faces = [compute_fresnel_mueller(layer.refractive_index, 1.0, c) for c in cosine]
    returning = np.array([face.reflection for face in faces])
    passing = np.array([face.transmission for face in faces])
    if not medium.polarized:
        returning = returning * [1.0, 0.0, 0.0, 0.0]
        passing = passing * [1.0, 0.0, 0.0]
    # dΩ inside/dΩ outside = cosθ/(n² cosθ'); a BRDF is per outer cosine.
    passing = passing / (layer.refractive_index**2 * cosine[:, np.newaxis])
    below = layer.bottom_albedo == OPEN_BOTTOM and np.isfinite(layer.depth)
    sums = np.zeros((2, len(toward), 4))
    plane = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    peak = _check_forward_peak(medium)
    orders = (
        0 if peak is None else math.ceil(math.log(NEGLIGIBLE_PROBABILITY) / math.log(peak.fraction))
    )
    room = np.zeros((1 + orders, 3))
    return Detectors(toward, plane, passing, returning, bool(below), sums, peak, room)


def _check_forward_peak(medium: ParticleMedium) -> PhaseFunctionPeak | None:
    """Return the narrow peak of the phase function, or refuse one that holds nearly all light."""
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
    """Trace rays until every direction has the relative error asked for, or so many.

    Parameters
    ----------
    medium : ParticleMedium
    incidence_deg : float
    polar, azimuth : float
        Degrees, see `make_detectors`.
    stopping_rule : Goal
    runner : Runner
        For its seed, its threads and its report.

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
            "no single path leads through it to a given direction; cells have Stokes parameters",
        )  # fmt: skip
    light = Source(float(np.cos(np.radians(incidence_deg))), 0.0)
    layer = medium.make_scattering_layer(False)
    stokes = UNPOLARIZED if medium.polarized else None
    scene = LayerScene(light, layer, medium.kernel_phase_function, None, stokes)
    detectors = make_detectors(medium, polar, azimuth)
    if stopping_rule.side == 1 and not detectors.has_lower_side:
        raise invalid(
            "target", "btdf", "brdf with estimator = next_event", "the layer has no open lower face"
        )
    sums = _DetectorTally(detectors.sums.shape)
    begun = time.perf_counter()

    def hear(batch: int) -> np.ndarray:
        heard, totals = np.zeros_like(detectors.sums), np.zeros((2, 2))
        own = detectors._replace(
            sums=heard, peak_directions=np.zeros_like(detectors.peak_directions)
        )
        work = np.array(
            [random_streams.NEXT_EVENT, batch * RAYS_PER_CHUNK, RAYS_PER_CHUNK, NO_MAX_ORDER]
        )
        kernels.trace_to_detectors(runner.seed, work, scene, own, totals)
        return np.concatenate([heard.ravel(), totals.ravel()]) / RAYS_PER_CHUNK

    # Peaked phase functions speak rarely, and loudly.
    g = abs(medium.kernel_phase_function.g)
    pilot = int(PILOT_BATCHES * np.clip((1.0 + g) / (1.0 - g) ** 2 / 64.0, 1.0, 64.0))
    wanted = (
        pilot
        if stopping_rule.n_rays is None
        else max(2, -(-stopping_rule.n_rays // RAYS_PER_CHUNK))
    )
    most = (
        max(2, stopping_rule.max_rays // RAYS_PER_CHUNK) if stopping_rule.n_rays is None else wanted
    )
    silent = not (layer.albedo > 0.0 and layer.extinction > 0.0) and layer.bottom_albedo <= 0.0
    with DaemonThreadPool(runner.threads) as pool:
        while True:
            while sums.n_batches < wanted:
                for one in pool.map(
                    hear, range(sums.n_batches, min(wanted, sums.n_batches + MAX_PENDING_BATCHES))
                ):
                    sums.add_batch(one)
            certain = not runner.tracer.traits.extra_absorption and layer.bottom_albedo == 1.0
            result = sums.compute_result(
                detectors.has_lower_side, medium.polarized, silent, certain
            )
            error = result.compute_max_error(stopping_rule.side)
            nothing = not silent and not result.mean[stopping_rule.side].any()
            done = (
                stopping_rule.n_rays is None
                and error <= stopping_rule.relative_stderr
                and not nothing
            )
            if done or sums.n_batches >= most or (nothing and sums.n_batches >= 64 * pilot):
                return replace(result, stop_reason="converged" if done else "max_rays")
            factor = (
                _MAX_ROUND_GROWTH
                if nothing
                else 1.05 * (error / stopping_rule.relative_stderr) ** 2
            )
            more = sums.n_batches * factor
            wanted = int(
                min(max(more, sums.n_batches + 1), _MAX_ROUND_GROWTH * sums.n_batches, most)
            )
            if runner.progress_callback:
                spent = time.perf_counter() - begun
                left = spent * (more / sums.n_batches - 1.0)
                progress = Progress(
                    wanted * RAYS_PER_CHUNK, error, stopping_rule.relative_stderr, spent, left
                )
                runner.progress_callback(progress)


class _DetectorTally:
    """What batches heard, added up in their order.

    Attributes
    ----------
    n_batches : int
    sums, sums_of_squares, max_scores : float, shape (numbers,)
        Sums, sums of squares, and what the batch heard that heard most, of either sign.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape
        self.n_batches = 0
        self.sums, self.sums_of_squares, self.max_scores = np.zeros((3, int(np.prod(shape)) + 4))

    def add_batch(self, score: np.ndarray) -> None:
        """Add what one batch heard."""
        self.n_batches += 1
        self.sums += score
        self.sums_of_squares += score**2
        self.max_scores = np.where(np.abs(score) > np.abs(self.max_scores), score, self.max_scores)

    def compute_result(
        self, has_lower_side: bool, polarized: bool, no_signal: bool, lossless: bool
    ) -> DetectorResult:
        """Return means and standard errors.

        As if one more batch had come that heard as much as the loudest so far; and where nothing
        was heard, one ray, unless there is nothing to hear (`no_signal`), or nothing to go astray
        (`lossless`).
        """
        n, rays = self.n_batches, self.n_batches * RAYS_PER_CHUNK
        mean = self.sums / n
        square = (self.sums_of_squares + self.max_scores**2) / (n + 1)
        # The batch that is added belongs to the mean that scatter is about, but not to the answer.
        about = (self.sums + self.max_scores) / (n + 1)
        count = int(np.prod(self.shape))
        (heard, totals), (stderr, of_totals), (steering, _) = (
            (x[:count].reshape(self.shape), x[count:].reshape(2, 2))
            for x in (mean, *(np.sqrt(np.maximum(square - m**2, 0.0) / n) for m in (about, mean)))
        )
        for side in range(1 + has_lower_side) if not no_signal else ():
            unheard = heard[side, :, 0] == 0.0
            stderr[side, unheard, 0] = steering[side, unheard, 0] = 1.0 / (np.pi * rays)
        if not lossless:
            of_totals = np.maximum(of_totals, 1.0 / rays)
        return DetectorResult(
            heard, stderr, steering[..., 0], totals, of_totals, rays, "", polarized, has_lower_side
        )
