"""Distributions of the delays of rays."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline
from splits.kernels.tallies.crossings import CROSSING_CODE, CROSSING_RAY
from splits.kernels.tallies.exits import (
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_POSITION,
    EXIT_SIDE,
    EXIT_WEIGHT,
    compute_path_weight,
)

N_MOMENTS = 4
"""Moments of the delay, from that of order 0."""


class Receiver(NamedTuple):
    """Which exits count, and how their delay depends on where they are.

    Attributes
    ----------
    direction : float64[3]
        From the sample towards the receiver of reflected light.
    min_cosine : float
        Smallest cosine of the angle between exits of reflected light and this direction; below −1
        for all exits.
    footprint_radius : float
        Largest distance of reflected exits from the point of entry (m).
    inverse_speed : float
        Delay (s/m) per distance of a reflected exit along the horizontal part of `direction`, away
        from the receiver.
    """

    direction: np.ndarray
    min_cosine: float
    footprint_radius: float
    inverse_speed: float


class DelayRecord(NamedTuple):
    """What is recorded of delays.

    Attributes
    ----------
    receiver : Receiver
    edges : float64[bins + 1]
        Increasing delays between bins (s).
    end_s : float
        End of the record (s), which may be infinite.
    pulse : float64[2, points]
        Delays (s), uniform, and the part of the pulse that has been emitted until then; a single
        point for an instantaneous pulse.
    interval : int64[boundaries]
        Interval of the depth of rays that have reached a boundary and no lower one; increasing.
    """

    receiver: Receiver
    edges: np.ndarray
    end_s: float
    pulse: np.ndarray
    interval: np.ndarray


class DelaySums(NamedTuple):
    """Distributions of delays, for the reflected and the transmitted side.

    Attributes
    ----------
    histogram : float64[2, wavelengths, bins]
        Weights by delay.
    moments : float64[2, wavelengths, depths, 4]
        Weights times powers of the delay (s), by the depth that rays reached, for delays before the
        end of the record.
    lengths : float64[2, wavelengths, materials]
        Weights times path lengths (m), for these delays.
    """

    histogram: np.ndarray
    moments: np.ndarray
    lengths: np.ndarray


@entry_point
def tally_delays(exits, crossings, absorption, slowness, record):
    """Tally the weights of rays by delay.

    Parameters
    ----------
    exits : float64[rays, columns]
        See `splits.kernels.tallies.exits`.
    crossings : float64[crossings, columns]
        Records of these rays, ray by ray.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m).
    slowness : float64[wavelengths, materials]
        Inverse of the group velocity (s/m).
    record : DelayRecord

    Returns
    -------
    DelaySums
    """
    receiver, edges, end, pulse, interval = record
    wavelengths = absorption.shape[0]
    histogram = np.zeros((2, wavelengths, edges.size - 1))
    moments = np.zeros((2, wavelengths, interval[-1] + 1, N_MOMENTS))
    path_lengths = np.zeros((2, wavelengths, absorption.shape[1]))
    first = 0
    for j in range(exits.shape[0]):
        row = exits[j]
        depth = 0
        while first < crossings.shape[0] and crossings[first, CROSSING_RAY] == j:
            depth = max(depth, interval[int(crossings[first, CROSSING_CODE]) // 2])
            first += 1
        side = int(row[EXIT_SIDE])
        if side < 0 or (side == 0 and not _is_received(row, receiver)):
            continue
        geometric = 0.0
        if side == 0:
            geometric = -receiver.inverse_speed * (
                row[EXIT_POSITION] * receiver.direction[0]
                + row[EXIT_POSITION + 1] * receiver.direction[1]
            )
        lengths = row[EXIT_LENGTH:]
        for i in range(wavelengths):
            delay = geometric
            for material in range(slowness.shape[1]):
                delay += slowness[i, material] * lengths[material]
            # Backwards between point grains, light may advance faster than with time.
            delay = max(delay, 0.0)
            weight = compute_path_weight(lengths, row[EXIT_WEIGHT], absorption, i)
            _add_to_histogram(histogram[side, i], edges, pulse, delay, weight)
            if delay < end:
                power = weight
                for order in range(N_MOMENTS):
                    moments[side, i, depth, order] += power
                    power *= delay
                for material in range(absorption.shape[1]):
                    path_lengths[side, i, material] += weight * lengths[material]
    return DelaySums(histogram, moments, path_lengths)


@inline
def _is_received(row, receiver):
    """Return whether a reflected exit reaches the receiver."""
    cosine = 0.0
    for axis in range(3):
        cosine += row[EXIT_DIRECTION + axis] * receiver.direction[axis]
    distance = math.hypot(row[EXIT_POSITION], row[EXIT_POSITION + 1])
    return cosine >= receiver.min_cosine and distance <= receiver.footprint_radius


@inline
def _add_to_histogram(histogram, edges, pulse, delay, weight):
    """Add light of a delay to the bins in which it arrives."""
    n_points = pulse.shape[1]
    if n_points == 1:
        column = np.searchsorted(edges, delay, side="right") - 1
        if 0 <= column < histogram.size:
            histogram[column] += weight
        return
    begin, step = pulse[0, 0], pulse[0, 1] - pulse[0, 0]
    column = max(np.searchsorted(edges, delay + begin, side="right") - 1, 0)
    emitted = _interpolate_pulse(pulse[1], (edges[column] - delay - begin) / step)
    while column < histogram.size and emitted < 1.0:
        following = _interpolate_pulse(pulse[1], (edges[column + 1] - delay - begin) / step)
        histogram[column] += weight * (following - emitted)
        emitted = following
        column += 1


@inline
def _interpolate_pulse(cumulative, position):
    """Return a cumulative pulse at a position in steps of its table."""
    last = cumulative.size - 1
    if position <= 0.0:
        return 0.0
    if position >= last:
        return 1.0
    row = int(position)
    return cumulative[row] + (position - row) * (cumulative[row + 1] - cumulative[row])
