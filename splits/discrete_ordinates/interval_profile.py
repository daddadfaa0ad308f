"""Profiles of snowpacks between depths: absorption by material, path lengths, and errors.

The errors combine

- truncation, the difference from twice as many streams at some wavelengths;
- the statistical error of the tables of natural snow.  The relative errors of (1 − ω) and of
  (1 − g) of the grains are those with which the reflectance of weakly absorbing snow has its error
  in the table.  Their effects are those of more absorbing and of more grains.  Traced grains have
  replicates instead (jackknife);
- for wet snow, the error of the balance between dry and wet pores.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_jackknife_stderr
from splits.discrete_ordinates.grain_table import GrainTable
from splits.discrete_ordinates.granular_layers import GranularLayer
from splits.discrete_ordinates.granular_stack import (
    STREAM_NUMBERS,
    WET_ERROR,
    GranularStack,
    choose_trial_wavelengths,
    compute_optics_error,
    find_similarity_error,
    spread_truncation,
)
from splits.discrete_ordinates.pores import WET
from splits.discrete_ordinates.replicates import iterate_replicates, list_traced
from splits.discrete_ordinates.stack_profile import StackProfile, compute_pack_profile

N_MATERIALS = 3
"""Materials of a layer: air, water and grains."""
PORE_BALANCE_ERROR = 0.035
"""Relative error of the path length in water relative to that in air, half of the difference of
both estimates of the changes between them."""


class LayerDivision(NamedTuple):
    """Geometry of the layers of a snowpack, and of the parts into which depths divide them.

    Attributes
    ----------
    pore_fraction, attenuation_per_m : float, shape (layers,)
        Fraction of a path between grains in the pore space; 1 over the mean chord of the grains.
    owners : int, shape (parts,)
        Layer of each part.
    first_parts : int, shape (intervals,)
        First part of each interval.
    """

    pore_fraction: np.ndarray
    attenuation_per_m: np.ndarray
    owners: np.ndarray
    first_parts: np.ndarray


class IntervalProfile(NamedTuple):
    """Profile at depths, and in intervals between them; or the errors of all this.

    Attributes
    ----------
    downward, upward : float, shape (depths, wavelengths)
        Irradiances, see `StackProfile`.
    absorptance : float, shape (intervals, wavelengths)
    by_material : float, shape (intervals, materials, wavelengths)
        Absorptance by air, water and ice of the layers, top first.
    path_length : float, shape (intervals, wavelengths)
        In grains and pores (m).
    """

    downward: np.ndarray
    upward: np.ndarray
    absorptance: np.ndarray
    by_material: np.ndarray
    path_length: np.ndarray


class ProfileSolution(NamedTuple):
    """Profile with its errors.

    Attributes
    ----------
    profile, truncation, optics_error : IntervalProfile
        Values, and errors due to the number of streams and to the tables.
    n_streams : int
    """

    profile: IntervalProfile
    truncation: IntervalProfile
    optics_error: IntervalProfile
    n_streams: int

    def compute_error(self) -> IntervalProfile:
        """Return the combined errors."""
        return IntervalProfile(*map(np.hypot, self.truncation, self.optics_error))


def solve_profile(
    parts: GranularStack, geometry: LayerDivision, incidence: float | None, max_error: float,
    limit_irradiance: bool = True,
) -> ProfileSolution:  # fmt: skip
    """Return a profile by as many streams as an error requires.

    Parameters
    ----------
    parts : GranularStack
        With its layers divided at the depths (`GranularStack.divide`).
    geometry : LayerDivision
    incidence : float, optional
        Cosine of the beam; by default diffuse light.
    max_error : float
        The number of streams is the first whose truncation error is at most half of this.
    limit_irradiance : bool
        Whether this holds for all irradiances, or only for the reflectance and absorptances.
    """
    n_wavelengths = parts.ground.size
    trial = choose_trial_wavelengths(n_wavelengths)
    few = parts.select(trial)
    for n_streams in STREAM_NUMBERS:
        coarse, fine = (
            _compute_intervals(few, geometry, incidence, number)
            for number in (n_streams, 2 * n_streams)
        )
        difference = _subtract(coarse, fine)
        limited = [difference.upward[:1], difference.absorptance]
        limited += [difference.downward, difference.upward] if limit_irradiance else []
        if max(one.max() for one in limited) <= 0.5 * max_error:
            break
    profile = _compute_intervals(parts, geometry, incidence, n_streams)
    optics_error = _compute_grain_error(few, coarse, geometry, incidence, n_streams)
    truncation, perturbed = (
        IntervalProfile(*(spread_truncation(values, trial, n_wavelengths) for values in errors))
        for errors in (difference, optics_error)
    )
    by_reflectance = _scale_reflectance_error(profile, compute_optics_error(parts))
    table_error = IntervalProfile(*map(np.hypot, perturbed, by_reflectance))
    if parts.is_wet:
        table_error = _add_pore_balance(table_error, profile)
    return ProfileSolution(profile, truncation, table_error, n_streams)


def _compute_intervals(
    parts: GranularStack, geometry: LayerDivision, incidence: float | None, n_streams: int
) -> IntervalProfile:
    """Return the profile of a divided snowpack for a number of streams."""
    solution = compute_pack_profile(parts, incidence, n_streams)
    in_grains = np.maximum(solution.grain_absorption, 0.0)
    n_layers = geometry.pore_fraction.size
    by_layer = np.zeros((len(in_grains), n_layers, N_MATERIALS, parts.ground.size))
    rows, n_states = np.arange(len(in_grains)), solution.pore_absorption.shape[-1]
    for state in range(n_states):
        by_layer[rows, geometry.owners, state] = solution.pore_absorption[..., state]
    by_layer[rows, geometry.owners, -1] = in_grains
    by_material = by_layer.reshape(len(in_grains), -1, parts.ground.size)
    firsts = geometry.first_parts
    above = np.append(firsts, len(in_grains) - 1)
    if len(solution.downward) > len(in_grains):
        above[-1] += 1
    else:
        above = above[:-1]
    return IntervalProfile(
        solution.downward[above],
        solution.upward[above],
        np.add.reduceat(solution.absorption, firsts, axis=0),
        np.add.reduceat(by_material, firsts, axis=0),
        np.add.reduceat(_compute_path_length(parts, solution, geometry), firsts, axis=0),
    )


def _compute_path_length(
    parts: GranularStack, solution: StackProfile, geometry: LayerDivision
) -> np.ndarray:
    """Return path lengths in pores and grains (m), shape (parts, wavelengths)."""
    pore_fraction, attenuation = (
        values[geometry.owners, np.newaxis]
        for values in (geometry.pore_fraction, geometry.attenuation_per_m)
    )
    # The absorption coefficient of a grain is x times 1 over its mean chord.
    coefficient = np.stack([part.grain_absorption for part in parts.layers]) * attenuation
    in_grains = solution.grain_absorption / coefficient
    path: np.ndarray = pore_fraction * solution.pore_path.sum(axis=-1) + in_grains
    return path


def _compute_grain_error(
    parts: GranularStack, values: IntervalProfile, geometry: LayerDivision, incidence: float | None,
    n_streams: int,
) -> IntervalProfile:  # fmt: skip
    """Return the effects of the errors of single scattering, added in quadrature."""

    def compute(snowpack: GranularStack) -> IntervalProfile:
        return _compute_intervals(snowpack, geometry, incidence, n_streams)

    total = IntervalProfile(*(np.zeros_like(one) for one in values))
    for layers in _perturb_tables(parts):
        change = _subtract(compute(parts._replace(layers=layers)), values)
        total = IntervalProfile(*map(np.hypot, total, change))
    for digest in list_traced(parts.layers):
        replicates = [
            compute(parts._replace(layers=layers))
            for layers in iterate_replicates(parts.layers, digest)
        ]
        stderr = (
            compute_jackknife_stderr(np.array(field)) for field in zip(*replicates, strict=True)
        )
        total = IntervalProfile(*map(np.hypot, total, stderr))
    return total


def _perturb_tables(parts: GranularStack) -> list[list[GranularLayer]]:
    """Return the layers with more absorbing, and with more grains of natural snow, if any."""
    numbers = [i for i, one in enumerate(parts.layers) if isinstance(one.grains, GrainTable)]
    if not numbers:
        return []
    error = find_similarity_error(parts.layers[numbers[0]].contrast, parts.is_wet)
    # One number for all wavelengths: the largest error of (1 − g) is nearly the same for all.
    largest = error.max()
    absorbing, denser = list(parts.layers), list(parts.layers)
    for number in numbers:
        layer = parts.layers[number]
        absorbing[number] = layer._replace(grain_absorption=layer.grain_absorption * (1.0 + error))
        denser[number] = layer._replace(
            collisions_per_m=layer.collisions_per_m * (1.0 + largest),
            grain_absorption=layer.grain_absorption / (1.0 + largest),
        )
    return [absorbing, denser]


def _scale_reflectance_error(profile: IntervalProfile, error: np.ndarray) -> IntervalProfile:
    """Return the error of a reflectance in proportion to all values, shape (wavelengths,) given.

    That of the absorbed light is shared by the intervals and materials in proportion.
    """
    absorbed = np.maximum(1.0 - profile.upward[0], error)
    share = error / absorbed
    return IntervalProfile(
        error * profile.downward, error * profile.upward, share * profile.absorptance,
        share * profile.by_material, error * profile.path_length,
    )  # fmt: skip


def _add_pore_balance(error: IntervalProfile, profile: IntervalProfile) -> IntervalProfile:
    """Return errors with that of the path length in water, which changes the shares of materials.

    Light in water is less in air; the absorption of ice changes by less than that of water.
    """
    shape = (*profile.absorptance.shape[:1], -1, N_MATERIALS, profile.absorptance.shape[-1])
    materials = profile.by_material.reshape(shape)
    balance = PORE_BALANCE_ERROR * np.abs(materials[..., WET, :])
    added = np.repeat(balance[..., np.newaxis, :], N_MATERIALS, axis=-2)
    added = added.reshape(profile.by_material.shape)
    flux = WET_ERROR * profile.path_length
    return error._replace(
        by_material=np.hypot(error.by_material, added),
        path_length=np.hypot(error.path_length, flux),
    )


def _subtract(one: IntervalProfile, other: IntervalProfile) -> IntervalProfile:
    """Return absolute differences."""
    return IntervalProfile(*(np.abs(a - b) for a, b in zip(one, other, strict=True)))
