"""Weight windows for splitting, see `splits.kernels.grains.splitting`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import inline_only


class WeightWindow(NamedTuple):
    """Bounds of the importance of a ray, weight · exp(κ·depth).

    Attributes
    ----------
    weight : float
        Weight of the ray without absorption.
    kappa : float
        Decay rate of the window with depth (1/m).
    lower, upper : float
        Bounds of the importance.
    profile : float64[2, slices]
        Number and total weight of the segments that start in equal slices of the depth, advanced in
        place.
    """

    weight: float
    kappa: float
    lower: float
    upper: float
    profile: np.ndarray


@inline_only
def compute_ray_height(ray, layers):
    """Return the height of a ray (m)."""
    bottom = layers.boundaries[layers.boundaries.size - 1]
    return min(max(ray.geometry.position.z + ray.geometry.exit_offset.z, bottom), 0.0)


@inline_only
def compute_importance(ray, layers, weight, kappa):
    """Return the importance of a ray, proportional to its expected contribution."""
    return weight * math.exp(
        -ray.payload.roulette.optical_depth - kappa * compute_ray_height(ray, layers)
    )


@inline_only
def check_weight_window(window, ray, layers):
    """Return whether a ray is outside its weight window; tally its depth."""
    bottom = layers.boundaries[layers.boundaries.size - 1]
    slices = window.profile.shape[1]
    slice_index = min(int(compute_ray_height(ray, layers) / bottom * slices), slices - 1)
    window.profile[0, slice_index] += 1.0
    window.profile[1, slice_index] += window.weight * math.exp(-ray.payload.roulette.optical_depth)
    importance = compute_importance(ray, layers, window.weight, window.kappa)
    return importance < window.lower or importance > window.upper
