"""What errors of the light inside hold besides the scatter of groups of rays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.instruments.nodes import SLOPE
from splits.instruments.planes import Planes
from splits.media.granular import GranularMedium, LayeredMedium
from splits.transport.scene import WET_PORE
from splits.uncertainty import stderr_of

FEW = 8
"""Groups of rays with light up to which an error allows for one ray more."""


class Doubt(NamedTuple):
    """What errors hold besides the scatter of groups, each of shape (wavelengths,).

    Attributes
    ----------
    bias : float
        See `missed`.
    least : float
        See `errors_of`.
    """

    bias: np.ndarray
    least: np.ndarray


class Steps(NamedTuple):
    """In what steps weights fall inside a medium, each of shape (wavelengths,).

    Attributes
    ----------
    depth : float
        Largest optical depth of a mean step: through a grain, or through a pore from one to the
        next.
    reach : float
        Mean leg before a ray's first step (m), times the part of its light that stays there.
    """

    depth: np.ndarray
    reach: np.ndarray


def steps_of(medium: GranularMedium | LayeredMedium, absorption: np.ndarray) -> Steps:
    """Return the steps in which weights fall inside a medium.

    The mean chord of convex grains is their volume over their projected area; the mean leg between
    two of them is that of a ray in the pore space.

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
    absorption : float, shape (wavelengths, columns)
        1/m; see `splits.instruments.scenes.Constants`.
    """
    depth, reach = np.zeros((2, len(absorption)))
    first = 0
    for part in medium.parts if isinstance(medium, LayeredMedium) else (medium,):
        last = first + len(part.materials())
        leg = 1.0 / part.grains().attenuation
        packed = getattr(part.readings, "attenuation", "solid") == "solid"
        chord = leg * (1.0 - part.porosity) if packed else leg
        pores = WET_PORE + 1 + len(part.pores)
        used = np.ones(last - first, dtype=bool)
        used[WET_PORE] = part.saturation > 0.0
        length = np.where(np.arange(last - first) < pores, leg, chord) * used
        here = (absorption[:, first:last] * length).max(axis=1)
        depth = np.maximum(depth, here)
        reach = np.maximum(reach, -np.expm1(-here) * leg)
        first = last
    return Steps(depth, reach)


def flux_missed(steps: Steps, flux: np.ndarray, arriving: np.ndarray) -> np.ndarray:
    """Return what the mean path over thickness may miss, shape (..., wavelengths).

    Between two planes weights are taken to fall evenly along the path.  They fall in steps, of
    optical depth d, so that a path by weight may be d/(1 − exp(−d)) times as long.  Where steps are
    so large that a ray ends in its first one, nobody hears of the leg that it came.

    Parameters
    ----------
    steps : Steps
    flux : float, shape (..., wavelengths)
    arriving : float, shape (..., wavelengths)
        Light that comes to an interval through its planes, over the interval's thickness (1/m).
    """
    d = np.maximum(steps.depth, 1e-9)
    missed: np.ndarray = (d / -np.expm1(-d) - 1.0) * flux + steps.reach * arriving
    return missed


def share_missed(steps: Steps, share: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Return how far a material's absorbed share of an interval's may be off.

    By what steps do to a path (see `flux_missed`), and never by more than there is; what one
    material has too much of, the others have too little.

    Parameters
    ----------
    steps : Steps
    share, whole : float, shape (..., wavelengths)
        What the material, and what all of them absorb.
    """
    d = np.maximum(steps.depth, 1e-9)
    moved = np.minimum(share, np.maximum(whole - share, 0.0))
    missed: np.ndarray = np.minimum((d / -np.expm1(-d) - 1.0) * moved, whole)
    return missed


def errors_of(groups: np.ndarray, bias: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Return standard errors of means of groups.

    Nothing seen is not certainty: what fewer than `FEW` groups have seen may be off by one ray.

    Parameters
    ----------
    groups : float, shape (GROUPS, ..., wavelengths)
    bias : float, shape (wavelengths,)
        See `missed`.
    least : float, shape (wavelengths,)
        What one ray more would add to a mean, or that much and a factor.
    """
    seen = (groups != 0.0).sum(axis=0)
    unseen = np.where(seen < FEW, least, 0.0)
    error: np.ndarray = np.sqrt(
        stderr_of(groups) ** 2 + missed(bias, groups.mean(axis=0)) ** 2 + unseen**2
    )
    return error


def missed(bias: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return what interpolation between refractive indices may miss of irradiances and the like.

    As of a reflectance (`splits.instruments.nodes`), with the elasticity |ln f| of what decays
    exponentially with depth, where that is more.

    Parameters
    ----------
    bias : float, shape (wavelengths,)
    value : float, shape (..., wavelengths)
        What may be missed of.
    """
    size = np.clip(np.abs(value), np.finfo(float).tiny, None)
    elastic = size * np.maximum(8.0, np.abs(np.log(size)) / SLOPE)
    bound: np.ndarray = bias * np.minimum(np.maximum(1.0, size), elastic)
    return bound


def one_ray(ensembles: Sequence[Planes], weights: np.ndarray) -> np.ndarray:
    """Return what one ray more would add to the mean at every wavelength, shape (wavelengths,)."""
    counts = np.stack([np.maximum(one.count, 1.0) for one in ensembles])
    added: np.ndarray = (weights / counts).max(axis=0)
    return added
