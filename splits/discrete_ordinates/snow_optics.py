"""Optics of layers of snow for discrete ordinates, from tables of single scattering by grains."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from splits.discrete_ordinates.grain_table import GrainTable
from splits.discrete_ordinates.pores import DRY, WET
from splits.discrete_ordinates.slab import LayerOptics
from splits.kernels.base.scene import DRY_PORE, WET_PORE
from splits.media.snow import Snow
from splits.simulation.scene import compute_material_constants

MIN_SATURATION = 1e-9
"""Saturation of a dry layer beside a wet one, so that its wet pores have a radiance."""


def compute_snow_optics(
    layer: Snow, wavelength_nm: np.ndarray, table: GrainTable
) -> LayerOptics:
    """Return the optics of a layer of point grains, per metre.

    Parameters
    ----------
    layer : Snow
    wavelength_nm : float, shape (wavelengths,)
    table : GrainTable
        Of its grains: with one pore, for dry snow, or with two.
    """
    index, absorption = compute_material_constants(layer, wavelength_nm)
    contrast = index[:, -1].real - 1.0
    chord_absorption = absorption[:, -1] / layer.attenuation_per_m
    collisions = layer.extinction_per_m
    n_states = table.moments.shape[2]
    saturation = layer.saturation if n_states > 1 else 0.0
    moments = table.compute_moments(contrast, chord_absorption, saturation)
    thickness = np.full(wavelength_nm.size, layer.depth_m)
    pores = absorption[:, [DRY_PORE, WET_PORE][:n_states]]
    extinction = collisions + pores
    if n_states == 1:
        equilibrium = np.ones((wavelength_nm.size, 1))
        return LayerOptics(thickness, extinction, collisions * moments, equilibrium)
    fraction = max(saturation, MIN_SATURATION)
    n = index[:, WET_PORE].real
    equilibrium = np.stack([np.full(n.size, 1.0 - fraction), fraction * n**2], axis=1)
    # Light that changes the pore, n² times as much from wet as from dry pores: the mean of both
    # estimates.  The rest stays in its pore, so that nothing is lost.
    ratio, factor = n[:, np.newaxis], np.sqrt(fraction * (1.0 - fraction))
    into_wet, from_dry, from_wet = moments[:, DRY, 1], moments[:, DRY, 0], moments[:, WET, 0]
    into_dry = (from_wet - fraction * moments[:, WET, 1]) / (1.0 - fraction)
    exchange = 0.5 * (into_wet / ratio + into_dry * ratio)
    scattering = np.empty_like(moments)
    scattering[:, DRY, WET] = scattering[:, WET, DRY] = factor * exchange
    scattering[:, DRY, DRY] = from_dry - fraction * ratio * exchange
    scattering[:, WET, WET] = from_wet - (1.0 - fraction) / ratio * exchange
    return LayerOptics(thickness, extinction, collisions * scattering, equilibrium)
