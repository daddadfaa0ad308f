"""Bounds on what a ray is worth, for light that gets deep (see `splits.transport.grains.deep`)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.transport.compiling.jit import part


class Window(NamedTuple):
    """Bounds on what a ray is worth, weight · exp(κ·depth) (see `splits.transport.grains.deep`).

    Attributes
    ----------
    weight : float
        Of the ray, absorption not counted.
    kappa : float
        1/m.
    lower, upper : float
    profile : float64[2, slices]
        For equal slices of the depth, number and total weight of the legs that began there,
        advanced in place.
    """

    weight: float
    kappa: float
    lower: float
    upper: float
    profile: np.ndarray


@part
def height(ray, layers):
    """Return the height at which a ray stands (m)."""
    bottom = layers.boundaries[layers.boundaries.size - 1]
    return min(max(ray.geometry.position.z + ray.geometry.exit_offset.z, bottom), 0.0)


@part
def worth_of(ray, layers, weight, kappa):
    """Return what a ray can be expected to contribute, see `Window`."""
    return weight * math.exp(-ray.payload.roulette.optical_depth - kappa * height(ray, layers))


@part
def left_window(window, ray, layers):
    """Tell whether a ray's worth lies outside its window, and note where it is."""
    bottom = layers.boundaries[layers.boundaries.size - 1]
    slices = window.profile.shape[1]
    place = min(int(height(ray, layers) / bottom * slices), slices - 1)
    window.profile[0, place] += 1.0
    window.profile[1, place] += window.weight * math.exp(-ray.payload.roulette.optical_depth)
    worth = worth_of(ray, layers, window.weight, window.kappa)
    return worth < window.lower or worth > window.upper
