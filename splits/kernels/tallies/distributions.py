"""Distributions of exits over directions, positions and delays."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline
from splits.kernels.records import (
    CROSSING_CODE,
    CROSSING_RAY,
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_POSITION,
    EXIT_SIDE,
    EXIT_WEIGHT,
    AngularSums,
)
from splits.kernels.tallies.exits import compute_path_weight

# --------------------------------------------------------------------------------------------------
# Angular distributions of exits: expansion over the hemisphere, and angular bins.
#
# A BRDF is the density of exits per projected solid angle, dω cos θ = μ dμ dφ.  The expansion uses
# polynomials orthonormal over that measure,
#
#     B(μ, φ) = s · Re[(u + iv)^m] · P_l^(m,1)(2μ − 1),   u + iv = √(1 − μ) exp(iφ),
#
# disk polynomials (Koornwinder 1975) in the coordinates u, v of Lambert's equal-area map, of degree
# n = m + 2l.  They are smooth at the zenith and polynomials in μ at the horizon.  The first one is
# constant and alone contains the hemispherical reflectance.  Sines are omitted: the distribution is
# symmetric about the plane of incidence.

WEIGHT, WEIGHT_SQUARED = range(2)
"""Rows of sums over rays: of the weights, and of their squares."""
FIRST_STOKES, FIRST_STOKES_SQUARED, FIRST_PRODUCT = 2, 5, 8
"""Rows of sums of polarized rays: of Q, U and V, of their squares, and of IQ, IU and QU."""
N_POLARIZED_SUMS = 11
_X, _Y, _Z = range(3)


@inline
def evaluate_basis(basis, dx, dy, mu, values):
    """Set `values` (float64[polynomials]) to the polynomials in the direction (dx, dy, ±μ)."""
    t = 2.0 * mu - 1.0
    inverse_root = 1.0 / math.sqrt(1.0 + mu)
    u, v = dx * inverse_root, dy * inverse_root
    real, imaginary = 1.0, 0.0
    row = 0
    for m in range(basis.n_per_m.size):
        last, previous = 1.0, 0.0
        for i in range(basis.n_per_m[m]):
            if i > 0:
                factor = basis.recurrence_slope[row] * t + basis.recurrence_offset[row]
                new = factor * last - basis.recurrence_previous[row] * previous
                last, previous = new, last
            values[row] = basis.norms[row] * real * last
            row += 1
        real, imaginary = u * real - v * imaginary, u * imaginary + v * real


@entry_point
def evaluate_basis_at(basis, directions):
    """Return the polynomials at directions (float64[n, 3]), float64[n, polynomials]."""
    values = np.empty((directions.shape[0], basis.norms.size))
    for i in range(directions.shape[0]):
        d = directions[i]
        evaluate_basis(basis, d[_X], d[_Y], abs(d[_Z]), values[i])
    return values


@entry_point
def tally_expansion(exits, absorption, max_orders, basis):
    """Tally the weights of rays times the basis polynomials, by order of scattering.

    Parameters
    ----------
    exits : float64[rays, columns]
        See `splits.kernels.tallies.exits`.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m).
    max_orders : int64[classes]
        Largest order of scattering of each class.
    basis : DiskBasis

    Returns
    -------
    AngularSums
        `scattered` is float64[classes, 2, wavelengths, polynomials], where side 0 is reflected and
        1 transmitted; `unscattered` has the weights of the other rays, float64[2, wavelengths].
    """
    wavelengths = absorption.shape[0]
    sums = np.zeros((max_orders.size, 2, wavelengths, basis.norms.size))
    unscattered = np.zeros((2, wavelengths))
    values = np.empty(basis.norms.size)
    for j in range(exits.shape[0]):
        row = exits[j]
        side, lengths, roulette_weight = int(row[EXIT_SIDE]), row[EXIT_LENGTH:], row[EXIT_WEIGHT]
        if side < 0:
            continue
        if row[EXIT_ORDER] == 0.0:
            for i in range(wavelengths):
                unscattered[side, i] += compute_path_weight(lengths, roulette_weight, absorption, i)
            continue
        # Rays of one class of orders share their noise; each class keeps its own polynomials.
        order_class = 0
        while row[EXIT_ORDER] > max_orders[order_class]:
            order_class += 1
        dx, dy = row[EXIT_DIRECTION], row[EXIT_DIRECTION + 1]
        evaluate_basis(basis, dx, dy, abs(row[EXIT_DIRECTION + 2]), values)
        # The coefficient of a polynomial is its mean over the exits, weighted by their light.
        for i in range(wavelengths):
            weight = compute_path_weight(lengths, roulette_weight, absorption, i)
            total = sums[order_class, side, i]
            for b in range(values.size):
                total[b] += weight * values[b]
    return AngularSums(sums, unscattered)


@entry_point
def tally_angular_bins(exits, absorption, n_polar, n_azimuth, polarized):
    """Tally the weights of rays and their squares in angular bins of equal solid angle.

    Parameters
    ----------
    exits, absorption
        See `tally_expansion`.
    n_polar, n_azimuth : int
        Bins from horizon to zenith, equally spaced in the cosine, and in azimuth.  The first
        azimuth bin is centred on the direction of travel of the beam.
    polarized : bool
        Whether Q, U and V over I follow the path lengths of the exits.

    Returns
    -------
    AngularSums
        `scattered` is float64[2, 2, wavelengths, polar, azimuth], [`WEIGHT`,
        `WEIGHT_SQUARED`][reflected, transmitted]; with polarization, the first axis also has the
        rows from `FIRST_STOKES` on.  `unscattered` has the first two rows, without bins.
    """
    wavelengths = absorption.shape[0]
    n_sums = N_POLARIZED_SUMS if polarized else 2
    sums = np.zeros((n_sums, 2, wavelengths, n_polar, n_azimuth))
    unscattered = np.zeros((2, 2, wavelengths))
    for j in range(exits.shape[0]):
        row = exits[j]
        side, lengths, roulette_weight = int(row[EXIT_SIDE]), row[EXIT_LENGTH:], row[EXIT_WEIGHT]
        if side < 0:
            continue
        dx, dy = row[EXIT_DIRECTION], row[EXIT_DIRECTION + 1]
        # Equal steps of azimuth and of the polar cosine have equal solid angles, dω = dφ dμ.
        turn = math.atan2(dy, dx) / (2.0 * math.pi) + 0.5 / n_azimuth
        azimuth_bin = min(int((turn - math.floor(turn)) * n_azimuth), n_azimuth - 1)
        polar_bin = min(int(abs(row[EXIT_DIRECTION + 2]) * n_polar), n_polar - 1)
        for i in range(wavelengths):
            weight = compute_path_weight(lengths, roulette_weight, absorption, i)
            if row[EXIT_ORDER] == 0.0:
                unscattered[WEIGHT, side, i] += weight
                unscattered[WEIGHT_SQUARED, side, i] += weight * weight
                continue
            in_bin = sums[:, side, i, polar_bin, azimuth_bin]
            in_bin[WEIGHT] += weight
            in_bin[WEIGHT_SQUARED] += weight * weight
            if polarized:
                add_polarized_sums(in_bin, weight, row[EXIT_LENGTH + absorption.shape[1] :])
    return AngularSums(sums, unscattered)


@inline
def add_polarized_sums(in_bin, weight, stokes):
    """Add the rows of a polarized ray from `FIRST_STOKES` on to the sums of its bin.

    `stokes` is float64[3]: Q, U and V over I.
    """
    square = weight * weight
    for k in range(3):
        in_bin[FIRST_STOKES + k] += weight * stokes[k]
        in_bin[FIRST_STOKES_SQUARED + k] += square * stokes[k] * stokes[k]
    in_bin[FIRST_PRODUCT] += square * stokes[0]
    in_bin[FIRST_PRODUCT + 1] += square * stokes[1]
    in_bin[FIRST_PRODUCT + 2] += square * stokes[0] * stokes[1]


# --------------------------------------------------------------------------------------------------
# Radial distributions and maps of the exit positions of rays.


class RadialSums(NamedTuple):
    """Distributions of exit positions, for the reflected and the transmitted side.

    Attributes
    ----------
    radial : float64[2, wavelengths, bins]
        Weights by side and distance from the point of entry.
    first_moment : float64[2, wavelengths]
        Weights times distance (m).
    exit_map : float64[2, 2, wavelengths, pixels, pixels]
        [`WEIGHT`, `WEIGHT_SQUARED`][side], along and across the beam; symmetrized about the plane
        of incidence.
    """

    radial: np.ndarray
    first_moment: np.ndarray
    exit_map: np.ndarray


@entry_point
def tally_radial(
    exits, absorption, min_distance, bins_per_decade, n_bins, map_half_width, n_pixels
):
    """Tally the weights of rays by distance from the point of entry and by exit position.

    Unscattered rays do not count.

    Parameters
    ----------
    exits : float64[rays, columns]
        See `splits.kernels.tallies.exits`; with positions and orders.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m).
    min_distance : float
        Upper edge of the first bin (m).
    bins_per_decade, n_bins : int
        Logarithmic bins; the first and the last are open.
    map_half_width : float
        Half width of the map (m).
    n_pixels : int
        Pixels along each edge of the map, odd; 0 for no map.

    Returns
    -------
    RadialSums
    """
    wavelengths = absorption.shape[0]
    radial = np.zeros((2, wavelengths, n_bins))
    first_moment = np.zeros((2, wavelengths))
    exit_map = np.zeros((2, 2, wavelengths, n_pixels, n_pixels))
    for j in range(exits.shape[0]):
        row = exits[j]
        side, lengths, roulette_weight = int(row[EXIT_SIDE]), row[EXIT_LENGTH:], row[EXIT_WEIGHT]
        if side < 0 or row[EXIT_ORDER] == 0.0:
            continue
        x, y = row[EXIT_POSITION], row[EXIT_POSITION + 1]
        radius = math.hypot(x, y)
        radial_bin = 0
        if radius >= min_distance:
            decades = math.log10(radius / min_distance)
            radial_bin = min(int(decades * bins_per_decade) + 1, n_bins - 1)
        inside = abs(x) < map_half_width and abs(y) < map_half_width
        if inside:
            along = min(int((x / map_half_width + 1.0) * 0.5 * n_pixels), n_pixels - 1)
            across = min(int((y / map_half_width + 1.0) * 0.5 * n_pixels), n_pixels - 1)
        for i in range(wavelengths):
            weight = compute_path_weight(lengths, roulette_weight, absorption, i)
            radial[side, i, radial_bin] += weight
            first_moment[side, i] += weight * radius
            if inside and n_pixels > 0:
                # The plane of incidence is one of symmetry: each mirror image has half the light.
                mirrored = n_pixels - 1 - across
                if across == mirrored:
                    exit_map[WEIGHT, side, i, along, across] += weight
                    exit_map[WEIGHT_SQUARED, side, i, along, across] += weight * weight
                    continue
                for column in (across, mirrored):
                    exit_map[WEIGHT, side, i, along, column] += 0.5 * weight
                    exit_map[WEIGHT_SQUARED, side, i, along, column] += 0.25 * weight * weight
    return RadialSums(radial, first_moment, exit_map)


# --------------------------------------------------------------------------------------------------
# Distributions of the delays of rays.

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
