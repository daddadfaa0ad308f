"""Angular distributions of exits: expansion over the hemisphere, and angular bins.

A BRDF is the density of exits per projected solid angle, dω cos θ = μ dμ dφ.  The expansion uses
polynomials orthonormal over that measure,

    B(μ, φ) = s · Re[(u + iv)^m] · P_l^(m,1)(2μ − 1),   u + iv = √(1 − μ) exp(iφ),

disk polynomials (Koornwinder 1975) in the coordinates u, v of Lambert's equal-area map, of degree
n = m + 2l.  They are smooth at the zenith and polynomials in μ at the horizon.  The first one is
constant and alone contains the hemispherical reflectance.  Sines are omitted: the distribution is
symmetric about the plane of incidence.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline
from splits.kernels.tallies.exits import (
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_SIDE,
    EXIT_WEIGHT,
    compute_path_weight,
)

WEIGHT, WEIGHT_SQUARED = range(2)
"""Rows of sums over rays: of the weights, and of their squares."""
FIRST_STOKES, FIRST_STOKES_SQUARED, FIRST_PRODUCT = 2, 5, 8
"""Rows of sums of polarized rays: of Q, U and V, of their squares, and of IQ, IU and QU."""
N_POLARIZED_SUMS = 11
_X, _Y, _Z = range(3)


class DiskBasis(NamedTuple):
    """Polynomials up to a degree, by increasing m and, for each m, increasing l.

    Attributes
    ----------
    n_per_m : int64[…]
        Polynomials for each m from 0 on.
    degrees : int64[polynomials]
        n = m + 2l.
    norms : float64[polynomials]
        Normalization factors.
    recurrence_slope, recurrence_offset, recurrence_previous : float64[polynomials]
        P_l = (slope·t + offset)·P_(l−1) − previous·P_(l−2).
    """

    n_per_m: np.ndarray
    degrees: np.ndarray
    norms: np.ndarray
    recurrence_slope: np.ndarray
    recurrence_offset: np.ndarray
    recurrence_previous: np.ndarray


class AngularSums(NamedTuple):
    """Sums over scattered rays, by direction, and over unscattered rays."""

    scattered: np.ndarray
    unscattered: np.ndarray


def make_basis(degree: int) -> DiskBasis:
    """Return the polynomials up to a degree (DLMF 18.9.2 with α = m and β = 1)."""
    rows = [(m, i) for m in range(degree + 1) for i in range((degree - m) // 2 + 1)]
    m, i = np.array(rows, dtype=float).T
    # ∫ (1 − μ)^m μ P² dμ is (l + 1) / ((2l + m + 2)(l + m + 1)); cosines give π, or 2π for m = 0.
    azimuth_integral = np.where(m == 0.0, 2.0 * np.pi, np.pi)
    scale = np.sqrt((2.0 * i + m + 2.0) * (i + m + 1.0) / ((i + 1.0) * azimuth_integral))
    denominator = 2.0 * i * (i + m + 1.0) * (2.0 * i + m - 1.0)
    # The first two need no recurrence, which would divide by 0.
    denominator = np.where(i < 2, 1.0, denominator)
    slope = (2.0 * i + m) * (2.0 * i + m + 1.0) * (2.0 * i + m - 1.0) / denominator
    offset = (2.0 * i + m) * (m * m - 1.0) / denominator
    previous = 2.0 * (i + m - 1.0) * i * (2.0 * i + m + 1.0) / denominator
    slope = np.where(i == 1, 0.5 * (m + 3.0), slope)
    offset = np.where(i == 1, 0.5 * (m - 1), offset)
    previous = np.where(i == 1, 0.0, previous)
    per_m = np.array([(degree - k) // 2 + 1 for k in range(degree + 1)])
    return DiskBasis(per_m, (m + 2 * i).astype(np.int64), scale, slope, offset, previous)


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
        order_class = 0
        while row[EXIT_ORDER] > max_orders[order_class]:
            order_class += 1
        dx, dy = row[EXIT_DIRECTION], row[EXIT_DIRECTION + 1]
        evaluate_basis(basis, dx, dy, abs(row[EXIT_DIRECTION + 2]), values)
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
