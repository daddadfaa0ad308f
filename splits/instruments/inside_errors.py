"""What errors of the light inside hold besides the scatter of groups of rays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.instruments.nodes import SLOPE
from splits.instruments.planes import Planes
from splits.media.granular import GranularMedium, LayeredMedium
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
    """In what steps weights fall inside a medium, each of shape (intervals, wavelengths).

    Attributes
    ----------
    depth : float
        Largest optical depth of a mean step: through a grain, or through a pore from one grain to
        the next.
    reach : float
        Mean leg before a ray's first step (m), times the part of its light that stays there.
    rate : float
        Light that steps keep, as a part of it and per metre of path.
    """

    depth: np.ndarray
    reach: np.ndarray
    rate: np.ndarray


def steps_of(
    medium: GranularMedium | LayeredMedium, absorption: np.ndarray, planes: np.ndarray
) -> Steps:
    """Return the steps in which weights fall inside a medium.

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
    absorption : float, shape (wavelengths, columns)
        1/m; see `splits.instruments.scenes.Constants`.
    planes : float, shape (intervals + 1,)
        Depths between which intervals lie (m).
    """
    first, top = 0, 0.0
    found: list[list[Steps]] = [[] for _ in planes[1:]]
    for part in medium.parts if isinstance(medium, LayeredMedium) else (medium,):
        last, bottom = first + len(part.materials()), top + float(part.depth_m)
        here = _steps_of_grains(part, absorption[:, first:last])
        for inside, begin, end in zip(found, planes[:-1], planes[1:], strict=True):
            if begin < bottom and end > top:
                inside.append(here)
        first, top = last, bottom
    return Steps(
        np.array([np.max([s.depth for s in inside], axis=0) for inside in found]),
        np.array([np.max([s.reach for s in inside], axis=0) for inside in found]),
        np.array([np.min([s.rate for s in inside], axis=0) for inside in found]),
    )


def _steps_of_grains(medium: GranularMedium, absorption: np.ndarray) -> Steps:
    """Return the steps in a layer of grains, one value per wavelength.

    The mean chord of convex grains is their volume over their projected area; the mean leg between
    two of them is that of a ray in the pore space.  Of a coating a ray crosses some three
    thicknesses on its way in and out; of a sphere the chord is two thirds of the diameter.
    """
    grains, types = medium.grains(), medium.grains().types
    leg = 1.0 / grains.attenuation
    packed = getattr(medium.readings, "attenuation", "solid") == "solid"
    chord = medium.mean_grain_distance_m * (1.0 - medium.porosity if packed else 1.0)
    shares = np.diff(grains.share, prepend=0.0)
    depths, of_all = [], []
    for kind in np.flatnonzero(shares > 0.0):
        coats = types.shells[kind] - 1
        film = absorption[:, types.material[kind, :coats]] @ types.thickness[kind, :coats]
        core = absorption[:, types.material[kind, coats]]
        depths.append(chord * (core + 4.5 * film))
        of_all.append(shares[kind])
    filled = [1.0 - medium.wet_share - sum(medium.pores.values()), medium.wet_share]
    for pore, share in enumerate([*filled, *medium.pores.values()]):
        if share > 0.0:
            depths.append(leg * absorption[:, pore])
            of_all.append(share)
    kept = np.array(of_all) @ -np.expm1(-np.array(depths))
    return Steps(np.max(depths, axis=0), leg * np.minimum(kept, 1.0), kept / leg)


def _stretched(depth: np.ndarray) -> np.ndarray:
    """Return by which part of itself a path may be longer than if weights fell evenly along it."""
    d = np.maximum(depth, 1e-9)
    more: np.ndarray = d / -np.expm1(-d) - 1.0
    return more


def flux_missed(
    steps: Steps, flux: np.ndarray, absorbed: np.ndarray, arriving: np.ndarray
) -> np.ndarray:
    """Return what the mean path over thickness may miss, shape (intervals, wavelengths).

    Between two planes weights are taken to fall evenly along the path.  They fall in steps, of
    optical depth d, so that a path by weight may be d/(1 − exp(−d)) times as long.  Where steps are
    so large that a ray ends in its first one, nobody hears of the leg that it came.  Where that is
    much, what is absorbed in the interval, which is known without paths, says about how long they
    are: twice the difference, and a tenth, are then less.

    Parameters
    ----------
    steps : Steps
    flux : float, shape (intervals, wavelengths)
    absorbed, arriving : float, shape (intervals, wavelengths)
        Light absorbed in an interval, and light that comes to it through its planes, over its
        thickness (1/m).
    """
    most = _stretched(steps.depth) * flux + steps.reach * arriving
    kept = np.maximum(absorbed, 0.0)
    path = np.divide(kept, steps.rate, out=np.full_like(flux, np.inf), where=steps.rate > 0.0)
    missed: np.ndarray = np.minimum(most, 2.0 * np.abs(path - flux) + 0.1 * flux)
    return missed


def share_missed(
    steps: Steps, share: np.ndarray, whole: np.ndarray, unheard: np.ndarray
) -> np.ndarray:
    """Return how far a material's absorbed share of an interval's may be off.

    By what steps do to a path (see `flux_missed`), and never by more than there is; what one
    material has too much of, the others have too little.

    Parameters
    ----------
    steps : Steps
    share : float, shape (intervals, materials, wavelengths)
        What the material absorbs.
    whole, unheard : float, shape (intervals, wavelengths)
        What all of them absorb, and how much of that no path tells of.
    """
    whole, unheard = whole[:, np.newaxis], unheard[:, np.newaxis]
    moved = np.minimum(share, np.maximum(whole - share, 0.0))
    off = _stretched(steps.depth)[:, np.newaxis] * moved + unheard
    missed: np.ndarray = np.minimum(off, np.maximum(whole, 0.0))
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
