"""Packs so deep that paths in them have no end: a cut, and a ground that stands for what is below.

Where little is absorbed, light wanders through a deep pack for ten thousand grains, and comes back.
Far below the surface it is diffuse, and what the rest of the pack does with it is known from
diffusion theory: F↓ and F↑ are φ/4 ± J/2, and φ obeys D φ″ = μ φ (Ishimaru 1978, Wave Propagation
and Scattering in Random Media, chapter 9).  So rays are traced down to a cut only.  A ground there
sends back what the rest would, and keeps what that absorbs or lets through, at every wavelength.

What theory may miss is stated: `DOUBT` of what the rest keeps, times the chance that light from the
cut leaves at the top.  The cut lies so deep that this is a part of the error asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.checks import refuse
from splits.diffusion import Rest, diffuse_reflectance, scattering_mean_step
from splits.instruments.estimators import Estimate
from splits.instruments.grain_optics import BATCH, Plan, pooled_by_type, roughly
from splits.media.granular import GranularMedium, absorption_of
from splits.media.ground import Ground
from splits.media.particles import ParticleLayer
from splits.media.stack import Stack
from splits.media.turbid import Medium
from splits.transport.grains.scene import DRY_PORE, WET_PORE

DOUBT = 0.3
"""How far, as a part of itself, theory may be off in what the rest of a pack keeps."""
SHARE = 0.4
"""Part of the error asked for that the cut may take."""
LEAST = 600.0
"""Mean distances between grains below which no pack is cut: it is traced in no time."""
REACH = 5.0
"""Light that decays by more than exp(−REACH) down to the cut, at all wavelengths, asks for none."""
DIFFUSE = 30.0
"""Least depth of a cut in units of D, a third of the way on which light forgets its direction."""
CLEARLY = 2.0
"""How far beyond a limit a rough look has to be for no better one to be taken."""
LEAST_TURN = 0.01
"""Least 1 − ωg of grains among which light gets diffuse before it has gone far."""
RAYS = BATCH
"""To measure what each type of grain does: asymmetry to 2 %, far better than `DOUBT`."""
ROUGHLY = 256
"""To see roughly what they do, far better than `CLEARLY`; of rare dark grains too little is seen,
and then a better look is taken."""
ATTEMPTS = 3
"""Runs of a pack that is cut, each to half the error of the one before."""


class Cut(NamedTuple):
    """A pack that is cut.

    Attributes
    ----------
    medium : Medium
        Down to the cut, over a ground that stands for the rest.
    depth_m : float
        Of the cut (m).
    passed : float, shape (wavelengths,)
        Share that the rest lets through of what it keeps.
    clear : bool, shape (wavelengths,)
        Whether nothing absorbs, below the cut and above, and the ground below lets pass what is
        not sent back.
    escape : float, shape (wavelengths,)
        Chance that light from the cut leaves at the top.
    enough_m : float
        Depth from which on the lowest layer reflects diffuse light like one without end, within
        the error asked for, to diffusion theory (m).
    """

    medium: Medium
    depth_m: float
    passed: np.ndarray
    clear: np.ndarray
    escape: np.ndarray
    enough_m: float

    def reached(self, estimate: Callable[[float], Estimate], max_stderr: float) -> Estimate:
        """Return the estimate of the whole pack to an error.

        More may reach the cut than was foreseen, so that theory misses more there: then the part
        above it is measured again, to a smaller error.

        Parameters
        ----------
        estimate : callable
            Takes a largest error, returns the estimate of the part above the cut.
        max_stderr : float
        """
        goal = max_stderr * (1.0 - SHARE**2) ** 0.5
        for _ in range(ATTEMPTS):
            found = estimate(goal)
            result = self.completed(found, max_stderr)
            if result.converged or not found.converged:
                break
            goal *= 0.5
        return result

    def completed(self, found: Estimate, max_stderr: float) -> Estimate:
        """Return the estimate of the whole pack from that of the part above the cut."""
        kept = found.mean[1]
        back = np.minimum(found.mean[0], 1.0)
        clear = self.clear
        # Where nothing is absorbed, all that does not come back goes through, in error as in size.
        through = np.where(clear, 1.0 - back, np.minimum(kept * self.passed, 1.0 - back))
        mean = np.stack([back, through, 1.0 - back - through])
        doubt = DOUBT * kept * self.escape
        below = np.where(self.passed == 1.0, doubt, DOUBT * through)
        rest = np.where(clear, 0.0, np.hypot(doubt, below))
        missed = np.stack([doubt, below, rest])
        scale = np.stack([np.ones_like(kept), self.passed, np.ones_like(kept)])
        own = scale * found.stderr
        # Absorbed is what was so above the cut, and what the rest keeps for itself: all that is
        # neither reflected nor let through.
        own[2] = np.minimum(own[2] + (1.0 - self.passed) * found.stderr[1], own[0] + own[1])
        own[1], own[2] = np.where(clear, own[0], own[1]), np.where(clear, 0.0, own[2])
        stderr = np.hypot(own, missed)
        groups = found.groups * scale[:2]
        groups[:, 1] = np.where(clear, -groups[:, 0], groups[:, 1])
        bias = np.hypot(scale * found.bias, missed)
        converged = bool(stderr.max() <= max_stderr)
        return Estimate(
            mean, stderr, bias, groups, found.rays, found.ensembles, converged, found.kernel
        )


class _Diffusing(NamedTuple):
    """How light diffuses among grains, at every wavelength.

    Attributes
    ----------
    loss : float
        Share that a grain absorbs.
    turn : float
        1 − g, and the loss besides: 1 − ωg where little is lost.
    diffusion : float
        D (m).
    rate : float
        By which light decays on its way down (1/m).
    """

    loss: np.ndarray
    turn: np.ndarray
    diffusion: np.ndarray
    rate: np.ndarray

    @classmethod
    def of(cls, optics: xr.Dataset) -> _Diffusing:
        """Return it for grains that do this to light, see `pooled_by_type`."""
        step = scattering_mean_step(optics)
        loss = np.maximum(1.0 - optics.single_scattering_albedo.values, 0.0)
        turn = 1.0 - optics.asymmetry_parameter.values + loss
        diffusion = step / (3.0 * np.maximum(turn, np.finfo(float).tiny))
        return cls(loss, turn, diffusion, np.sqrt(loss / step / diffusion))

    def height(self, lowest: Any, max_stderr: float) -> float:
        """Return how far below the top of its layer a cut has to lie (m)."""
        # What the cut misses is at most DOUBT/4 of the light that reaches it, 4 D over its depth.
        needed = DOUBT / (SHARE * max_stderr)
        farthest = float(self.diffusion.max())
        return max(farthest * max(needed, DIFFUSE), 2.0 * lowest.largest_grain_m)

    def serves(self, lowest: Any, max_stderr: float, margin: float = 1.0) -> bool:
        """Return whether a layer that ends is worth a cut, or may be if this is off by a margin."""
        height = self.height(lowest, max_stderr)
        deep = lowest.depth_m * margin >= 4.0 * height
        return bool(
            self.turn.min() * margin >= LEAST_TURN
            and deep
            and (self.rate * height).min() <= REACH * margin
        )


def cut_of(
    medium: Medium, wavelengths: np.ndarray, max_stderr: float, seed: int, threads: int
) -> Cut | None:
    """Return a pack cut where that serves the error asked for, None where it is traced as it is.

    Raises
    ------
    ValueError
        For a pack without end whose lowest layer is not of grains.
    """
    part = medium.layers[-1] if isinstance(medium, Stack) else medium
    if not isinstance(part, GranularMedium):
        return None
    lowest: Any = part
    depth = float(lowest.depth_m)
    if depth * lowest.grains().attenuation < LEAST:
        return None
    if lowest.pores or "air" in lowest.refractive_index:
        # The rest of a pack is reckoned for pores of water and of air of index 1.
        if math.isinf(depth):
            raise refuse("depth_m", depth, "finite where pores hold other media or other air")
        return None
    finite: Any = replace(lowest, depth_m=1.0) if math.isinf(depth) else lowest
    plan = Plan(1, RAYS, seed, threads, "equilibrium")
    if not math.isinf(depth):
        look = _Diffusing.of(roughly(finite, wavelengths, plan._replace(rays=ROUGHLY)))
        if not look.serves(lowest, max_stderr, CLEARLY):
            return None
    optics = pooled_by_type(finite, wavelengths, plan)
    return _cut(medium, lowest, depth, optics, max_stderr)


def _cut(
    medium: Medium, lowest: Any, depth: float, optics: xr.Dataset, max_stderr: float
) -> Cut | None:
    """Return what `cut_of` returns, for a lowest layer of such optics and depth (m)."""
    found = _Diffusing.of(optics)
    endless = math.isinf(depth)
    if endless and found.turn.min() < LEAST_TURN:
        raise refuse("depth_m", depth, "finite", "these grains hardly turn light")
    if not endless and not found.serves(lowest, max_stderr):
        return None
    height, loss, diffusion = found.height(lowest, max_stderr), found.loss, found.diffusion
    # Where nothing is absorbed a rate of almost 0 says the same, without 0/0.
    rate = np.maximum(found.rate, 1e-9 / height)
    below = Ground.of(medium.ground)  # type: ignore[union-attr]
    albedo = np.zeros_like(rate) if below is None else below.albedo(optics.wavelength.values)
    rest = Rest(rate * diffusion, rate * (depth - height), 0.5 * (1.0 - albedo) / (1.0 + albedo))
    clear = loss <= 0.0
    sent = np.where(clear & (endless | (albedo == 1.0)), 1.0, rest.sent())
    passed = np.where(clear & (sent < 1.0), 1.0, rest.passed())
    arriving = 1.0 / (1.0 + 0.75 * height / (diffusion * 3.0))
    escape = arriving / (arriving + 1.0 - sent)
    ground = _ground(optics.wavelength.values, _through_face(sent, lowest, optics))
    shorter = replace(lowest, depth_m=height)
    if isinstance(medium, Stack):
        part: Medium = replace(medium, layers=(*medium.layers[:-1], shorter), ground=ground)
    else:
        part = replace(shorter, ground=ground)
    enough = _enough(rate, diffusion, max_stderr)
    dark_above = _absorbing_above(medium, optics.wavelength.values)
    return Cut(part, height, passed, (passed == 1.0) & ~dark_above, escape, enough)


def _absorbing_above(medium: Medium, wavelengths: np.ndarray) -> np.ndarray:
    """Tell at which wavelengths a layer above the lowest one may absorb."""
    if not isinstance(medium, Stack):
        return np.zeros(wavelengths.size, dtype=bool)
    above = len(medium.materials()) - len(medium.parts[-1].materials())
    absorption = absorption_of(medium, medium.indices(wavelengths), wavelengths)
    pale = [
        p.layer.single_scattering_albedo < 1.0 for p in medium.parts if isinstance(p, ParticleLayer)
    ]
    dark = (absorption[:, :above] > 0.0).any(axis=1)
    return np.asarray(dark | any(pale))


def _enough(rate: np.ndarray, diffusion: np.ndarray, max_stderr: float) -> float:
    """Return the least depth (m) over a black ground that is as bright as any."""
    depths = np.geomspace(1e-4, 1e4, 1601)[:, np.newaxis]
    black = np.full_like(rate, 0.5)
    shallow = Rest(rate * diffusion, rate * depths, black).sent()
    endless = Rest(rate * diffusion, np.full_like(rate, np.inf), black).sent()
    far = np.abs(endless - shallow).max(axis=1) > max_stderr
    return float(depths[min(far.sum(), len(depths) - 1), 0])


def _through_face(sent: np.ndarray, lowest: GranularMedium, optics: xr.Dataset) -> np.ndarray:
    """Return the albedo of a ground that, below the face of wet pores, sends back so much.

    A face keeps diffuse light of wet pores from leaving, more than it keeps that from outside from
    entering: by n², as reciprocity asks for.
    """
    if not lowest.saturation or not lowest.readings.rules(False).boundary_fresnel:
        return sent
    index = lowest.indices(optics.wavelength.values).real
    n = index[:, WET_PORE] / index[:, DRY_PORE]
    outer = diffuse_reflectance(n)
    inner = 1.0 - (1.0 - outer) / n**2
    wet = optics.wet_share.values
    out, back = 1.0 - wet * inner, 1.0 - float(lowest.saturation) * outer
    # What the ground keeps, in units of what reaches the face from within, is to be 1 − sent.
    kept = 1.0 - sent
    albedo: np.ndarray = np.clip((out - kept) / (out - kept * (1.0 - back)), 0.0, 1.0)
    return albedo


def _ground(wavelengths: np.ndarray, albedo: np.ndarray) -> Ground:
    """Return the ground that stands for the rest of a pack."""
    name = "rest of the pack"
    if wavelengths.size == 1:
        return Ground(name, "diffusion theory", albedo)
    return Ground(name, "diffusion theory", albedo, wavelengths)
