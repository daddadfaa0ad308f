"""From rays that left to where they left: distances from the point of entry, and maps."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point
from splits.kernels.tallies.angular import WEIGHT, WEIGHT_SQUARED, compute_path_weight
from splits.kernels.tallies.exits import EXIT_ORDER, EXIT_POSITION, EXIT_SIDE


class RadialTally(NamedTuple):
    """Where rays left; sides are reflected and transmitted.

    Attributes
    ----------
    radial : float64[2, wavelengths, bins]
        Weights by side and distance.
    first_moment : float64[2, wavelengths]
        Weights times distance (m).
    exit_map : float64[2, 2, wavelengths, cells, cells]
        [`WEIGHT`, `WEIGHT_SQUARED`][side], along the beam and across; the two sides of the plane of
        incidence are alike and share what they have.
    """

    radial: np.ndarray
    first_moment: np.ndarray
    exit_map: np.ndarray


@entry_point
def tally_radial(
    exits, absorption, min_distance, bins_per_decade, n_bins, map_half_width, n_pixels
):
    """Add up the weights of rays by distance from their point of entry and by place.

    Rays that met no grain do not count.

    Parameters
    ----------
    exits : float64[rays, columns]
        See `splits.kernels.tallies.exits`; with positions and orders.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m).
    min_distance : float
        Upper edge of the first bin (m).
    bins_per_decade, n_bins : int
        Bins of equal ratio; the first and the last have no limit to their side.
    map_half_width : float
        Of the map (m).
    n_pixels : int
        Of the map along each edge, odd; 0 for no map.

    Returns
    -------
    Spread
    """
    wavelengths = absorption.shape[0]
    radial = np.zeros((2, wavelengths, n_bins))
    first_moment = np.zeros((2, wavelengths))
    place = np.zeros((2, 2, wavelengths, n_pixels, n_pixels))
    for j in range(exits.shape[0]):
        row = exits[j]
        side = int(row[EXIT_SIDE])
        if side < 0 or row[EXIT_ORDER] == 0.0:
            continue
        x, y = row[EXIT_POSITION], row[EXIT_POSITION + 1]
        radius = math.hypot(x, y)
        number = 0
        if radius >= min_distance:
            number = min(int(math.log10(radius / min_distance) * bins_per_decade) + 1, n_bins - 1)
        inside = abs(x) < map_half_width and abs(y) < map_half_width
        if inside:
            along = min(int((x / map_half_width + 1.0) * 0.5 * n_pixels), n_pixels - 1)
            across = min(int((y / map_half_width + 1.0) * 0.5 * n_pixels), n_pixels - 1)
        for i in range(wavelengths):
            weight = compute_path_weight(row, absorption, i)
            radial[side, i, number] += weight
            first_moment[side, i] += weight * radius
            if inside and n_pixels > 0:
                mirrored = n_pixels - 1 - across
                if across == mirrored:
                    place[WEIGHT, side, i, along, across] += weight
                    place[WEIGHT_SQUARED, side, i, along, across] += weight * weight
                    continue
                for line in (across, mirrored):
                    place[WEIGHT, side, i, along, line] += 0.5 * weight
                    place[WEIGHT_SQUARED, side, i, along, line] += 0.25 * weight * weight
    return RadialTally(radial, first_moment, place)
