"""Inverse of the group velocity of light along the paths that kernels record."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from splits.instruments.delay_record import SPEED_OF_LIGHT
from splits.kernels.scene import WET_PORE
from splits.materials.group_index import (
    WATER_RANGE_NM,
    GroupIndex,
    compute_group_index,
    compute_temperature_effect,
    compute_water_group_index,
)
from splits.materials.library import is_dataset
from splits.media.medium import Medium
from splits.media.snow import Snow
from splits.simulation.scene import compute_path_fractions


class Slowness(NamedTuple):
    """Inverse of the group velocity, per recorded path length in each material.

    Attributes
    ----------
    value, stderr : float, shape (wavelengths, columns)
        s/m; 0 for the ground.
    path_fractions : float, shape (columns,)
        Fraction of the recorded path length that lies in the material; 0 for the ground.
    """

    value: np.ndarray
    stderr: np.ndarray
    path_fractions: np.ndarray


def compute_slowness(medium: Medium, wavelengths: np.ndarray) -> Slowness:
    """Return the inverse of the group velocity in the materials of a medium (nm) and its ground."""
    group = compute_group_index(medium.compute_refractive_indices, wavelengths)
    _use_formulation_of_water(group, medium, wavelengths)
    fractions = compute_path_fractions(medium)
    values = [one * fractions / SPEED_OF_LIGHT for one in group]
    if medium.reflecting_ground is not None:
        values = [np.pad(one, ((0, 0), (0, 1))) for one in values]
        fractions = np.append(fractions, 0.0)
    return Slowness(values[0], values[1], fractions)


def _use_formulation_of_water(group: GroupIndex, medium: Medium, wavelengths: np.ndarray) -> None:
    """Set the group index of water to that of IAPWS, unless the user gave its refractive index."""
    layers: Any = medium.scene_layers
    rows = (wavelengths >= WATER_RANGE_NM[0]) & (wavelengths <= WATER_RANGE_NM[1])
    first = 0
    for layer in layers:
        has_water = layer.has_grains and layer.wet_fraction > 0.0
        if has_water and is_dataset("water", layer.refractive_index["water"]):
            water = compute_water_group_index(wavelengths[rows], isinstance(layer, Snow))
            for values, replacement in zip(group, water, strict=True):
                values[rows, first + WET_PORE] = replacement
            # The tables are those of warmer water.
            others = np.clip(wavelengths[~rows], *WATER_RANGE_NM)
            stderr = group.stderr[~rows, first + WET_PORE]
            effect = compute_temperature_effect(others)
            group.stderr[~rows, first + WET_PORE] = np.hypot(stderr, effect)
        first += len(layer.list_materials())
