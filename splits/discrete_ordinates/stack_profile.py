"""Fluxes, absorption and path lengths within dry and wet layers.

Path lengths follow from conservation of light in each state.  With the net fluxes F_s, the path
lengths Φ_s between grains, the extinction σ_s and the scattering b_st from the state t into s, all
integrated over the thickness of a layer,

    F_s(top) − F_s(bottom) = σ_s Φ_s − ∑ b_st Φ_t,

of which the sum over the states is the absorption.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.adding import apply_rows, iterate_levels
from splits.discrete_ordinates.granular_stack import GranularStack, StackElements
from splits.discrete_ordinates.layer_optics import LayerOptics
from splits.discrete_ordinates.pores import DRY, WET


class StackProfile(NamedTuple):
    """Fluxes at depths and absorption in the parts of a snowpack between them.

    All are for an irradiance of 1 on the horizontal, under one beam or under diffuse light.

    Attributes
    ----------
    downward, upward : float, shape (depths, wavelengths)
        At the top, at each depth, and at the bottom if there is one.
    absorption : float, shape (parts, wavelengths)
    pore_path : float, shape (parts, wavelengths, states)
        Path length between grains (m), in dry and in wet pores.
    pore_absorption : float, shape (parts, wavelengths, states)
    grain_absorption : float, shape (parts, wavelengths)
    """

    downward: np.ndarray
    upward: np.ndarray
    absorption: np.ndarray
    pore_path: np.ndarray
    pore_absorption: np.ndarray
    grain_absorption: np.ndarray


class _Levels(NamedTuple):
    """Values at the levels of a stack: above each element, and below the last one.

    Attributes
    ----------
    net : float, shape (levels, states, wavelengths)
        Net downward flux of each state.
    downward, upward : float, shape (levels, wavelengths)
        Of light that is transmitted, not reflected, by the element that ends at the level.
    """

    net: np.ndarray
    downward: np.ndarray
    upward: np.ndarray


def compute_pack_profile(
    snowpack: GranularStack, incidence: float | None, n_streams: int
) -> StackProfile:
    """Return the profile of a snowpack whose layers are divided at the depths of interest.

    Parameters
    ----------
    snowpack : GranularStack
        See `GranularStack.divide`.
    incidence : float, optional
        Cosine of the beam; by default diffuse light.
    n_streams : int
    """
    cosines = np.array([] if incidence is None else [incidence])
    column = -1 if incidence is None else 0
    stack = snowpack.build(cosines, n_streams)
    budget, levels = stack.compute_budget(), _compute_levels(stack, column)
    # Levels above the layers: interfaces have none of their own.
    layers = [i for i, element in enumerate(stack.elements) if element.emission is not None]
    absorption = budget.absorption[..., column]
    paths, in_pores, in_grains = [], [], []
    for part, (level, layer) in enumerate(zip(layers, snowpack.layers, strict=True)):
        optics, loss = stack.optics[part], levels.net[level] - levels.net[level + 1]
        path = compute_pore_path(optics, loss, absorption[part])
        by_pore = path * layer.pore_absorption[..., : path.shape[-1]]
        paths.append(path)
        in_pores.append(by_pore)
        in_grains.append(absorption[part] - by_pore.sum(axis=-1))
    downward, upward = levels.downward[layers], levels.upward[layers]
    # Above the top are the incident light and the reflectance.
    downward[0], upward[0] = 1.0, budget.reflectance[..., column]
    if np.isfinite(snowpack.layers[-1].depth_m):
        bottom = levels.downward[-1:]
        downward = np.concatenate([downward, bottom])
        upward = np.concatenate([upward, snowpack.ground * bottom])
    return StackProfile(
        downward, upward, absorption, np.stack(paths), np.stack(in_pores), np.stack(in_grains)
    )


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


def _compute_levels(stack: StackElements, column: int) -> _Levels:
    """Return the values at the levels, of one column of the beams and of diffuse light (last)."""
    outside = stack.boundaries, stack.ground, stack.n_streams
    state = _label_states(stack)
    net, downward, upward = [], [], []
    above = None
    for number, (outlet, reflection) in enumerate(
        iterate_levels(stack.elements, stack.isotropic, *outside)
    ):
        row = outlet[..., column : outlet.shape[-2] if column < 0 else column + 1, :]
        radiance, reflected = stack.isotropic[number], row @ reflection
        net.append([
            apply_rows(row - reflected, radiance * (state == one))[..., 0]
            for one in range(state.max() + 1)
        ])  # fmt: skip
        element = stack.elements[number - 1] if number else None
        if element is not None and element.emission is None and above is not None:
            # An interface: light that it transmits, by reciprocity.
            source = apply_rows(element.transmission_up, radiance)
            downward.append(apply_rows(above, source)[..., 0])
        elif number == len(stack.elements):
            downward.append(_receive_at_ground(stack, row))
        else:
            downward.append(apply_rows(row, radiance)[..., 0])
        upward.append(downward[-1] - sum(net[-1]))
        above = row
    return _Levels(np.array(net), np.array(downward), np.array(upward))


def _receive_at_ground(stack: StackElements, row: np.ndarray) -> np.ndarray:
    """Return the irradiance of the ground, below the lower boundary."""
    bottom = stack.boundaries[1]
    gain = 1.0 / (1.0 - stack.ground * bottom.outer_reflectance[..., -1])
    passing = gain[..., np.newaxis] * bottom.transmission * stack.isotropic[-1]
    return apply_rows(row, passing)[..., 0]


def _label_states(stack: StackElements) -> np.ndarray:
    """Return the state of each radiance, of streams and then of directions."""
    n_states = stack.optics[0].extinction.shape[-1]
    n_directions = stack.isotropic[0].shape[-1] - stack.n_streams
    states = np.arange(n_states)
    return np.concatenate([
        np.repeat(states, stack.n_streams // n_states), np.repeat(states, n_directions // n_states)
    ])  # fmt: skip
