"""Splitting and Russian roulette with weight windows, for the transmittance of deep samples.

Rays that reach the bottom of a deep, absorbing sample are rare in analog tracing.  The expected
contribution of a ray falls with its weight and grows with its depth.  If its relative weight,
weight · exp(κ·depth), exceeds a window, the ray is split into several of lower weight; below the
window, Russian roulette terminates it or raises its weight.  Rays of similar relative weight are
then present at all depths (weight windows; Booth & Hendricks 1984, Nucl. Technol./Fusion 5, 90-100,
doi:10.13182/FST84-A23082).  Neither changes the mean; κ affects the variance only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.base.ray import ALIVE, LOST, TRANSMITTED, Ray
from splits.kernels.base.work import FIRST_RAY, MAX_ORDER, N_RAYS, STREAM
from splits.kernels.compiler.jit import entry_point, inline_allocating
from splits.kernels.compiler.replace import replace
from splits.kernels.math.rng import mix64, start_stream, uniform
from splits.kernels.tallies.exits import TraceResult
from splits.kernels.transport.history import sample_source, trace_history
from splits.kernels.transport.weight_window import WeightWindow, compute_relative_weight

BANK_SIZE = 4096
"""Capacity of the bank of split rays; rays are not split while it is full."""
WINDOW_UPPER = 2.0
WINDOW_LOWER = 0.5
MAX_SPLIT = 16
"""Largest number of rays from one split."""


class SplitRay(NamedTuple):
    """Ray of a history with splitting: its weight without absorption, and its random stream."""

    ray: Ray
    weight: float
    stream: int


class HistoryScore(NamedTuple):
    """Transmitted weight of a history with splitting, its segments, and whether it was lost."""

    transmitted: float
    n_segments: int
    lost: bool


@inline_allocating
def split(state, split_ray, relative_weight, bank):
    """Split a ray of high relative weight, and store all but one of the copies in the bank."""
    n_copies = min(int(relative_weight + 0.5), MAX_SPLIT)
    weight = split_ray.weight / n_copies
    for copy in range(1, n_copies):
        stream = mix64(state[0] ^ mix64(np.uint64(copy)))
        bank.append(SplitRay(split_ray.ray, weight, stream))
    # The remaining ray continues in a new stream, too, so that no streams overlap.
    state[0] = mix64(state[0] ^ mix64(np.uint64(0)))
    return SplitRay(split_ray.ray, weight, split_ray.stream)


@inline_allocating
def trace_history_with_splitting(state, source_ray, scene, optics, kappa, profile):
    """Trace a ray and its progeny, see `trace_with_splitting`."""
    path_lengths = np.zeros(optics.n.size)
    transmitted, n_segments = 0.0, 0
    bank = [source_ray]
    while len(bank) > 0:
        split_ray = bank.pop()
        state[0] = split_ray.stream
        ray = split_ray.ray
        while ray.status == ALIVE:
            window = WeightWindow(split_ray.weight, kappa, WINDOW_LOWER, WINDOW_UPPER, profile)
            n_before = ray.n_segments
            ray = trace_history(state, ray, scene, optics, path_lengths, None, window, None)
            n_segments += ray.n_segments - n_before
            if ray.status != ALIVE:
                break
            split_ray = SplitRay(ray, split_ray.weight, split_ray.stream)
            relative_weight = compute_relative_weight(ray, scene.layers, split_ray.weight, kappa)
            if relative_weight < WINDOW_LOWER:
                if uniform(state) >= relative_weight:
                    break
                split_ray = SplitRay(ray, split_ray.weight / relative_weight, split_ray.stream)
            elif relative_weight > WINDOW_UPPER and len(bank) + MAX_SPLIT < BANK_SIZE:
                split_ray = split(state, split_ray, relative_weight, bank)
        if ray.status == LOST:
            return HistoryScore(transmitted, n_segments, True)
        if ray.status == TRANSMITTED:
            transmitted += split_ray.weight * math.exp(-ray.optical_depth)
    return HistoryScore(transmitted, n_segments, False)


@entry_point
def trace_with_splitting(seed, work, scene, optics, kappa, moments, profile):
    """Trace rays with splitting, and tally the moments of their transmitted weights.

    Parameters
    ----------
    seed : int
    work : int64[4]
        See `splits.kernels.base.work`.
    scene, optics
        See `splits.kernels.base.scene`.  The scene has a smooth top, an open bottom and no
        particles; `optics.absorption` is that of the single wavelength.
    kappa : float
        Decay rate of the window with depth (1/m).
    moments : float64[3]
        Sum, sum of squares and maximum of the transmitted weights of histories, accumulated in
        place.
    profile : float64[2, slices]
        See `splits.kernels.transport.weight_window.WeightWindow`; accumulated in place.

    Returns
    -------
    TraceResult
        Without crossings.
    """
    n_segments = np.zeros(1, dtype=np.int64)
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[FIRST_RAY], work[FIRST_RAY] + work[N_RAYS]):
        start_stream(state, seed, work[STREAM], number)
        ray = sample_source(state, scene, optics, None, work[MAX_ORDER])
        # The weight window replaces the roulette by optical depth.
        ray = replace(ray, next_roulette=math.inf)
        source_ray = SplitRay(ray, 1.0, state[0])
        score = trace_history_with_splitting(state, source_ray, scene, optics, kappa, profile)
        n_segments[0] += score.n_segments
        if score.lost:
            return TraceResult(n_segments, True, None)
        weight = score.transmitted
        moments[0] += weight
        moments[1] += weight * weight
        moments[2] = max(moments[2], weight)
    return TraceResult(n_segments, False, None)
