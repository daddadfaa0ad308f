"""From rays that passed faces to irradiances there and to what was absorbed in between.

Between two notes a ray stays in one layer.  What it loses on that stretch is absorbed there, by the
materials in proportion to their part of the optical depth; the lengths of such stretches give the
actinic flux.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.transport.compiling.jit import ONE, ZERO, entry, exact, kernel
from splits.transport.numerics.elementary import exponential
from splits.transport.sums.notes import NOTE_EVENT, NOTE_LENGTH, NOTE_RAY, NOTE_WEIGHT
from splits.transport.sums.tally import EXIT_LENGTH, EXIT_SIDE, EXIT_WEIGHT

DOWN, UP = 0, 1
_SERIES = exact(0.05)
"""Optical depth of a stretch below which a series takes the place of a difference."""
_HALF, _SIXTH, _TWENTY_FOURTH = exact(1.0 / 2.0), exact(1.0 / 6.0), exact(1.0 / 24.0)


class Passages(NamedTuple):
    """Sums over rays.

    Attributes
    ----------
    light : float64[2, faces, wavelengths]
        Weights of rays that pass a face, downwards and upwards; of those that come from above
        none, and of the ground's light all.
    absorbed : float64[layers, materials, wavelengths]
        Weights that materials take.
    way : float64[layers, wavelengths]
        Lengths (m) by weight.
    """

    boundary_weight: np.ndarray
    absorbed: np.ndarray
    path_length: np.ndarray


class _Past(NamedTuple):
    """A ray at its last note: lengths so far, and exp(−optical depth) at all wavelengths."""

    path_lengths: np.ndarray
    transmittance: np.ndarray


@entry
def passages(exits, crossings, absorption, path_fractions, n_layers, ground_column):
    """Add up what rays carry past faces, and what they leave between.

    Parameters
    ----------
    exits : float64[rays, columns]
    notes : float64[notes, columns]
        Of these rays, ray by ray, see `splits.transport.sums.notes`.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m) of recorded lengths; of a ground −ln of its albedo.
    fractions : float64[materials]
        Path over recorded length, see `splits.media.granular.path_fractions`.
    layers : int
    ground : int
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
    sums = Passages(
        np.zeros((2, n_layers + 1, wavelengths)),
        np.zeros((n_layers, materials, wavelengths)),
        np.zeros((n_layers, wavelengths)),
    )
    past = _Past(np.zeros(materials), np.ones(wavelengths, dtype=np.float32))
    now = np.empty(wavelengths, dtype=np.float32)
    first = 0
    for ray in range(exits.shape[0]):
        past.path_lengths[:] = 0.0
        past.transmittance[:] = ONE
        layer = 0
        while first < crossings.shape[0] and crossings[first, NOTE_RAY] == ray:
            row = crossings[first]
            _stretch(
                sums, past, now, row[NOTE_LENGTH:], row[NOTE_WEIGHT], alpha, part, layer, ground_column
            )
            face, up = divmod(int(row[NOTE_EVENT]), 2)
            _add(sums.boundary_weight[up, face], now, row[NOTE_WEIGHT])
            layer = face - up
            if face == n_layers:
                # The ground: what comes back from there has met it once more.
                layer = n_layers - 1
                past.path_lengths[ground_column] += 1.0
                for i in range(wavelengths):
                    past.transmittance[i] *= exponential(-alpha[ground_column, i])
                _add(sums.boundary_weight[UP, face], past.transmittance, row[NOTE_WEIGHT])
            first += 1
        side = int(exits[ray, EXIT_SIDE])
        if side >= 0:
            weight = exits[ray, EXIT_WEIGHT]
            _stretch(sums, past, now, exits[ray, EXIT_LENGTH:], weight, alpha, part, layer, ground_column)
            _add(sums.boundary_weight[UP if side == 0 else DOWN, 0 if side == 0 else n_layers], now, weight)
    return sums


@kernel
def _add(total, light, weight):
    """Add light, float32[wavelengths], of a ray of a weight."""
    for i in range(light.size):
        total[i] += light[i] * weight


@kernel
def _stretch(sums, last, light, path_lengths, weight, alpha, path_fractions, layer, ground_column):
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
        left = exponential(-depth)
        mean = ONE - depth * (_HALF - depth * (_SIXTH - depth * _TWENTY_FOURTH))
        mean = mean if depth < _SERIES else (ONE - left) / max(depth, _SERIES)
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
