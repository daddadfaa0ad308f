"""Weight windows for splitting, see `splits.kernels.transport.splitting`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.base.ray import compute_position
from splits.kernels.compiler.jit import inline_only


class WeightWindow(NamedTuple):
    """Bounds of the relative weight of a ray, weight · exp(−optical depth + κ·depth).

    Attributes
    ----------
    weight : float
        Weight of the ray without absorption.
    kappa : float
        Decay rate of the window with depth (1/m).
    lower, upper : float
        Bounds of the relative weight.
    profile : float64[2, slices]
        Number and total weight of the collisions in equal slices of the depth, accumulated in
        place.
    """

    weight: float
    kappa: float
    lower: float
    upper: float
    profile: np.ndarray


@inline_only
def compute_ray_height(ray, layers):
    """Return the height of a ray (m), limited to that of the sample."""
    bottom = layers.boundaries[layers.boundaries.size - 1]
    return min(max(compute_position(ray).z, bottom), 0.0)


@inline_only
def compute_relative_weight(ray, layers, weight, kappa):
    """Return the weight of a ray relative to the centre of the window at its depth."""
    return weight * math.exp(-ray.optical_depth - kappa * compute_ray_height(ray, layers))


@inline_only
def leaves_weight_window(window, ray, layers):
    """Tally the depth of a ray, and return whether it is outside its weight window."""
    bottom = layers.boundaries[layers.boundaries.size - 1]
    slices = window.profile.shape[1]
    slice_index = min(int(compute_ray_height(ray, layers) / bottom * slices), slices - 1)
    window.profile[0, slice_index] += 1.0
    window.profile[1, slice_index] += window.weight * math.exp(-ray.optical_depth)
    relative_weight = compute_relative_weight(ray, layers, window.weight, window.kappa)
    return relative_weight < window.lower or relative_weight > window.upper
