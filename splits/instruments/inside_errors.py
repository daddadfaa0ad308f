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
    coarse : float
        See `coarseness`.
    """

    bias: np.ndarray
    least: np.ndarray
    coarse: np.ndarray


def coarseness(medium: GranularMedium | LayeredMedium, absorption: np.ndarray) -> np.ndarray:
    """Return what paths by weight may miss, relative, shape (wavelengths,), 1 at most.

    Between two planes weights are taken to fall evenly along the path.  They fall in grains: with
    an optical depth d in each, the path by weight is too small by d/2 at most where d is small.
    The mean chord of convex grains is their volume over their projected area.

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
    absorption : float, shape (wavelengths, columns)
        1/m; see `splits.instruments.scenes.Constants`.
    """
    coarse = np.zeros(len(absorption))
    first = 0
    for part in medium.parts if isinstance(medium, LayeredMedium) else (medium,):
        last = first + len(part.materials())
        chord = (1.0 - part.porosity) / part.grains().attenuation
        solid = absorption[:, first + WET_PORE + 1 + len(part.pores) : last].max(axis=1)
        coarse = np.maximum(coarse, 0.5 * chord * solid)
        first = last
    bounded: np.ndarray = np.minimum(coarse, 1.0)
    return bounded


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
