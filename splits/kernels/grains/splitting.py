"""Light that gets deep: rays split where they matter, end where they do not.

Rays that reach the bottom of a deep, absorbing sample are too rare to wait for.  What a ray can be
expected to contribute falls with its weight and grows with its depth.  Where the product,
weight · exp(κ·depth), exceeds a window the ray is split into several lighter ones, and below it
Russian roulette ends it or makes it heavier, so that rays of about equal worth are present at all
depths (weight windows; Booth & Hendricks 1984, Nucl. Technol./Fusion 5, 90-100,
doi:10.13182/FST84-A23082).  Neither changes the mean; κ only decides how fast it is reached.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline_allocating
from splits.kernels.grains.free_path import RouletteState
from splits.kernels.grains.history import sample_source, trace_history
from splits.kernels.grains.scene import NO_MAX_ORDER
from splits.kernels.grains.state import Ray, RayPayload
from splits.kernels.grains.weight_window import WeightWindow, compute_importance
from splits.kernels.math.rng import mix64, start_stream, uniform
from splits.kernels.tallies.exits import ALIVE, LOST, REFLECTED, TRANSMITTED, BatchStats

BANK_SIZE = 4096
"""Rays that may wait to be followed; none is split while so many do."""
WINDOW_UPPER = 2.0
WINDOW_LOWER = 0.5
MAX_SPLIT = 16
"""Largest number of rays that one is split into at a time."""


class SplitRay(NamedTuple):
    """A ray of a family: its weight, absorption not counted, and the start of its stream."""

    ray: Ray
    weight: float
    stream: int


class HistoryScore(NamedTuple):
    """What a family sent through, and the legs it took; `lost` where a ray found no grain."""

    reflected: float
    transmitted: float
    n_segments: int
    lost: bool


@inline_allocating
def split(state, split_ray, importance, bank):
    """Split a ray that is worth too much; all but one wait."""
    copies = min(int(importance + 0.5), MAX_SPLIT)
    weight = split_ray.weight / copies
    for copy in range(1, copies):
        stream = mix64(state[0] ^ mix64(np.uint64(copy)))
        bank.append(SplitRay(split_ray.ray, weight, stream))
    # The ray itself goes on in a stream of its own, too: no two may meet.
    state[0] = mix64(state[0] ^ mix64(np.uint64(0)))
    return SplitRay(split_ray.ray, weight, split_ray.stream)


@inline_allocating
def trace_history_with_splitting(state, source_ray, scene, optics, kappa, profile):
    """Follow a ray and all that it is split into; see `trace_batch_with_splitting`."""
    length = np.zeros(optics.n.size)
    reflected, transmitted, legs = 0.0, 0.0, 0
    waiting = [source_ray]
    while len(waiting) > 0:
        member = waiting.pop()
        state[0] = member.stream
        ray = member.ray
        while ray.status == ALIVE:
            window = WeightWindow(member.weight, kappa, WINDOW_LOWER, WINDOW_UPPER, profile)
            before = ray.n_segments
            ray = trace_history(state, ray, scene, optics, length, None, window, None)
            legs += ray.n_segments - before
            if ray.status != ALIVE:
                break
            member = SplitRay(ray, member.weight, member.stream)
            worth = compute_importance(ray, scene.layers, member.weight, kappa)
            if worth < WINDOW_LOWER:
                if uniform(state) >= worth:
                    break
                member = SplitRay(ray, member.weight / worth, member.stream)
            elif worth > WINDOW_UPPER and len(waiting) + MAX_SPLIT < BANK_SIZE:
                member = split(state, member, worth, waiting)
        weight = member.weight * math.exp(-ray.payload.roulette.optical_depth)
        if ray.status == LOST:
            return HistoryScore(reflected, transmitted, legs, True)
        if ray.status == REFLECTED:
            reflected += weight
        elif ray.status == TRANSMITTED:
            transmitted += weight
    return HistoryScore(reflected, transmitted, legs, False)


@entry_point
def trace_batch_with_splitting(seed, work, scene, optics, kappa, moments, profile):
    """Follow rays and all that they are split into, and add up what each family sends through.

    Parameters
    ----------
    seed : int
    work : int64[3]
        Ensemble, first ray, number of rays; they name the random streams, as in `granular.batch`.
    scene, optics
        See `splits.kernels.grains.scene`; `optics.absorption` is that of the wavelength traced.
    kappa : float
        Rate at which the window falls with depth (1/m).
    moments : float64[2, 3]
        For [reflected, transmitted]: sum, sum of squares and largest of the families' weights,
        advanced in place.
    profile : float64[2, slices]
        See `splits.kernels.grains.weight_window.WeightWindow`; advanced in place.

    Returns
    -------
    Traced
    """
    legs = 0
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[1], work[1] + work[2]):
        start_stream(state, seed, work[0], number)
        ray = sample_source(state, scene, optics, None, NO_MAX_ORDER)
        # Where worth decides, roulette does not.
        beam = RayPayload(
            ray.payload.direction,
            ray.payload.layer,
            ray.payload.pore_variate,
            RouletteState(0.0, math.inf, 1.0),
        )
        ray = Ray(ray.status, ray.geometry, beam, ray.n_segments, ray.order, ray.max_order)
        first = SplitRay(ray, 1.0, state[0])
        sent = trace_history_with_splitting(state, first, scene, optics, kappa, profile)
        legs += sent.n_segments
        if sent.lost:
            return BatchStats(legs, True)
        for row, weight in ((0, sent.reflected), (1, sent.transmitted)):
            moments[row, 0] += weight
            moments[row, 1] += weight * weight
            moments[row, 2] = max(moments[row, 2], weight)
    return BatchStats(legs, False)
