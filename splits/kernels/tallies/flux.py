"""From rays that passed faces to irradiances there and to what was absorbed in between.

Between two notes a ray stays in one layer.  What it loses on that stretch is absorbed there, by the
materials in proportion to their part of the optical depth; the lengths of such stretches give the
actinic flux.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import ONE, ZERO, entry_point, float32_constant, inline
from splits.kernels.math.elementary import exp_float32
from splits.kernels.tallies.crossings import (
    CROSSING_EVENT,
    CROSSING_LENGTH,
    CROSSING_RAY,
    CROSSING_WEIGHT,
)
from splits.kernels.tallies.exits import EXIT_LENGTH, EXIT_SIDE, EXIT_WEIGHT

DOWNWARD, UPWARD = 0, 1
_MAX_SERIES_DEPTH = float32_constant(0.05)
"""Optical depth of a stretch below which a series takes the place of a difference."""
_HALF, _SIXTH, _TWENTY_FOURTH = (
    float32_constant(1.0 / 2.0),
    float32_constant(1.0 / 6.0),
    float32_constant(1.0 / 24.0),
)


class FluxTally(NamedTuple):
    """Sums over rays.

    Attributes
    ----------
    boundary_weight : float64[2, faces, wavelengths]
        Weights of rays that pass a face, downwards and upwards; of those that come from above
        none, and of the ground's light all.
    absorbed : float64[layers, materials, wavelengths]
        Weights that materials take.
    path_length : float64[layers, wavelengths]
        Lengths (m) by weight.
    """

    boundary_weight: np.ndarray
    absorbed: np.ndarray
    path_length: np.ndarray


class _LastCrossing(NamedTuple):
    """A ray at its last note: lengths so far, and exp(−optical depth) at all wavelengths."""

    path_lengths: np.ndarray
    transmittance: np.ndarray


@entry_point
def tally_flux(exits, crossings, absorption, path_fractions, n_layers, ground_column):
    """Add up what rays carry past faces, and what they leave between.

    Parameters
    ----------
    exits : float64[rays, columns]
    crossings : float64[notes, columns]
        Of these rays, ray by ray, see `splits.kernels.tallies.crossings`.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m) of recorded lengths; of a ground −ln of its albedo.
    path_fractions : float64[materials]
        Path over recorded length, see `splits.media.medium.compute_path_fractions`.
    n_layers : int
    ground_column : int
        Column of the ground, see `scene.Scene`.

    Returns
    -------
    Passages
    """
    wavelengths, materials = absorption.shape
    alpha = np.empty((materials, wavelengths), dtype=np.float32)
    part = path_fractions.astype(np.float32)
    for material in range(materials):
        for i in range(wavelengths):
            alpha[material, i] = absorption[i, material]
    sums = FluxTally(
        np.zeros((2, n_layers + 1, wavelengths)),
        np.zeros((n_layers, materials, wavelengths)),
        np.zeros((n_layers, wavelengths)),
    )
    past = _LastCrossing(np.zeros(materials), np.ones(wavelengths, dtype=np.float32))
    now = np.empty(wavelengths, dtype=np.float32)
    first = 0
    for ray in range(exits.shape[0]):
        past.path_lengths[:] = 0.0
        past.transmittance[:] = ONE
        layer = 0
        while first < crossings.shape[0] and crossings[first, CROSSING_RAY] == ray:
            row = crossings[first]
            _tally_segment(
                sums,
                past,
                now,
                row[CROSSING_LENGTH:],
                row[CROSSING_WEIGHT],
                alpha,
                part,
                layer,
                ground_column,
            )
            face, up = divmod(int(row[CROSSING_EVENT]), 2)
            _add_weighted(sums.boundary_weight[up, face], now, row[CROSSING_WEIGHT])
            layer = face - up
            if face == n_layers:
                # The ground: what comes back from there has met it once more.
                layer = n_layers - 1
                past.path_lengths[ground_column] += 1.0
                for i in range(wavelengths):
                    past.transmittance[i] *= exp_float32(-alpha[ground_column, i])
                _add_weighted(
                    sums.boundary_weight[UPWARD, face], past.transmittance, row[CROSSING_WEIGHT]
                )
            first += 1
        side = int(exits[ray, EXIT_SIDE])
        if side >= 0:
            weight = exits[ray, EXIT_WEIGHT]
            _tally_segment(
                sums, past, now, exits[ray, EXIT_LENGTH:], weight, alpha, part, layer, ground_column
            )
            _add_weighted(
                sums.boundary_weight[
                    UPWARD if side == 0 else DOWNWARD, 0 if side == 0 else n_layers
                ],
                now,
                weight,
            )
    return sums


@inline
def _add_weighted(total, light, weight):
    """Add light, float32[wavelengths], of a ray of a weight."""
    for i in range(light.size):
        total[i] += light[i] * weight


@inline
def _tally_segment(
    sums, last, light, path_lengths, weight, alpha, path_fractions, layer, ground_column
):
    """Add what a ray leaves on a stretch, and bring its past to the end of that.

    Roulette on the way counts from the beginning of the stretch: on average that is the same.
    """
    absorbed, way = sums.absorbed[layer], sums.path_length[layer]
    light[:] = ZERO
    whole = 0.0
    for material in range(alpha.shape[0]):
        leg = np.float32(path_lengths[material] - last.path_lengths[material])
        if leg > ZERO and material != ground_column:
            whole += leg * path_fractions[material]
            for i in range(light.size):
                light[i] += alpha[material, i] * leg
    for i in range(light.size):
        depth = light[i]
        left = exp_float32(-depth)
        mean = ONE - depth * (_HALF - depth * (_SIXTH - depth * _TWENTY_FOURTH))
        mean = mean if depth < _MAX_SERIES_DEPTH else (ONE - left) / max(depth, _MAX_SERIES_DEPTH)
        light[i] = last.transmittance[i] * mean
        last.transmittance[i] *= left
    for material in range(alpha.shape[0]):
        leg = path_lengths[material] - last.path_lengths[material]
        if leg > 0.0 and material != ground_column:
            for i in range(light.size):
                absorbed[material, i] += light[i] * weight * (alpha[material, i] * leg)
        last.path_lengths[material] = path_lengths[material]
    for i in range(light.size):
        way[i] += light[i] * weight * whole
        light[i] = last.transmittance[i]
