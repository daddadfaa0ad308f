"""Local estimation: directions hear of every scattering under a smooth surface.

Budak & Grimailo 2020, Eqs 4-5: the radiance on a circle above the layer, without collectors of
finite size.  Errors come from the scatter of batches of rays.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from splits.checks import refuse
from splits.instruments.angular import Estimate
from splits.instruments.runner import BATCH, Progress, Runner
from splits.media.turbid import Medium, TurbidMedium
from splits.transport import layer
from splits.transport.layer import OPEN
from splits.transport.local import Detectors
from splits.transport.scene import UNLIMITED
from splits.transport.stokes import fresnel_amplitudes

_STREAMS = 6_000_000
"""First stream number: one seed gives other numbers here than in the other instruments."""
PILOT = 128
"""Batches of the first round."""
_GROWTH = 8.0
_LEAST = 1e-3
"""Part of the largest value below which relative errors are not asked for."""


@dataclass(frozen=True)
class Goal:
    """How far a run goes: to a relative error on one side, or to a number of rays."""

    side: int
    relative_stderr: float
    rays: int | None
    max_rays: int


@dataclass(frozen=True)
class Heard:
    """What detectors heard.

    Attributes
    ----------
    mean, stderr : float, shape (2, directions, 4)
        I, Q, U, V of the BRDF and the BTDF (1/sr) for unpolarized light.
    totals, totals_stderr : float, shape (2, 2)
        [reflected, transmitted][all light, light that met nothing but smooth faces].
    rays : int
    reached : str
        "error" or "rays".
    polarized : bool
    """

    mean: np.ndarray
    stderr: np.ndarray
    totals: np.ndarray
    totals_stderr: np.ndarray
    rays: int
    reached: str
    polarized: bool

    def estimate(self, wavelengths: int) -> Estimate:
        """Return BRDF and BTDF, the same at so many wavelengths."""
        sums = np.empty((4, 2, wavelengths))
        sums[0::2] = self.totals.T[:, :, np.newaxis]
        sums[1::2] = self.totals_stderr.T[:, :, np.newaxis]
        mean, stderr = (
            np.repeat(x[:, np.newaxis, :, 0], wavelengths, axis=1) for x in (self.mean, self.stderr)
        )
        return Estimate(mean, stderr, sums, np.zeros((2, wavelengths), dtype=int))

    def stokes(self, wavelengths: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return Q, U and V of BRDF and BTDF, each with its errors, by name."""
        return {
            f"{function}_{name}": (
                np.repeat(self.mean[np.newaxis, side, :, place], wavelengths, axis=0),
                np.repeat(self.stderr[np.newaxis, side, :, place], wavelengths, axis=0),
            )
            for side, function in enumerate(("brdf", "btdf"))
            for place, name in ((1, "q"), (2, "u"), (3, "v"))
        }


def detectors_at(medium: TurbidMedium, polar: np.ndarray, azimuth: np.ndarray) -> Detectors:
    """Return detectors on a grid of directions, azimuth running fastest.

    Parameters
    ----------
    medium : TurbidMedium
    polar, azimuth : float
        Degrees, of the directions outside.
    """
    scene = medium.turbid(1.0, False, False)
    outer, turn = np.radians(np.meshgrid(polar, azimuth, indexing="ij")).reshape(2, -1)
    sine = np.sin(outer) / scene.n
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    toward = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
    faces = np.array([fresnel_amplitudes(scene.n, 1.0, c) for c in cosine])
    returning, passing = faces[:, :4], faces[:, 4:7]
    if not medium.polarized:
        returning = returning * [1.0, 0.0, 0.0, 0.0]
        passing = passing * [1.0, 0.0, 0.0]
    # dΩ inside/dΩ outside = cosθ/(n² cosθ'); a BRDF is per outer cosine.
    passing = passing / (scene.n**2 * cosine[:, np.newaxis])
    below = scene.bottom == OPEN and np.isfinite(scene.depth)
    sums = np.zeros((2, len(toward), 4))
    plane = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return Detectors(toward, plane, passing, np.ascontiguousarray(returning), bool(below), sums)


def listen(
    medium: Medium,
    incidence_deg: float,
    polar: np.ndarray,
    azimuth: np.ndarray,
    goal: Goal,
    runner: Runner,
) -> Heard:
    """Trace rays until every direction has the relative error asked for, or so many.

    Parameters
    ----------
    medium : TurbidMedium
    incidence_deg : float
    polar, azimuth : float
        Degrees, see `detectors_at`.
    goal : Goal
    runner : Runner
        For its seed, its threads and its report.

    Raises
    ------
    ValueError
        For grains, and for a rough surface.
    """
    if not isinstance(medium, TurbidMedium):
        raise refuse("estimator", "local", "expansion or cells for grains")
    if medium.fields() is not None:
        raise refuse(
            "estimator", "local", "expansion or cells under a rough surface",
            "no single path leads from a scattering through it to a given direction",
        )  # fmt: skip
    scene = medium.turbid(float(np.cos(np.radians(incidence_deg))), False, False)
    detectors = detectors_at(medium, polar, azimuth)
    count = detectors.sums.size
    total, square = np.zeros((2, count + 4))
    seed, report, side = runner.seed, runner.report, goal.side
    begun = time.perf_counter()

    def hear(batch: int) -> np.ndarray:
        sums, totals = np.zeros_like(detectors.sums), np.zeros((2, 2))
        work = np.array([_STREAMS, batch * BATCH, BATCH, UNLIMITED])
        stokes = np.zeros(6) if medium.polarized else None
        heard = detectors._replace(sums=sums)
        layer.hear(seed, work, scene, medium.phase, stokes, heard, totals)
        return np.concatenate([sums.ravel(), totals.ravel()]) / BATCH

    batches = 0
    wanted = PILOT if goal.rays is None else max(2, -(-goal.rays // BATCH))
    most = max(2, goal.max_rays // BATCH) if goal.rays is None else wanted
    with ThreadPoolExecutor(runner.threads) as pool:
        while True:
            for sums in pool.map(hear, range(batches, wanted)):
                total += sums
                square += sums**2
            batches = wanted
            mean = total / batches
            variance = np.maximum(square / batches - mean**2, 0.0) / (batches - 1)
            (mean, totals), (stderr, of_totals) = (
                (x[:count].reshape(detectors.sums.shape), x[count:].reshape(2, 2))
                for x in (mean, np.sqrt(variance))
            )
            error = _relative(mean[side, :, 0], stderr[side, :, 0])
            done = goal.rays is None and error <= goal.relative_stderr
            if done or batches >= most:
                reached = "error" if done else "rays"
                rays = batches * BATCH
                return Heard(mean, stderr, totals, of_totals, rays, reached, medium.polarized)
            more = 1.05 * batches * (error / goal.relative_stderr) ** 2
            wanted = int(min(max(more, batches + 1), _GROWTH * batches, most))
            if report:
                spent = time.perf_counter() - begun
                left = spent * (more / batches - 1.0)
                report(Progress(wanted * BATCH, error, goal.relative_stderr, spent, left))


def _relative(mean: np.ndarray, stderr: np.ndarray) -> float:
    """Return the largest error relative to the value, or to a part of the largest value."""
    scale = np.maximum(mean, _LEAST * mean.max(initial=0.0))
    return float(np.divide(stderr, scale, out=np.zeros_like(scale), where=scale > 0.0).max())
