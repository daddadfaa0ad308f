"""Radial distributions and maps of the exit positions of rays."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point
from splits.kernels.tallies.angular import WEIGHT, WEIGHT_SQUARED
from splits.kernels.tallies.exits import (
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_POSITION,
    EXIT_SIDE,
    EXIT_WEIGHT,
    compute_path_weight,
)


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
                mirrored = n_pixels - 1 - across
                if across == mirrored:
                    exit_map[WEIGHT, side, i, along, across] += weight
                    exit_map[WEIGHT_SQUARED, side, i, along, across] += weight * weight
                    continue
                for column in (across, mirrored):
                    exit_map[WEIGHT, side, i, along, column] += 0.5 * weight
                    exit_map[WEIGHT_SQUARED, side, i, along, column] += 0.25 * weight * weight
    return RadialSums(radial, first_moment, exit_map)
