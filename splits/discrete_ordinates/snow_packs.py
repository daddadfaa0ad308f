"""Spectra of many snowpacks at once, from arrays of their properties."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.applicability import MAX_SATURATION
from splits.discrete_ordinates.grains import MAX_ABSORPTION
from splits.discrete_ordinates.granular_layers import GranularLayer
from splits.discrete_ordinates.granular_stack import (
    N_TRIAL_WAVELENGTHS,
    STREAM_NUMBERS,
    GranularStack,
    choose_trial_wavelengths,
    compute_optics_error,
    compute_slab_error,
    load_natural_grains,
    measure_truncation,
    solve_spectrum,
    spread_truncation,
)
from splits.materials.impurities import make_impurities
from splits.materials.library import absorption_coefficient, interpolate_ice_density
from splits.media.snow import MAX_SURFACE_AREA_M2_KG, SURFACE_AREA_KEY, Snow
from splits.media.snow_pack_input import (
    DENSITY_KEY,
    IMPURITIES_KEY,
    TEMPERATURE_KEY,
    THICKNESS_KEY,
    WATER_KEY,
)

# --------------------------------------------------------------------------------------------------
# Optical inputs of many snowpacks of natural snow, from arrays of their properties.


Layers = Mapping[str, np.ndarray]
"""Variables of `splits.SnowPacks.select_good` by name, shape (snowpacks, layers)."""


class SnowPackMaterials(NamedTuple):
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
        Absorption cross-section per mass of ice (m²/kg) for 1 ng/g, by variable.
    """

    contrast: np.ndarray
    water_index: np.ndarray
    ice_absorption: np.ndarray
    pore_absorption: np.ndarray
    impurity_absorption: dict[str, np.ndarray]

    @classmethod
    def from_wavelengths(
        cls, wavelength_nm: np.ndarray, impurities: tuple[str, ...]
    ) -> SnowPackMaterials:
        """Return the constants at wavelengths (nm), with types of impurities."""
        snow = Snow.natural(specific_surface_area_m2_kg=MAX_SURFACE_AREA_M2_KG)
        ice, water = (snow.refractive_index[name](wavelength_nm) for name in ("ice", "water"))
        wet = absorption_coefficient(water, wavelength_nm)
        per_ng_g = {
            f"{IMPURITIES_KEY}.{one.name}": one.compute_absorption_per_kg_ice(wavelength_nm)
            for one in make_impurities(dict.fromkeys(impurities, 1.0), {})
        }
        return cls(
            ice.real - 1.0, water.real, absorption_coefficient(ice, wavelength_nm),
            np.stack([np.zeros_like(wet), wet], axis=-1), per_ng_g,
        )  # fmt: skip


def find_unsupported(layers: Layers, materials: SnowPackMaterials) -> np.ndarray:
    """Return which snowpacks are outside the tables of grains, bool, shape (snowpacks,).

    They have more water than the table of wet grains, or grains that absorb too strongly.
    """
    _, saturation = compute_pores(layers)
    unsupported: np.ndarray = np.any(saturation > MAX_SATURATION, axis=1)
    for number in range(saturation.shape[1]):
        for start in range(0, unsupported.size, 1024):
            rows = slice(start, start + 1024)
            absorption = _compute_grain_absorption(layers, materials, rows, number)
            unsupported[rows] |= (absorption > MAX_ABSORPTION).any(axis=1)
    return unsupported


def compute_pores(layers: Layers) -> tuple[np.ndarray, np.ndarray]:
    """Return the porosity, and the fraction of the pores that is water."""
    porosity = 1.0 - layers[DENSITY_KEY] / interpolate_ice_density(layers[TEMPERATURE_KEY])
    # As in `Snow`, water fills at most all of the pores.
    return porosity, np.minimum(layers[WATER_KEY] / porosity, 1.0)


def make_snow_packs(
    layers: Layers, n_layers: int, ground: np.ndarray, materials: SnowPackMaterials
) -> GranularStack:
    """Return snowpacks of the same number of layers.

    Parameters
    ----------
    layers : mapping of float, shape (snowpacks, layers)
    n_layers : int
        Number of their layers, without those that repeat the last one.
    ground : float, shape (snowpacks, wavelengths)
    materials : SnowPackMaterials
    """
    porosity, saturation = compute_pores(layers)
    # 𝓔 K, with the volume fraction of ice 𝓔 and K of a quarter of the surface area.
    collisions_per_m = 0.25 * layers[DENSITY_KEY] * layers[SURFACE_AREA_KEY]
    grains = load_natural_grains(wet=bool(saturation.any()))
    return GranularStack(
        [
            GranularLayer(
                layers[THICKNESS_KEY][:, number],
                collisions_per_m[:, number],
                saturation[:, number],
                materials.contrast,
                materials.water_index,
                _compute_grain_absorption(layers, materials, slice(None), number),
                # A path between point grains includes them, see `GranularMedium.pore_fraction`.
                porosity[:, number, np.newaxis, np.newaxis] * materials.pore_absorption,
                grains,
            )
            for number in range(n_layers)
        ],
        ground,
    )


def _compute_grain_absorption(
    layers: Layers, materials: SnowPackMaterials, rows: slice, number: int
) -> np.ndarray:
    """Return the absorption coefficient of the grains times their mean chord, of one layer.

    Returns
    -------
    float, shape (snowpacks, wavelengths)
    """
    one = {name: values[rows, number, np.newaxis] for name, values in layers.items()}
    per_kg = materials.ice_absorption / interpolate_ice_density(one[TEMPERATURE_KEY])
    for name, absorption in materials.impurity_absorption.items():
        per_kg = per_kg + one[name] * absorption
    # The mean chord is 1/K, with K of a quarter of the surface per volume of ice.
    return np.asarray(4.0 * per_kg / one[SURFACE_AREA_KEY])


# --------------------------------------------------------------------------------------------------
# Spectra of many snowpacks at once, each with as many streams as one snowpack would have.

MAX_ROWS = 4096
"""Largest number of spectra times wavelengths of one solution."""
MAX_BYTES = 150_000_000
"""Approximate memory of one solution."""
WORKING_MATRICES = 25
"""Matrices of one layer that exist at the same time while it is solved."""


class SpectraSolution(NamedTuple):
    """Spectra of snowpacks, for the beams and for diffuse light (last).

    Attributes
    ----------
    reflectance, transmittance : float, shape (snowpacks, wavelengths, beams + 1)
    n_streams : int, shape (snowpacks,)
    truncation : float, shape (snowpacks, wavelengths)
        Error due to the number of streams.
    optics_error : float, shape (snowpacks, wavelengths)
        Error due to the tables of single scattering, and to the balance of wet and dry pores.
    """

    reflectance: np.ndarray
    transmittance: np.ndarray
    n_streams: np.ndarray
    truncation: np.ndarray
    optics_error: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """Error of reflectance and transmittance, shape (snowpacks, wavelengths)."""
        return np.hypot(self.truncation, self.optics_error)


def solve_spectra(
    snowpacks: GranularStack, cosines: np.ndarray, max_error: float
) -> SpectraSolution:
    """Return the spectra of several snowpacks of the same number of layers.

    Dry snowpacks are solved together, wet ones one by one.

    Parameters
    ----------
    snowpacks : GranularStack
        All dry or all wet, along the first dimension.
    cosines : float, shape (snowpacks, beams)
    max_error : float
        See `splits.discrete_ordinates.granular_stack.solve_spectrum`.
    """
    shape = n_snowpacks, n_wavelengths = snowpacks.ground.shape
    if snowpacks.is_wet:
        solved = [
            solve_spectrum(snowpacks.select(slice(None), number), cosines[number], max_error)
            for number in range(n_snowpacks)
        ]
        spectra = [
            (one.budget.reflectance, one.budget.transmittance, one.n_streams, one.truncation,
             one.optics_error) for one in solved
        ]  # fmt: skip
        return SpectraSolution(*map(np.array, zip(*spectra, strict=True)))
    reflectance, transmittance = np.empty((2, *shape, cosines.shape[-1] + 1))
    result = SpectraSolution(
        reflectance, transmittance, np.zeros(n_snowpacks, dtype=int), np.empty(shape),
        compute_optics_error(snowpacks) + np.zeros(shape),
    )  # fmt: skip
    _choose_streams(snowpacks, cosines, max_error, result)
    for n_streams in np.unique(result.n_streams):
        group = np.flatnonzero(result.n_streams == n_streams)
        for rows, columns in _split(group, n_wavelengths, len(snowpacks.layers), n_streams):
            part = snowpacks.select(columns, rows)
            budget = part.solve(cosines[rows, np.newaxis], int(n_streams))
            result.reflectance[rows, columns] = budget.reflectance
            result.transmittance[rows, columns] = budget.transmittance
    slab_error = compute_slab_error(snowpacks, result.reflectance, result.transmittance)
    result.optics_error[:] = np.hypot(result.optics_error, slab_error)
    return result


def _choose_streams(
    snowpacks: GranularStack, cosines: np.ndarray, max_error: float, result: SpectraSolution
) -> None:
    """Set the number of streams and the truncation error of dry snowpacks."""
    n_wavelengths, n_layers = snowpacks.ground.shape[1], len(snowpacks.layers)
    trial = choose_trial_wavelengths(n_wavelengths)
    pending = np.arange(len(snowpacks.ground))
    for n_streams in STREAM_NUMBERS:
        failed = []
        for rows, columns in _split(pending, trial.size, n_layers, 2 * n_streams):
            # All trial wavelengths of a snowpack are in the same part.
            part = snowpacks.select(trial[columns], rows)
            beams = cosines[rows, np.newaxis]
            difference, _, _ = measure_truncation(part, beams, n_streams)
            spread = spread_truncation(difference, trial, n_wavelengths)
            result.truncation[rows] = np.hypot(spread, snowpacks.cutoff)
            result.n_streams[rows] = n_streams
            failed.append(rows[difference.max(axis=-1) > 0.5 * max_error])
        pending = np.concatenate(failed)
        if not pending.size:
            break


def _split(
    positions: np.ndarray, n_wavelengths: int, n_layers: int, n_streams: int
) -> Iterator[tuple[np.ndarray, slice]]:
    """Iterate over parts of limited memory, as positions of snowpacks and a slice of wavelengths.

    Up to `N_TRIAL_WAVELENGTHS` wavelengths are never divided.
    """
    n_rows = min(MAX_ROWS, MAX_BYTES // estimate_bytes(n_layers, n_streams))
    n_columns = min(n_wavelengths, max(n_rows, N_TRIAL_WAVELENGTHS))
    n_snowpacks = max(1, n_rows // n_columns)
    for start in range(0, positions.size, n_snowpacks):
        for first in range(0, n_wavelengths, n_columns):
            columns = slice(first, first + n_columns)
            yield positions[start : start + n_snowpacks], columns


def estimate_bytes(n_layers: int, n_streams: int) -> int:
    """Return the memory of one wavelength of a dry snowpack while it is solved (bytes)."""
    n_radiances = n_streams // 2 + 1
    per_layer = 2 * n_radiances**2 + 2 * n_streams + 3 * n_radiances
    return 8 * (n_layers * per_layer + WORKING_MATRICES * n_radiances**2)
