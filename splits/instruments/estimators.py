"""Two ways to a spectrum: all wavelengths from shared paths, or each by itself.

Both run until the standard error asked for is reached at every wavelength, or the ray limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splits.instruments.ensemble import Ensemble, Runner
from splits.instruments.nodes import choose_nodes
from splits.materials.refractive_index import absorption_coefficient
from splits.media.granular import GranularMedium
from splits.transport.scene import Optics

PILOT = 1024
ANALOG_PILOT = 2048
"""Rays per ensemble of the first round, from which the number needed is foretold.  Stopping on
the variance of the very rays that form the mean draws dark values down; a first round that is
large against the few events seen there keeps this far below the standard error."""
_GROWTH = 8.0
_BIAS_SHARE = 0.4
"""Part of the error asked for that interpolation between indices may take."""
_ANALOG_STREAMS = 1_000_000
"""First ensemble number of the analog estimator: with one seed, both draw different numbers."""


@dataclass(frozen=True)
class Estimate:
    """Means and standard errors, shape (3, wavelengths): reflected, transmitted, absorbed.

    Attributes
    ----------
    bias : float, shape (3, wavelengths)
        Part of the standard error that stands for interpolation between refractive indices.
    rays : int
        All rays traced.
    ensembles : int
        Number of path ensembles among which they are shared.
    converged : bool
        Whether the error asked for was reached everywhere.
    """

    mean: np.ndarray
    stderr: np.ndarray
    bias: np.ndarray
    rays: int
    ensembles: int
    converged: bool


def spectral(
    runner: Runner,
    medium: GranularMedium,
    wavelength_nm: np.ndarray,
    max_stderr: float,
    max_rays: int,
) -> Estimate:
    """Estimate all wavelengths from path ensembles at a few refractive indices.

    The lengths of a path in each material give its weight at every wavelength (SPLITSnow Eqs
    5-6); wavelengths take the weighted mean of the index nodes around them, and the bound on what
    this interpolation misses is added to the standard error in quadrature.
    """
    index = medium.indices(wavelength_nm)
    absorption = absorption_coefficient(index, wavelength_nm[:, np.newaxis])
    share = (1.0 - medium.saturation, medium.saturation)
    nodes = choose_nodes(index, share, _BIAS_SHARE * max_stderr)
    ensembles = []
    for number, (m, weights) in enumerate(zip(nodes.index, nodes.weights, strict=True)):
        # Roulette may only use what holds for every wavelength that draws on this ensemble.
        least = absorption[weights > 0.0].min(axis=0)
        optics = Optics(m.real.copy(), m.imag.copy(), least)
        ensembles.append(Ensemble(number, optics, absorption))
    weights = nodes.weights[:, np.newaxis, :]

    runner.trace([(e, PILOT) for e in ensembles], 1.0, max_stderr)
    while True:
        rays = np.array([e.rays for e in ensembles])
        mean = np.einsum("jw,jqw->qw", nodes.weights, np.stack([e.means() for e in ensembles]))
        mean = np.concatenate([mean, 1.0 - mean.sum(axis=0, keepdims=True)])
        # A share f can bend no more than f(1 − f) allows: near 0 and 1 the bound shrinks with it.
        bias = nodes.bias * np.clip(4.0 * mean * (1.0 - mean), 0.0, 1.0)
        parts = weights**2 * np.stack([e.variances() for e in ensembles])
        variance = (parts / rays[:, np.newaxis, np.newaxis]).sum(axis=0)
        stderr = np.sqrt(variance + bias**2)
        converged = bool(stderr.max() <= max_stderr)
        if converged or rays.sum() >= max_rays:
            break
        wanted = _rays_wanted(parts, rays, max_stderr**2 - bias**2)
        step = np.minimum(wanted - rays, (_GROWTH - 1.0) * rays)
        step *= min(1.0, (max_rays - rays.sum()) / step.sum())
        left = float((wanted - rays - step).clip(0).sum())
        work = [(e, int(np.ceil(s))) for e, s in zip(ensembles, step, strict=True) if s > 0.0]
        runner.trace(work, float(stderr.max()), max_stderr, left)
    return Estimate(mean, stderr, bias, int(rays.sum()), len(ensembles), converged)


def _rays_wanted(parts: np.ndarray, rays: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the rays per ensemble that bring every variance down to its target.

    For one wavelength the cheapest split is proportional to the root of each ensemble's part of
    the variance, rays_j = √part_j · Σ√part / target; the largest over wavelengths is taken, and
    then all ensembles are scaled back together as far as every wavelength allows.

    Parameters
    ----------
    parts : float, shape (ensembles, quantities, wavelengths)
        Variance per ray times squared weight.
    rays : int, shape (ensembles,)
    target : float, shape (quantities, wavelengths)
        Variances to reach.
    """
    root = np.sqrt(parts)
    wanted = np.maximum((root * root.sum(axis=0) / target).max(axis=(1, 2)), rays)
    excess = ((parts / wanted[:, np.newaxis, np.newaxis]).sum(axis=0) / target).max()
    return np.maximum(np.ceil(1.05 * wanted * max(excess, 0.25)), rays + 1)


def analog(
    runner: Runner,
    medium: GranularMedium,
    wavelength_nm: np.ndarray,
    max_stderr: float,
    max_rays: int,
) -> Estimate:
    """Estimate each wavelength by itself, with absorption decided by coin toss on every leg.

    This is the algorithm of SPLITS section 4.3 and SPLITSnow section 3, kept as the reference.
    `max_rays` is shared equally among the wavelengths.
    """
    index = medium.indices(wavelength_nm)
    absorption = absorption_coefficient(index, wavelength_nm[:, np.newaxis])
    limit = max(ANALOG_PILOT, max_rays // len(wavelength_nm))
    mean = np.empty((3, len(wavelength_nm)))
    stderr = np.empty_like(mean)
    rays = 0
    for number, (m, alpha) in enumerate(zip(index, absorption, strict=True), start=_ANALOG_STREAMS):
        optics = Optics(m.real.copy(), m.imag.copy(), alpha)
        ensemble = Ensemble(number, optics, alpha[np.newaxis], analog=True)
        runner.trace([(ensemble, ANALOG_PILOT)], 1.0, max_stderr)
        while True:
            variance = ensemble.variances()[:, 0]
            error = np.sqrt(variance / ensemble.rays)
            if error.max() <= max_stderr or ensemble.rays >= limit:
                break
            wanted = 1.05 * variance.max() / max_stderr**2
            step = min(wanted, _GROWTH * ensemble.rays, limit) - ensemble.rays
            runner.trace([(ensemble, int(np.ceil(step)))], float(error.max()), max_stderr)
        reflected, transmitted = ensemble.means()[:, 0]
        row = number - _ANALOG_STREAMS
        mean[:, row] = reflected, transmitted, 1.0 - reflected - transmitted
        stderr[:, row] = error
        rays += ensemble.rays
    return Estimate(
        mean,
        stderr,
        np.zeros_like(mean),
        rays,
        len(wavelength_nm),
        bool(stderr.max() <= max_stderr),
    )


ESTIMATORS = {"spectral": spectral, "analog": analog}
