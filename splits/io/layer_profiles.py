"""Profiles measured along the depth of a snowpack, assigned to its layers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

MIN_OVERLAP_M = 1e-6
"""Overlaps up to this length are due to rounding."""


class DepthProfile(NamedTuple):
    """Values measured over intervals of depth, or at points.

    Attributes
    ----------
    top_m, thickness_m, values : float, shape (n,)
        Depth of the top of each interval below the surface, its thickness, 0 for points, and the
        value measured.
    """

    top_m: np.ndarray
    thickness_m: np.ndarray
    values: np.ndarray

    def drop_gaps(self) -> DepthProfile:
        """Return the profile without missing values and depths, in the order of the depth."""
        thickness_m = np.where(np.isnan(self.thickness_m), 0.0, self.thickness_m)
        kept = np.isfinite(self.top_m) & np.isfinite(self.values)
        order = np.argsort((self.top_m + thickness_m / 2.0)[kept], kind="stable")
        return DepthProfile(
            self.top_m[kept][order], thickness_m[kept][order], self.values[kept][order]
        )

    @property
    def middle_m(self) -> np.ndarray:
        """Depth of the middle of each interval (m)."""
        return self.top_m + self.thickness_m / 2.0


def average_over_layers(
    profile: DepthProfile, top_m: np.ndarray, thickness_m: np.ndarray, *, extend: bool
) -> np.ndarray:
    """Return the value of each layer, the mean of the intervals weighted by their overlap with it.

    Points in a layer that lie in no interval share the part of the layer that no interval covers,
    with equal weights.  A layer without overlap and points takes the value by linear interpolation
    to its middle between the middles of the intervals.

    Parameters
    ----------
    profile : DepthProfile
    top_m, thickness_m : float, shape (layers,)
    extend : bool
        Whether layers above the first or below the last middle that overlap no interval take the
        value of the nearest one; otherwise NaN.
    """
    profile = profile.drop_gaps()
    if not profile.values.size:
        return np.full(top_m.shape, np.nan)
    averages = interpolate_to_layers(profile, top_m, thickness_m, extend=extend)
    # Intervals in the order of their tops, before points at the same depth.
    order = np.lexsort((profile.thickness_m == 0.0, profile.top_m))
    top, thickness, values = (column[order] for column in profile)
    bottom = top + thickness
    deepest = np.maximum.accumulate(bottom)
    deepest_above = np.concatenate([[-np.inf], deepest[:-1]])
    for i, (layer_top, layer_bottom) in enumerate(zip(top_m, top_m + thickness_m, strict=True)):
        near = slice(np.searchsorted(deepest, layer_top), np.searchsorted(top, layer_bottom))
        first, last = np.maximum(layer_top, top[near]), np.minimum(layer_bottom, bottom[near])
        weights = np.where(last - first > MIN_OVERLAP_M, last - first, 0.0)
        # Intervals may overlap each other: what each one covers beyond those above it.
        covered = np.maximum(last - np.maximum(first, deepest_above[near]), 0.0).sum()
        is_free = (thickness[near] == 0.0) & (
            top[near] >= np.maximum(layer_top, deepest_above[near])
        )
        if is_free.any() and covered < layer_bottom - layer_top:
            weights *= covered / max(weights.sum(), MIN_OVERLAP_M)
            weights[is_free] = (layer_bottom - layer_top - covered) / is_free.sum()
        if weights.any():
            averages[i] = weights @ values[near] / weights.sum()
    return averages


def interpolate_to_layers(
    profile: DepthProfile, top_m: np.ndarray, thickness_m: np.ndarray, *, extend: bool
) -> np.ndarray:
    """Return the value at the middle of each layer, linear between the middles of the intervals.

    Parameters are those of `average_over_layers`.
    """
    profile = profile.drop_gaps()
    if not profile.values.size:
        return np.full(top_m.shape, np.nan)
    beyond = {} if extend else {"left": np.nan, "right": np.nan}
    middle_m = top_m + thickness_m / 2.0
    for end_m in profile.middle_m[[0, -1]]:
        middle_m = np.where(np.abs(middle_m - end_m) <= MIN_OVERLAP_M, end_m, middle_m)
    return np.asarray(np.interp(middle_m, profile.middle_m, profile.values, **beyond))
