"""Irradiances at layer boundaries, absorption and path lengths in layers, from crossing records.

Between two crossings a ray stays in one layer.  Its loss of weight on that segment is absorbed
there, by the materials in proportion to their optical depths.  The lengths of the segments give the
actinic flux.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.arithmetic import exp_float32
from splits.kernels.compiler.jit import HALF, ONE, ZERO, entry_point, float32_constant, inline
from splits.kernels.records import (
    CROSSING_CODE,
    CROSSING_LENGTH,
    CROSSING_RAY,
    CROSSING_WEIGHT,
    EXIT_LENGTH,
    EXIT_SIDE,
    EXIT_WEIGHT,
)
from splits.kernels.tallies.exits import transpose_absorption

DOWNWELLING, UPWELLING = range(2)
_MAX_SERIES_DEPTH = float32_constant(0.05)
"""Optical depth of a segment below which a series replaces the difference of exponentials."""
_SIXTH, _TWENTY_FOURTH = float32_constant(1.0 / 6.0), float32_constant(1.0 / 24.0)


class FluxSums(NamedTuple):
    """Flux and absorption tallies, summed over rays.

    Attributes
    ----------
    boundary_weight : float64[2, boundaries, wavelengths]
        Weights of rays that cross a boundary, downwards and upwards.  Incident light is not
        included; all light that the ground reflects is.
    absorbed : float64[layers, materials, wavelengths]
        Weights absorbed in the materials.
    path_length : float64[layers, wavelengths]
        Path lengths (m) times weight.
    """

    boundary_weight: np.ndarray
    absorbed: np.ndarray
    path_length: np.ndarray


@entry_point
def tally_flux(exits, crossings, absorption, path_fractions, n_layers, ground_column):
    """Tally the weights of rays at boundaries, and their absorption in the layers.

    Parameters
    ----------
    exits : float64[rays, columns]
    crossings : float64[crossings, columns]
        Of these rays, ray by ray, see `splits.kernels.tallies.exits`.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m) of recorded path lengths; −ln of the albedo for a ground.
    path_fractions : float64[materials]
        Path over recorded length, see `splits.simulation.scene.compute_path_fractions`.
    n_layers : int
    ground_column : int
        Column of the ground, see `scene.Scene`.

    Returns
    -------
    FluxSums
    """
    wavelengths, materials = absorption.shape
    alpha = transpose_absorption(absorption)
    fractions = path_fractions.astype(np.float32)
    sums = FluxSums(
        np.zeros((2, n_layers + 1, wavelengths)),
        np.zeros((n_layers, materials, wavelengths)),
        np.zeros((n_layers, wavelengths)),
    )
    # Path lengths and exp(−optical depth) of a ray at its last crossing.
    last_lengths, transmittance = np.zeros(materials), np.ones(wavelengths, dtype=np.float32)
    light = np.empty(wavelengths, dtype=np.float32)
    first = 0
    for ray in range(exits.shape[0]):
        last_lengths[:] = 0.0
        transmittance[:] = ONE
        layer = 0
        while first < crossings.shape[0] and crossings[first, CROSSING_RAY] == ray:
            row = crossings[first]
            weight = row[CROSSING_WEIGHT]
            _tally_segment(
                sums, layer, light, weight, row[CROSSING_LENGTH:], last_lengths, transmittance,
                alpha, fractions, ground_column,
            )  # fmt: skip
            boundary, upward = divmod(int(row[CROSSING_CODE]), 2)
            _add_weighted(sums.boundary_weight[upward, boundary], light, weight)
            layer = boundary - upward
            if boundary == n_layers:
                # Light that the ground reflects has hit it once more.
                layer = n_layers - 1
                last_lengths[ground_column] += 1.0
                for i in range(wavelengths):
                    transmittance[i] *= exp_float32(-alpha[ground_column, i])
                _add_weighted(sums.boundary_weight[UPWELLING, boundary], transmittance, weight)
            first += 1
        side, weight = int(exits[ray, EXIT_SIDE]), exits[ray, EXIT_WEIGHT]
        if side >= 0:
            _tally_segment(
                sums, layer, light, weight, exits[ray, EXIT_LENGTH:], last_lengths, transmittance,
                alpha, fractions, ground_column,
            )  # fmt: skip
            boundary, upward = (0, UPWELLING) if side == 0 else (n_layers, DOWNWELLING)
            _add_weighted(sums.boundary_weight[upward, boundary], light, weight)
    return sums


@inline
def _add_weighted(total, light, weight):
    """Add transmittances, float32[wavelengths], times a weight."""
    for i in range(light.size):
        total[i] += light[i] * weight


@inline
def _tally_segment(
    sums, layer, light, weight, path_lengths, last_lengths, transmittance, alpha, path_fractions,
    ground_column,
):  # fmt: skip
    """Tally the absorption of a ray on a segment, and advance the ray to its end.

    The weight at the end of the segment counts for all of it, although roulette may change it on
    the way: the mean is the same.
    """
    absorbed, path_length = sums.absorbed[layer], sums.path_length[layer]
    light[:] = ZERO
    length = 0.0
    for material in range(alpha.shape[0]):
        segment = np.float32(path_lengths[material] - last_lengths[material])
        if segment > ZERO and material != ground_column:
            length += segment * path_fractions[material]
            for i in range(light.size):
                light[i] += alpha[material, i] * segment
    for i in range(light.size):
        # Mean of exp(−optical depth) along the segment, (1 − e^(−τ))/τ; a series where it cancels.
        depth = light[i]
        passing = exp_float32(-depth)
        series = ONE - depth * (HALF - depth * (_SIXTH - depth * _TWENTY_FOURTH))
        ratio = (ONE - passing) / max(depth, _MAX_SERIES_DEPTH)
        light[i] = transmittance[i] * (series if depth < _MAX_SERIES_DEPTH else ratio)
        transmittance[i] *= passing
    for material in range(alpha.shape[0]):
        # Absorbed light: the Beer-Lambert law, with the mean weight on the segment.
        segment = path_lengths[material] - last_lengths[material]
        if segment > 0.0 and material != ground_column:
            for i in range(light.size):
                absorbed[material, i] += light[i] * weight * (alpha[material, i] * segment)
        last_lengths[material] = path_lengths[material]
    for i in range(light.size):
        path_length[i] += light[i] * weight * length
        light[i] = transmittance[i]
