"""Reflection and transmission of homogeneous layers, from their modes.

In the scaled form of `splits.discrete_ordinates.modes`, light that is the same at both faces
(even), or opposite (odd), has d = Z s at the upper face, where

    Z = Y f(k) Yᵀ,    f = k tanh(k τ/2) or k coth(k τ/2),

and R ± T = (1 − Z)(1 + Z)⁻¹.  No exponential grows, nothing cancels in T, and neither thin nor
thick nor conservative layers need a case of their own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.integrals import compute_impedances, integrate_modes
from splits.discrete_ordinates.layer_optics import LayerOptics
from splits.discrete_ordinates.modes import Modes, solve_modes
from splits.discrete_ordinates.streams import Streams

MIN_THICKNESS = 1e-150
"""Thickness of layers of thickness 0."""


class LayerMatrices(NamedTuple):
    """Symmetric matrices of homogeneous layers, each of shape (..., streams, streams).

    Attributes
    ----------
    reflection, transmission : float
    even_inverse, odd_inverse : float
        (1 + Z)⁻¹ of even and of odd light.
    """

    reflection: np.ndarray
    transmission: np.ndarray
    even_inverse: np.ndarray
    odd_inverse: np.ndarray


def solve_layers(modes: Modes, thickness: np.ndarray) -> LayerMatrices:
    """Return the matrices of layers of the thickness, shape (..., 1), between their streams."""
    even, odd, difference = compute_impedances(modes.rates, thickness)
    y, y_t = modes.differences, np.swapaxes(modes.differences, -1, -2)
    unit = np.eye(y.shape[-1])
    even_inverse = np.linalg.inv(unit + (y * even[..., np.newaxis, :]) @ y_t)
    odd_inverse = np.linalg.inv(unit + (y * odd[..., np.newaxis, :]) @ y_t)
    transmission = odd_inverse @ (y * difference[..., np.newaxis, :]) @ (y_t @ even_inverse)
    matrices = even_inverse + odd_inverse - unit, transmission, even_inverse, odd_inverse
    return LayerMatrices(*(0.5 * (one + np.swapaxes(one, -1, -2)) for one in matrices))


class Slab(NamedTuple):
    """Reflection and transmission of homogeneous layers for scaled radiances.

    "Directions" are beams and directions of observation, from which no light is scattered.

    Attributes
    ----------
    reflection, transmission : float, shape (..., streams, streams)
        Symmetric; between the streams of all states.
    beam_reflection, beam_transmission : float, shape (..., directions, streams)
        Radiance in the directions of all states for the radiance of the streams.
    direct : float, shape (..., directions)
        Transmission of light that is not scattered.
    """

    reflection: np.ndarray
    transmission: np.ndarray
    beam_reflection: np.ndarray
    beam_transmission: np.ndarray
    direct: np.ndarray

    def select(self, layer: int) -> Slab:
        """Return one layer of several along the first dimension."""
        return Slab(*(array[layer] for array in self))


def solve_slab(
    optics: LayerOptics, streams: Streams, directions: np.ndarray, mode: int = 0,
    rate_factors: np.ndarray | float = 1.0,
) -> Slab:  # fmt: skip
    """Return the reflection and transmission of homogeneous layers for one azimuthal mode.

    Parameters
    ----------
    optics : LayerOptics
        With at most as many moments as streams in both hemispheres (`LayerOptics.truncate`).
    streams : Streams
        Of one hemisphere and one state.
    directions : float, shape (..., states, directions)
        Cosines of the further directions in each state, as light is refracted into water.
    mode : int
    rate_factors : float, shape (directions,)
        Factors of the extinction along the further directions.
    """
    modes = solve_modes(optics, streams, directions, mode)
    thickness = np.maximum(optics.thickness, MIN_THICKNESS)[..., np.newaxis]
    layers = solve_layers(modes, thickness)
    y_t = np.swapaxes(modes.differences, -1, -2)
    even_map, odd_map = y_t @ layers.even_inverse, y_t @ layers.odd_inverse
    shape = modes.even_kernel.shape
    rates = (optics.extinction[..., np.newaxis] / directions * rate_factors).reshape(shape[:-1])
    even_row, odd_row, gap_row = _sum_modes(modes, thickness, directions, rates)
    # Half the difference of both rows cancels in thick layers: there, that of the integrals, and of
    # the inverse matrices, which is the transmission.
    thick = (modes.rates * thickness > 1.0)[..., np.newaxis, :]
    thick_odd = np.where(thick, odd_row, 0.0)
    thin_odd = (odd_row - thick_odd) @ odd_map
    beam_transmission = np.where(thick, gap_row, even_row) @ even_map
    beam_transmission += thick_odd @ y_t @ layers.transmission - thin_odd
    beam_reflection = even_row @ even_map + thick_odd @ odd_map + thin_odd
    return Slab(
        layers.reflection, layers.transmission,
        0.5 * beam_reflection, 0.5 * beam_transmission, np.exp(-thickness * rates),
    )  # fmt: skip


def _sum_modes(
    modes: Modes, thickness: np.ndarray, directions: np.ndarray, rates: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the radiance of the even and odd modes in the directions, and the difference."""
    integrals = integrate_modes(modes.rates, thickness, rates)
    per_cosine = (1.0 / directions).reshape(*directions.shape[:-2], -1, 1)
    by_sum = per_cosine * (modes.even_kernel @ modes.sums)
    by_difference = per_cosine * (modes.odd_kernel @ modes.differences)
    return (
        by_sum * integrals.even_cosh - by_difference * integrals.even_sinh,
        by_sum * integrals.odd_sinh - by_difference * integrals.odd_cosh,
        by_sum * integrals.cosh_gap - by_difference * integrals.sinh_gap,
    )
