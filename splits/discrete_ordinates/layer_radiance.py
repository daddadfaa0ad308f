"""Radiance that a homogeneous layer reflects and transmits between two directions.

It follows from invariance (Ambartsumian; Chandrasekhar 1950, Radiative Transfer): a thin layer on
top of a homogeneous slab has the same effect as a thin layer below it.  Let r be the extinction
along a direction, e^(−rτ) its direct transmission δ, and w and c the scattering within a hemisphere
and between both, in the scaled form of `splits.discrete_ordinates.modes`.  With the diffuse
reflection R and transmission T between directions o and e and the streams,

    (r_o + r_e) R_oe = c_oe (1 − δ_o δ_e) + [w R + R w + R c R − (δ + T) c (δ + T)]_oe,
    (r_e − r_o) T_oe = w_oe (δ_o − δ_e) + [T w − w T + (δ + T) c R − R c (δ + T)]_oe,

where brackets contain no light scattered once, which the first terms are.  It is left out of the
modes and computed at the scattering angle, see `splits.discrete_ordinates.direct_light`.

Where r_e ≈ r_o, T_oe is interpolated between other rates of the direction o.  T_oe is a smooth
function of this rate, as the scattering into the direction o stays the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.adding import Element, make_isotropic
from splits.discrete_ordinates.layer_optics import LayerOptics
from splits.discrete_ordinates.modes import compute_scattering
from splits.discrete_ordinates.slab import Slab, solve_slab
from splits.discrete_ordinates.streams import Streams

RATE_SHIFT = 1e-3
"""Relative shift of rates for interpolation."""
SHIFTS = RATE_SHIFT * np.array([0.0, -2.0, -1.0, 1.0, 2.0])
SHIFT_WEIGHTS = np.array([0.0, -1.0, 4.0, 4.0, -1.0]) / 6.0
"""Weights of the interpolation to a shift of 0, by a polynomial of the third degree."""


class LayerRadiance(NamedTuple):
    """Layers, and light that they scatter out of beams along the views, for one azimuthal mode.

    Radiances are those of the streams and of the beams, as in `splits.discrete_ordinates.adding`,
    without light scattered once between two directions.

    Attributes
    ----------
    elements : list of Element
    isotropic : float, shape (layers, ..., radiances)
    reflection, transmission : float, shape (layers, ..., radiances, states, views)
    """

    elements: list[Element]
    isotropic: np.ndarray
    reflection: np.ndarray
    transmission: np.ndarray


class _Directions(NamedTuple):
    """Directions of all states along one dimension, shape (..., directions) or (..., streams)."""

    reflection: np.ndarray
    transmission: np.ndarray
    direct: np.ndarray
    within: np.ndarray
    across: np.ndarray
    rates: np.ndarray


def solve_layer_radiance(
    optics: LayerOptics, streams: Streams, beams: np.ndarray, views: np.ndarray, mode: int
) -> LayerRadiance:
    """Return the reflection and transmission of layers between streams, beams and views.

    Parameters
    ----------
    optics : LayerOptics
        Truncated; layers along the first dimension.
    streams : Streams
    beams, views : float, shape (..., states, beams) and (..., states, views)
        Cosines in each state.
    mode : int
    """
    n_beams, n_shifted = beams.shape[-1], SHIFTS.size * beams.shape[-1]
    directions = np.concatenate([np.tile(beams, SHIFTS.size), views], axis=-1)
    factors = np.ones(directions.shape[-1])
    factors[:n_shifted] += np.repeat(SHIFTS, n_beams)
    slab = solve_slab(optics, streams, directions, mode, factors)
    (even, even_into), (odd, odd_into) = compute_scattering(optics, streams, directions, mode)
    per_cosine = (0.5 / directions).reshape(*directions.shape[:-2], -1, 1)
    rates = optics.extinction[..., np.newaxis] / directions * factors
    combined = _Directions(
        slab.beam_reflection, slab.beam_transmission, slab.direct[..., np.newaxis],
        per_cosine * (even_into + odd_into), per_cosine * (even_into - odd_into),
        rates.reshape(*rates.shape[:-2], -1, 1),
    )  # fmt: skip

    def select(chosen: slice) -> _Directions:
        return _Directions(*(_select(values, rates.shape[-2:], chosen) for values in combined))

    shifted, own, seen = map(select, (slice(n_shifted), slice(n_beams), slice(n_shifted, None)))
    across = 0.5 * (even - odd)
    reflected = _reflect(own, seen, across)
    transmitted = _transmit(shifted, seen, across, n_beams)
    isotropic = make_isotropic(optics, streams, n_beams)
    layers = Slab(
        slab.reflection, slab.transmission, own.reflection, own.transmission, own.direct[..., 0]
    )
    elements = [
        Element.from_slab(layers.select(layer), isotropic[layer])
        for layer in range(optics.thickness.shape[0])
    ]
    into_all = (
        np.concatenate([_transpose(into_streams), into_beams], axis=-2)
        for into_streams, into_beams in (
            (seen.reflection, reflected), (seen.transmission, transmitted)
        )
    )  # fmt: skip
    reflection, transmission = (
        values.reshape(*values.shape[:-1], *views.shape[-2:]) for values in into_all
    )
    return LayerRadiance(elements, isotropic, reflection, transmission)


def _select(values: np.ndarray, shape: tuple[int, ...], chosen: slice) -> np.ndarray:
    """Return some of the directions of each state."""
    by_state = values.reshape(*values.shape[:-2], *shape, values.shape[-1])[..., chosen, :]
    return by_state.reshape(*values.shape[:-2], -1, values.shape[-1])


def _reflect(own: _Directions, seen: _Directions, across: np.ndarray) -> np.ndarray:
    """Return R without light scattered once, see the module."""
    numerator = (
        own.within @ _transpose(seen.reflection)
        + own.reflection @ _transpose(seen.within + seen.reflection @ across)
        - (own.direct * own.across) @ _transpose(seen.transmission)
        - own.transmission @ _transpose(seen.direct * seen.across + seen.transmission @ across)
    )
    reflected: np.ndarray = numerator / (own.rates + _transpose(seen.rates))
    return reflected


def _transmit(
    shifted: _Directions, seen: _Directions, across: np.ndarray, n_beams: int
) -> np.ndarray:
    """Return T without light scattered once, see the module."""
    numerator = (
        shifted.transmission @ _transpose(seen.within)
        - shifted.within @ _transpose(seen.transmission)
        + (shifted.transmission @ across + shifted.direct * shifted.across)
        @ _transpose(seen.reflection)
        - shifted.reflection @ _transpose(seen.transmission @ across + seen.direct * seen.across)
    )
    difference = _transpose(seen.rates) - shifted.rates
    values = numerator / np.where(difference == 0.0, 1.0, difference)
    values, difference, rates = (
        np.moveaxis(one.reshape(*one.shape[:-2], -1, SHIFTS.size, n_beams, one.shape[-1]), -3, 0)
        for one in (values, difference, shifted.rates)
    )
    is_near = np.abs(difference[0]) < 0.5 * RATE_SHIFT * rates[0]
    transmitted = np.where(is_near, np.tensordot(SHIFT_WEIGHTS, values, 1), values[0])
    return transmitted.reshape(*transmitted.shape[:-3], -1, transmitted.shape[-1])


def _transpose(matrix: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrix, -1, -2)
