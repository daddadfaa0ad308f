"""Profiles of light in dry and wet layers: fluxes, absorption by material and path lengths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_jackknife_stderr
from splits.discrete_ordinates.adding import DRY, WET, apply_rows, iterate_levels
from splits.discrete_ordinates.grains import GrainTable
from splits.discrete_ordinates.granular_layers import iterate_replicates, list_traced
from splits.discrete_ordinates.granular_stack import (
    STREAM_NUMBERS,
    WET_ERROR,
    GranularStack,
    StackElements,
    choose_trial_wavelengths,
    compute_optics_error,
    find_similarity_error,
    spread_truncation,
)
from splits.discrete_ordinates.homogeneous_layer import LayerOptics

# --------------------------------------------------------------------------------------------------
# Fluxes, absorption and path lengths within dry and wet layers.
#
# Path lengths follow from conservation of light in each state.  With the net fluxes F_s, the path
# lengths Φ_s between grains, the extinction σ_s and the scattering b_st from the state t into s,
# all integrated over the thickness of a layer,
#
#     F_s(top) − F_s(bottom) = σ_s Φ_s − ∑ b_st Φ_t,
#
# of which the sum over the states is the absorption.


def compute_pore_path(optics: LayerOptics, loss: np.ndarray, absorption: np.ndarray) -> np.ndarray:
    """Return the path lengths between grains in a layer, shape (wavelengths, states).

    Parameters
    ----------
    optics : LayerOptics
        With absorption.
    loss : float, shape (states, wavelengths)
        Net flux of each state that enters minus that which leaves.
    absorption : float, shape (wavelengths,)
    """
    # Scattering from a state into a state, in physical units.
    root = np.sqrt(optics.equilibrium)
    scattering = optics.scattering[..., 0] * root[..., :, np.newaxis] / root[..., np.newaxis, :]
    absorbing = optics.extinction - scattering.sum(axis=-2)
    if optics.extinction.shape[-1] == 1:
        return absorption[:, np.newaxis] / absorbing
    leaving = optics.extinction[..., DRY] - scattering[..., DRY, DRY]
    entering = scattering[..., DRY, WET]
    determinant = absorbing[..., DRY] * entering + absorbing[..., WET] * leaving
    dry = (absorption * entering + absorbing[..., WET] * loss[DRY]) / determinant
    wet = (absorption * leaving - absorbing[..., DRY] * loss[DRY]) / determinant
    return np.stack([dry, wet], axis=-1)


def _compute_levels(stack: StackElements, column: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return fluxes at the levels of a stack: above each element, and below the last one.

    Parameters
    ----------
    stack : StackElements
    column : int
        Of the beams and of diffuse light (last).

    Returns
    -------
    net : float, shape (levels, states, wavelengths)
        Net downward flux of each state.
    downward, upward : float, shape (levels, wavelengths)
        Of light that is transmitted, not reflected, by the element that ends at the level.
    """
    outside = stack.boundaries, stack.ground, stack.n_streams
    # States of the radiances, of streams and then of directions.
    n_states = stack.optics.extinction.shape[-1]
    sizes = stack.n_streams, stack.isotropic[0].shape[-1] - stack.n_streams
    state = np.concatenate([np.repeat(np.arange(n_states), size // n_states) for size in sizes])
    net, downward, upward = [], [], []
    above = None
    for number, (outlet, reflection) in enumerate(
        iterate_levels(stack.elements, stack.isotropic, *outside)
    ):
        row = outlet[..., column : outlet.shape[-2] if column < 0 else column + 1, :]
        radiance, reflected = stack.isotropic[number], row @ reflection
        net.append([
            apply_rows(row - reflected, radiance * (state == one))[..., 0]
            for one in range(n_states)
        ])  # fmt: skip
        element = stack.elements[number - 1] if number else None
        if element is not None and element.isotropic is None and above is not None:
            # An interface: light that it transmits, by reciprocity.
            source = apply_rows(element.transmission_up, radiance)
            downward.append(apply_rows(above, source)[..., 0])
        elif number == len(stack.elements):
            # The ground, below the lower boundary, which reflects light back to it.
            boundary = stack.boundaries[1]
            gain = 1.0 / (1.0 - stack.ground * boundary.outer_reflectance[..., -1])
            passing = gain[..., np.newaxis] * boundary.transmission * radiance
            downward.append(apply_rows(row, passing)[..., 0])
        else:
            downward.append(apply_rows(row, radiance)[..., 0])
        upward.append(downward[-1] - sum(net[-1]))
        above = row
    return np.array(net), np.array(downward), np.array(upward)


# --------------------------------------------------------------------------------------------------
# Profiles of snowpacks between depths: absorption by material, path lengths, and errors.
#
# The errors combine
#
# - truncation, the difference from twice as many streams at some wavelengths;
# - the statistical error of the tables of natural snow.  The relative errors of (1 − ω) and of (1 −
#   g) of the grains are those with which the reflectance of weakly absorbing snow has its error in
#   the table.  Their effects are those of more absorbing and of more grains.  Traced grains have
#   replicates instead (jackknife);
# - for wet snow, the error of the balance between dry and wet pores.

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
        Irradiances at the top, at each depth, and at the bottom if there is one.
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

    def find_largest(self, limit_irradiance: bool) -> float:
        """Return the largest error of reflectance and absorptances, or of all irradiances, too."""
        limited = [self.upward[:1], self.absorptance]
        limited += [self.downward, self.upward] if limit_irradiance else []
        return float(max(one.max() for one in limited))


def solve_profile(
    parts: GranularStack, geometry: LayerDivision, incidence: float | None, max_error: float,
    limit_irradiance: bool = True,
) -> tuple[IntervalProfile, IntervalProfile, IntervalProfile, int]:  # fmt: skip
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

    Returns
    -------
    profile, truncation, optics_error : IntervalProfile
        Values, and errors due to the number of streams and to the tables.
    n_streams : int
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
        if difference.find_largest(limit_irradiance) <= 0.5 * max_error:
            break
    profile = _compute_intervals(parts, geometry, incidence, n_streams)
    optics_error = _compute_grain_error(few, coarse, geometry, incidence, n_streams)
    truncation, perturbed = (
        IntervalProfile(*(spread_truncation(values, trial, n_wavelengths) for values in errors))
        for errors in (difference, optics_error)
    )
    # The error of a reflectance changes all values in proportion.  That of the absorbed light is
    # shared by the intervals and materials.
    error = compute_optics_error(parts)
    share = error / np.maximum(1.0 - profile.upward[0], error)
    by_reflectance = (
        error * profile.downward, error * profile.upward, share * profile.absorptance,
        share * profile.by_material, error * profile.path_length,
    )  # fmt: skip
    table_error = IntervalProfile(*map(np.hypot, perturbed, by_reflectance))
    if parts.is_wet:
        # The path length in water changes the shares of materials.  Light in water is less in air;
        # the absorption of ice changes by less than that of water.
        shape = (len(profile.absorptance), -1, N_MATERIALS, n_wavelengths)
        in_water = profile.by_material.reshape(shape)[..., WET, np.newaxis, :]
        balance = np.repeat(PORE_BALANCE_ERROR * np.abs(in_water), N_MATERIALS, axis=-2)
        balance = balance.reshape(profile.by_material.shape)
        table_error = table_error._replace(
            by_material=np.hypot(table_error.by_material, balance),
            path_length=np.hypot(table_error.path_length, WET_ERROR * profile.path_length),
        )
    return profile, truncation, table_error, n_streams


def _compute_intervals(
    parts: GranularStack, geometry: LayerDivision, incidence: float | None, n_streams: int
) -> IntervalProfile:
    """Return the profile of a divided snowpack for a number of streams.

    It is for an irradiance of 1 on the horizontal, under one beam or under diffuse light.
    """
    column = -1 if incidence is None else 0
    stack = parts.build(np.array([] if incidence is None else [incidence]), n_streams)
    budget = stack.compute_budget(with_absorption=True)
    net, downward, upward = _compute_levels(stack, column)
    # Levels above the layers: interfaces have none of their own.
    levels = [i for i, element in enumerate(stack.elements) if element.isotropic is not None]
    absorption = budget.absorption[..., column]
    by_layer = np.zeros((
        len(levels), geometry.pore_fraction.size, N_MATERIALS, parts.ground.size
    ))  # fmt: skip
    path_length = np.empty_like(absorption)
    optics = [LayerOptics(*one) for one in zip(*stack.optics, strict=True)]
    for part, (layer, owner) in enumerate(zip(parts.layers, geometry.owners, strict=True)):
        loss = net[levels[part]] - net[levels[part] + 1]
        path = compute_pore_path(optics[part], loss, absorption[part])
        in_pores = path * layer.pore_absorption[..., : path.shape[-1]]
        in_grains = absorption[part] - in_pores.sum(axis=-1)
        by_layer[part, owner, : path.shape[-1]] = in_pores.T
        by_layer[part, owner, -1] = np.maximum(in_grains, 0.0)
        # The absorption coefficient of a grain is x times 1 over its mean chord.
        coefficient = layer.grain_absorption * geometry.attenuation_per_m[owner]
        between_grains = geometry.pore_fraction[owner] * path.sum(axis=-1)
        path_length[part] = between_grains + in_grains / coefficient
    firsts = geometry.first_parts
    depths = np.array(levels)[firsts]
    bottom, downward, upward = downward[-1:], downward[depths], upward[depths]
    # Above the top are the incident light and the reflectance.
    downward[0], upward[0] = 1.0, budget.reflectance[..., column]
    if np.isfinite(parts.layers[-1].depth_m):
        downward = np.concatenate([downward, bottom])
        upward = np.concatenate([upward, parts.ground * bottom])
    by_material = by_layer.reshape(len(levels), -1, parts.ground.size)
    in_intervals = (
        np.add.reduceat(values, firsts, axis=0) for values in (absorption, by_material, path_length)
    )
    return IntervalProfile(downward, upward, *in_intervals)


def _compute_grain_error(
    parts: GranularStack, values: IntervalProfile, geometry: LayerDivision, incidence: float | None,
    n_streams: int,
) -> IntervalProfile:  # fmt: skip
    """Return the effects of the errors of single scattering, added in quadrature."""

    def compute(snowpack: GranularStack) -> IntervalProfile:
        return _compute_intervals(snowpack, geometry, incidence, n_streams)

    total = IntervalProfile(*(np.zeros_like(one) for one in values))
    tabulated = [i for i, one in enumerate(parts.layers) if isinstance(one.grains, GrainTable)]
    if tabulated:
        # More absorbing, and more grains of natural snow.
        absorbing, denser = list(parts.layers), list(parts.layers)
        error = find_similarity_error(parts.layers[tabulated[0]].contrast, parts.is_wet)
        # One number for all wavelengths: the largest error of (1 − g) is nearly the same for all.
        more = 1.0 + error.max()
        for number in tabulated:
            layer = parts.layers[number]
            absorption, collisions = layer.grain_absorption, layer.collisions_per_m
            absorbing[number] = layer._replace(grain_absorption=absorption * (1.0 + error))
            denser[number] = layer._replace(
                collisions_per_m=collisions * more, grain_absorption=absorption / more
            )
        for layers in (absorbing, denser):
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


def _subtract(one: IntervalProfile, other: IntervalProfile) -> IntervalProfile:
    """Return absolute differences."""
    return IntervalProfile(*(np.abs(a - b) for a, b in zip(one, other, strict=True)))
