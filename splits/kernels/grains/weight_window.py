"""Bounds on what a ray is worth, for light that gets deep (see `splits.kernels.grains.splitting`)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import inline_only


class WeightWindow(NamedTuple):
    """Bounds on what a ray is worth, weight · exp(κ·depth) (see `splits.kernels.grains.splitting`).

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


@inline_only
def compute_ray_height(ray, layers):
    """Return the height at which a ray stands (m)."""
    bottom = layers.boundaries[layers.boundaries.size - 1]
    return min(max(ray.geometry.position.z + ray.geometry.exit_offset.z, bottom), 0.0)


@inline_only
def compute_importance(ray, layers, weight, kappa):
    """Return what a ray can be expected to contribute, see `WeightWindow`."""
    return weight * math.exp(
        -ray.payload.roulette.optical_depth - kappa * compute_ray_height(ray, layers)
    )


@inline_only
def check_weight_window(window, ray, layers):
    """Tell whether a ray's worth lies outside its window, and note where it is."""
    bottom = layers.boundaries[layers.boundaries.size - 1]
    slices = window.profile.shape[1]
    place = min(int(compute_ray_height(ray, layers) / bottom * slices), slices - 1)
    window.profile[0, place] += 1.0
    window.profile[1, place] += window.weight * math.exp(-ray.payload.roulette.optical_depth)
    worth = compute_importance(ray, layers, window.weight, window.kappa)
    return worth < window.lower or worth > window.upper
