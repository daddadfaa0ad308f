"""Optical inputs of many snowpacks of natural snow, from arrays of their properties."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.applicability import MAX_SATURATION, find_obstacle
from splits.discrete_ordinates.grain_table import MAX_ABSORPTION
from splits.discrete_ordinates.granular_layers import GranularLayer
from splits.discrete_ordinates.granular_stack import GranularStack, load_natural_grains
from splits.materials.density import interpolate_ice_density
from splits.materials.impurities import make_impurities
from splits.materials.lookup import absorption_coefficient
from splits.media.measured_inputs import MAX_SURFACE_AREA_M2_KG
from splits.media.snow import Snow
from splits.media.snow_pack_arrays import SnowPackArrays


class PackMaterials(NamedTuple):
    """Optical constants of natural snow at wavelengths, common to all snowpacks.

    Attributes
    ----------
    contrast, water_index : float, shape (wavelengths,)
        See `GranularLayer`.
    ice_absorption : float, shape (wavelengths,)
        Absorption coefficient (1/m).
    pore_absorption : float, shape (wavelengths, 2)
        Absorption coefficients (1/m) of dry pores, 0, and of water in wet ones.
    impurity_absorption : dict of float, shape (wavelengths,)
        Absorption cross-section per mass of ice (m²/kg) for 1 ng/g, by type.
    """

    contrast: np.ndarray
    water_index: np.ndarray
    ice_absorption: np.ndarray
    pore_absorption: np.ndarray
    impurity_absorption: dict[str, np.ndarray]

    @classmethod
    def from_wavelengths(
        cls, wavelength_nm: np.ndarray, impurities: tuple[str, ...]
    ) -> PackMaterials:
        """Return the constants at wavelengths (nm), with types of impurities."""
        snow = Snow.natural(specific_surface_area_m2_kg=MAX_SURFACE_AREA_M2_KG)
        ice, water = (snow.refractive_index[name](wavelength_nm) for name in ("ice", "water"))
        wet = absorption_coefficient(water, wavelength_nm)
        per_ng_g = {
            one.name: one.compute_absorption_per_kg_ice(wavelength_nm)
            for one in make_impurities(dict.fromkeys(impurities, 1.0), {})
        }
        return cls(
            ice.real - 1.0, water.real, absorption_coefficient(ice, wavelength_nm),
            np.stack([np.zeros_like(wet), wet], axis=-1), per_ng_g,
        )  # fmt: skip


def find_spectral_obstacle(wavelength_nm: np.ndarray, *, wet: bool) -> str | None:
    """Return why discrete ordinates do not apply at some wavelength (nm) to any natural snow."""
    water = 1e-3 if wet else 0.0
    fine = Snow.natural(
        specific_surface_area_m2_kg=MAX_SURFACE_AREA_M2_KG, liquid_water_content=water
    )
    return find_obstacle(fine, wavelength_nm)


def find_unsupported(arrays: SnowPackArrays, materials: PackMaterials) -> np.ndarray:
    """Return which snowpacks are outside the tables of grains, bool, shape (snowpacks,).

    They have more water than the table of wet grains, or grains that absorb too strongly.
    """
    saturation = compute_saturation(arrays)
    unsupported: np.ndarray = np.any(saturation > MAX_SATURATION, axis=1)
    for layer in range(arrays.thickness_m.shape[1]):
        for start in range(0, unsupported.size, 1024):
            rows = slice(start, start + 1024)
            absorption = _compute_grain_absorption(arrays, materials, rows, layer)
            unsupported[rows] |= (absorption > MAX_ABSORPTION).any(axis=1)
    return unsupported


def compute_saturation(arrays: SnowPackArrays) -> np.ndarray:
    """Return the fraction of the pore space that is water, shape (snowpacks, layers)."""
    porosity = 1.0 - arrays.density_kg_m3 / interpolate_ice_density(arrays.temperature_c)
    # As in `Snow`, water fills at most all of the pores.
    return np.minimum(arrays.liquid_water_content / porosity, 1.0)


def make_snowpacks(
    arrays: SnowPackArrays, rows: np.ndarray, ground: np.ndarray, materials: PackMaterials
) -> GranularStack:
    """Return some of the snowpacks, all of the same number of layers.

    Parameters
    ----------
    arrays : SnowPackArrays
    rows : int, shape (snowpacks,)
        Their positions in the arrays.
    ground : float, shape (snowpacks, wavelengths)
    materials : PackMaterials
    """
    saturation = compute_saturation(arrays)[rows]
    ice_density = interpolate_ice_density(arrays.temperature_c[rows])
    porosity = 1.0 - arrays.density_kg_m3[rows] / ice_density
    layers = []
    for number in range(int(arrays.n_layers[rows[0]])):
        density, area = (
            values[rows, number]
            for values in (arrays.density_kg_m3, arrays.specific_surface_area_m2_kg)
        )
        layers.append(
            GranularLayer(
                arrays.thickness_m[rows, number],
                # 𝓔 K, with the volume fraction of ice 𝓔 and K of a quarter of the surface area.
                0.25 * density * area,
                saturation[:, number],
                materials.contrast,
                materials.water_index,
                _compute_grain_absorption(arrays, materials, rows, number),
                # A path between point grains includes them, see `GranularMedium.pore_fraction`.
                porosity[:, number, np.newaxis, np.newaxis] * materials.pore_absorption,
                load_natural_grains(wet=bool(saturation.any())),
            )
        )
    return GranularStack(layers, ground)


def _compute_grain_absorption(
    arrays: SnowPackArrays, materials: PackMaterials, rows: np.ndarray | slice, layer: int
) -> np.ndarray:
    """Return the absorption coefficient of the grains times their mean chord, of one layer.

    Returns
    -------
    float, shape (snowpacks, wavelengths)
    """
    ice_density = interpolate_ice_density(arrays.temperature_c[rows, layer])[:, np.newaxis]
    per_kg = materials.ice_absorption / ice_density
    for kind, absorption in materials.impurity_absorption.items():
        per_kg = per_kg + arrays.impurities_ng_g[kind][rows, layer, np.newaxis] * absorption
    # The mean chord is 1/K, with K of a quarter of the surface per volume of ice.
    area = arrays.specific_surface_area_m2_kg[rows, layer, np.newaxis]
    return np.asarray(4.0 * per_kg / area)
