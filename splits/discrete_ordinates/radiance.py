"""Radiance that plane layers reflect and transmit between two directions.

Light that is not scattered, or only once, is known exactly for each pair of directions.  The rest
is smooth, and a sum of azimuthal modes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legval

from splits.discrete_ordinates.adding import (
    Boundary,
    Element,
    Faces,
    add_above,
    make_faces,
    make_isotropic,
    make_outlet,
    reflect_at_bottom,
    refract_directions,
)
from splits.discrete_ordinates.homogeneous_layer import (
    LayerOptics,
    Slab,
    Streams,
    compute_scattering,
    convolve_exponentials,
    solve_slab,
)

# --------------------------------------------------------------------------------------------------
# Directions outside plane layers, and the layers with all that refracts light on its way.

REFLECTED, TRANSMITTED = range(2)


class Geometry(NamedTuple):
    """Directions of light and of observation, in air.

    Attributes
    ----------
    beams, views : float, shape (beams,) and (views,)
        Cosines with the normal; of views with the downward normal for transmitted light.
    azimuths : float, shape (azimuths,)
        Between the horizontal directions in which the light travels before and after, in radians: 0
        is forward, π backward.
    """

    beams: np.ndarray
    views: np.ndarray
    azimuths: np.ndarray

    @property
    def cosines(self) -> np.ndarray:
        """Cosines of the beams, followed by those of the views."""
        return np.concatenate([self.beams, self.views])

    def compute_scattering_cosines(
        self,
        side: int = REFLECTED,
        beams: np.ndarray | None = None,
        views: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the cosines of the scattering angle, shape (..., beams, views, azimuths).

        Parameters
        ----------
        side : int
            `REFLECTED` or `TRANSMITTED`.
        beams, views : float, shape (..., beams) and (..., views), optional
            Cosines within a layer; by default those in air.
        """
        beam = (self.beams if beams is None else beams)[..., :, np.newaxis]
        view = (self.views if views is None else views)[..., np.newaxis, :]
        sines = np.sqrt((1.0 - beam**2) * (1.0 - view**2))[..., np.newaxis]
        vertical = (beam * view)[..., np.newaxis]
        turned = vertical if side == TRANSMITTED else -vertical
        return np.clip(sines * np.cos(self.azimuths) + turned, -1.0, 1.0)


class PlaneLayers(NamedTuple):
    """Layers over a Lambertian ground, dry or with water in a part of the pores.

    Attributes
    ----------
    optics : LayerOptics
        Top first, along the first dimension.
    ground : float, shape (...)
        Albedo of the ground; 0 for an open lower boundary.
    wet_fractions : sequence of float
        Of each layer, above 0; none for layers of one state.
    water_index : float, shape (...), or None
        Refractive index of water, where there are two states.
    """

    optics: LayerOptics
    ground: np.ndarray
    wet_fractions: Sequence[float] = ()
    water_index: np.ndarray | None = None

    def make_faces(self, streams: Streams, cosines: np.ndarray) -> Faces:
        """Return the interfaces and boundaries, for further directions in air."""
        n_layers = self.optics.thickness.shape[0]
        return make_faces(n_layers, self.wet_fractions, self.water_index, streams, cosines)

    def refract(self, cosines: np.ndarray) -> np.ndarray:
        """Return the cosines within the layers, shape (..., states, directions)."""
        return refract_directions(cosines, self.water_index)

    def truncate(self, streams: int) -> PlaneLayers:
        """Return truncated layers (`LayerOptics.truncate`), with moments of 0 if unknown."""
        optics = self.optics
        missing = max(streams + 1 - optics.scattering.shape[-1], 0)
        padding = [(0, 0)] * (optics.scattering.ndim - 1) + [(0, missing)]
        padded = optics._replace(scattering=np.pad(optics.scattering, padding))
        return self._replace(optics=padded.truncate(streams))


# --------------------------------------------------------------------------------------------------
# Light that is not scattered, or only once, in plane layers with refracting faces.

PhaseFunction = Callable[[int, int, np.ndarray], np.ndarray]
"""Scattering coefficients times phase functions between two states, shape (layers, ..., beams,
views, azimuths), at the cosines of scattering angles (..., beams, views, azimuths)."""


class DirectLight(NamedTuple):
    """Beams that enter a sample, where they are not scattered.

    Attributes
    ----------
    falling, rising : float, shape (layers, ..., directions, states)
        Scaled amplitudes at the top of each layer downwards, and at its bottom upwards.
    reflected, transmitted : float, shape (..., directions)
        Fractions that leave on the side of the beam, and on the other side.
    """

    falling: np.ndarray
    rising: np.ndarray
    reflected: np.ndarray
    transmitted: np.ndarray

    def select(self, directions: slice) -> DirectLight:
        """Return some of the directions."""
        return DirectLight(
            self.falling[..., directions, :], self.rising[..., directions, :],
            self.reflected[..., directions], self.transmitted[..., directions],
        )  # fmt: skip


class _End(NamedTuple):
    """Boundary of the sample for the states of each direction, shape (..., directions, states)."""

    reflection: np.ndarray
    entering: np.ndarray
    leaving: np.ndarray
    outer_reflectance: np.ndarray


def trace_direct_light(layers: PlaneLayers, cosines: np.ndarray) -> tuple[DirectLight, DirectLight]:
    """Return the direct light of beams that enter at the top, and that enter at the bottom.

    Parameters
    ----------
    layers : PlaneLayers
    cosines : float, shape (directions,)
        In air.
    """
    optics, directions = layers.optics, layers.refract(cosines)
    interfaces, boundaries = layers.make_faces(Streams.from_number(2), cosines)
    depth = (optics.thickness[..., np.newaxis] * optics.extinction)[..., np.newaxis]
    direct = np.swapaxes(np.exp(-depth / directions), -1, -2)
    n_states, shape = direct.shape[-1], direct.shape[1:]
    elements: list[Element] = []
    is_layer: list[bool] = []
    for passing, interface in zip(direct, [*interfaces, None], strict=True):
        matrix = passing[..., np.newaxis] * np.eye(n_states)
        elements.append(Element(0.0 * matrix, 0.0 * matrix, matrix, matrix, None))
        is_layer.append(True)
        if interface is not None:
            elements.append(_select_directions(interface, n_states))
            is_layer.append(False)
    top, bottom = (
        _make_end(boundary, np.sqrt(optics.equilibrium)[end], shape)
        for boundary, end in zip(boundaries, (0, -1), strict=True)
    )
    (falling, rising), outside = _trace(elements, top, bottom)
    from_top = DirectLight(falling[:-1][is_layer], rising[1:][is_layer], *outside)
    flipped = [
        Element(
            one.reflection_below, one.reflection_above, one.transmission_up, one.transmission_down,
            None,
        )
        for one in reversed(elements)
    ]  # fmt: skip
    (rising, falling), outside = _trace(flipped, bottom, top)
    from_bottom = DirectLight(falling[:0:-1][is_layer], rising[-2::-1][is_layer], *outside)
    return from_top, from_bottom


def scatter_once(layers: PlaneLayers, geometry: Geometry, evaluate: PhaseFunction) -> np.ndarray:
    """Return the BRDF and the BTDF of light scattered once, shape (2, ..., beams, views, azimuths).

    Parameters
    ----------
    layers : PlaneLayers
        With the extinction after truncation.
    geometry : Geometry
    evaluate : callable
        Phase function before truncation.
    """
    optics, n_beams = layers.optics, geometry.beams.size
    directions = layers.refract(geometry.cosines)
    both = trace_direct_light(layers, geometry.cosines)
    # The response outside to light that leaves a layer is, by reciprocity, the light that enters.
    beam = both[0].select(slice(n_beams))
    views = [one.select(slice(n_beams, None)) for one in both]
    thickness = optics.thickness[..., np.newaxis, np.newaxis]
    shape = (n_beams, geometry.views.size, geometry.azimuths.size)
    total = np.zeros((2, *optics.thickness.shape[1:], *shape))
    for a, b in np.ndindex(optics.scattering.shape[-3:-1]):
        mu, nu = directions[..., a, :n_beams], directions[..., b, n_beams:]
        product = mu[..., :, np.newaxis] * nu[..., np.newaxis, :]
        rates = (
            optics.extinction[..., a, np.newaxis, np.newaxis] / mu[..., :, np.newaxis],
            optics.extinction[..., b, np.newaxis, np.newaxis] / nu[..., np.newaxis, :],
        )
        air_mass = rates[0] + rates[1]
        paths = (
            -np.expm1(-air_mass * thickness) / air_mass,
            convolve_exponentials(*rates, thickness),
        )
        for turn in (REFLECTED, TRANSMITTED):
            cosines = geometry.compute_scattering_cosines(turn, mu, nu)
            source = evaluate(a, b, cosines) / (4.0 * np.pi * product[..., np.newaxis])
            for side, view in enumerate(views):
                # Scattering that turns light back joins amplitudes of the same direction.
                same = turn == REFLECTED
                first, second = (
                    one[..., a][..., :, np.newaxis] * other[..., b][..., np.newaxis, :]
                    for one, other in (
                        (beam.falling, view.falling if same else view.rising),
                        (beam.rising, view.rising if same else view.falling),
                    )
                )
                weight = (first + second) * paths[turn]
                if weight.any():
                    total[side] += (weight[..., np.newaxis] * source).sum(axis=0)
    return total


def _select_directions(interface: Element, n_states: int) -> Element:
    """Return an interface for the beams in each direction, which are reverse to radiances."""

    def split(matrix: np.ndarray) -> np.ndarray:
        # Blocks of each direction, (..., directions, states, states): the stream of each state is
        # first.
        block = matrix[..., n_states:, n_states:]
        n = block.shape[-1] // n_states
        block = block.reshape(*block.shape[:-2], n_states, n, n_states, n)
        return np.moveaxis(np.diagonal(block, axis1=-3, axis2=-1), -1, -3)

    above, below, down, up = (split(matrix) for matrix in interface[:-1] if matrix is not None)
    return Element(above, below, np.swapaxes(up, -1, -2), np.swapaxes(down, -1, -2), None)


def _make_end(boundary: Boundary, root: np.ndarray, shape: tuple[int, ...]) -> _End:
    """Return a boundary for beams; `root` is the root of the equilibrium of each state."""
    n_states = shape[-1]

    def split(values: np.ndarray) -> np.ndarray:
        by_state = values.reshape(*values.shape[:-1], n_states, -1)
        return np.broadcast_to(np.swapaxes(by_state, -1, -2), shape)

    reflection, transmission = (
        split(values[..., n_states:]) for values in (boundary.reflection, boundary.transmission)
    )
    root = root[..., np.newaxis, :]
    return _End(
        reflection[..., np.newaxis] * np.eye(n_states), split(boundary.shares) / root,
        transmission * root, boundary.outer_reflectance[..., :-1],
    )  # fmt: skip


def _trace(
    elements: Sequence[Element], entry: _End, exit_end: _End
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return falling and rising light at all levels, and the fractions that leave."""
    reflections = [exit_end.reflection]
    for element in reversed(elements):
        reflections.insert(0, add_above(element, reflections[0])[0])
    unit = np.eye(entry.reflection.shape[-1])
    gain = np.linalg.inv(unit - entry.reflection @ reflections[0])
    falling = [gain @ entry.entering[..., np.newaxis]]
    for element, below in zip(elements, reflections[1:], strict=True):
        gain = np.linalg.inv(unit - element.reflection_below @ below)
        falling.append(gain @ element.transmission_down @ falling[-1])
    down = np.stack(falling)
    up = np.stack(reflections) @ down
    down, up = down[..., 0], up[..., 0]
    reflected = entry.outer_reflectance + (entry.leaving * up[0]).sum(axis=-1)
    return (down, up), (reflected, (exit_end.leaving * down[-1]).sum(axis=-1))


# --------------------------------------------------------------------------------------------------
# Radiance that a homogeneous layer reflects and transmits between two directions.
#
# It follows from invariance (Ambartsumian; Chandrasekhar 1950, Radiative Transfer): a thin layer on
# top of a homogeneous slab has the same effect as a thin layer below it.  Let r be the extinction
# along a direction, e^(−rτ) its direct transmission δ, and w and c the scattering within a
# hemisphere and between both, in the scaled form of `splits.discrete_ordinates.homogeneous_layer`.
# With the diffuse reflection R and transmission T between directions o and e and the streams,
#
#     (r_o + r_e) R_oe = c_oe (1 − δ_o δ_e) + [w R + R w + R c R − (δ + T) c (δ + T)]_oe,
#     (r_e − r_o) T_oe = w_oe (δ_o − δ_e) + [T w − w T + (δ + T) c R − R c (δ + T)]_oe,
#
# where brackets contain no light scattered once, which the first terms are.  It is left out of the
# modes and computed at the scattering angle, see `compute_bidirectional`.
#
# Where r_e ≈ r_o, T_oe is interpolated between other rates of the direction o.  T_oe is a smooth
# function of this rate, as the scattering into the direction o stays the same.

RATE_SHIFT = 1e-3
"""Relative shift of rates for interpolation."""
SHIFTS = RATE_SHIFT * np.array([0.0, -2.0, -1.0, 1.0, 2.0])
SHIFT_WEIGHTS = np.array([0.0, -1.0, 4.0, 4.0, -1.0]) / 6.0
"""Weights of the interpolation to a shift of 0, by a polynomial of the third degree."""


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
) -> tuple[list[Element], np.ndarray, np.ndarray, np.ndarray]:
    """Return layers, and light that they scatter out of beams along views, for an azimuthal mode.

    Radiances are those of the streams and of the beams, as in `splits.discrete_ordinates.adding`,
    without light scattered once between two directions.

    Parameters
    ----------
    optics : LayerOptics
        Truncated; layers along the first dimension.
    streams : Streams
    beams, views : float, shape (..., states, beams) and (..., states, views)
        Cosines in each state.
    mode : int

    Returns
    -------
    elements : list of Element
    isotropic : float, shape (layers, ..., radiances)
    reflection, transmission : float, shape (layers, ..., radiances, states, views)
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
    # R without light scattered once, by invariance; T below.
    reflected = (
        own.within @ _transpose(seen.reflection)
        + own.reflection @ _transpose(seen.within + seen.reflection @ across)
        - (own.direct * own.across) @ _transpose(seen.transmission)
        - own.transmission @ _transpose(seen.direct * seen.across + seen.transmission @ across)
    ) / (own.rates + _transpose(seen.rates))
    transmitted = _transmit(shifted, seen, across, n_beams)
    isotropic = make_isotropic(optics, streams, n_beams)
    layers = Slab(
        slab.reflection, slab.transmission, own.reflection, own.transmission, own.direct[..., 0]
    )
    elements = Element.from_slab(layers, isotropic).split()
    into_all = (
        np.concatenate([_transpose(into_streams), into_beams], axis=-2)
        for into_streams, into_beams in (
            (seen.reflection, reflected), (seen.transmission, transmitted)
        )
    )  # fmt: skip
    reflection, transmission = (
        values.reshape(*values.shape[:-1], *views.shape[-2:]) for values in into_all
    )
    return elements, isotropic, reflection, transmission


def _select(values: np.ndarray, shape: tuple[int, ...], chosen: slice) -> np.ndarray:
    """Return some of the directions of each state."""
    by_state = values.reshape(*values.shape[:-2], *shape, values.shape[-1])[..., chosen, :]
    return by_state.reshape(*values.shape[:-2], -1, values.shape[-1])


def _transmit(
    shifted: _Directions, seen: _Directions, across: np.ndarray, n_beams: int
) -> np.ndarray:
    """Return T without light scattered once, by invariance."""
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


# --------------------------------------------------------------------------------------------------
# Radiance that plane layers reflect and transmit between two directions, by azimuthal modes.
#
# By reciprocity, the light that reaches the direction of a beam from the direction of a view has
# the BRDF, or the BTDF, of a beam that is seen from there.  Beams along the views enter at the top
# and at the bottom; what a layer scatters out of them rises and falls on both of its sides, and
# leaves along the beams at the top.  Light scattered once is left out of the modes and computed at
# the scattering angle, with the phase function before truncation (TMS, Nakajima & Tanaka 1988,
# Journal of Quantitative Spectroscopy and Radiative Transfer 40, 51).


def compute_bidirectional(
    layers: PlaneLayers,
    streams: Streams,
    geometry: Geometry,
    evaluate: PhaseFunction | None = None,
    tolerance: float = 1e-6,
) -> np.ndarray:
    """Return the BRDF and the BTDF of scattered light, in 1/sr.

    Parameters
    ----------
    layers : PlaneLayers
        With all moments that are known: they are truncated here.
    streams : Streams
    geometry : Geometry
    evaluate : callable, optional
        Phase function; by default the Legendre series of all moments.
    tolerance : float
        Modes are added until two in succession are below this fraction of both everywhere.

    Returns
    -------
    float, shape (2, ..., beams, views, azimuths)
        The BTDF over a ground is that of the light that falls on the ground.
    """
    n = 2 * streams.cosines.size
    truncated = layers.truncate(n)
    scattering = layers.optics.scattering
    evaluate = evaluate or (lambda a, b, cosines: sum_legendre(scattering[..., a, b, :], cosines))
    values = scatter_once(truncated, geometry, evaluate)
    faces = layers.make_faces(streams, geometry.beams)
    views = trace_direct_light(truncated, geometry.views)
    successive = 0
    for mode in range(n):
        multiple = _solve_mode(truncated, faces, streams, geometry, views, mode) / (2.0 * np.pi)
        factor = np.cos(mode * geometry.azimuths) * (1.0 if mode == 0 else 2.0)
        values = values + multiple[..., np.newaxis] * factor
        small = (2.0 * np.abs(multiple) <= tolerance * np.abs(values).min(axis=-1)).all()
        successive = successive + 1 if small else 0
        if mode > 0 and successive >= 2:
            break
    return values


def sum_legendre(moments: np.ndarray, cosines: np.ndarray) -> np.ndarray:
    """Return ∑ (2l + 1) χ_l P_l of moments (layers, ..., orders).

    Cosines have the shape (..., beams, views, azimuths), and so has the sum of each layer.
    """
    factors = (2.0 * np.arange(moments.shape[-1]) + 1.0) * moments
    coefficients = np.moveaxis(factors, -1, 0)[..., np.newaxis, np.newaxis, np.newaxis]
    return legval(cosines, coefficients, tensor=False)


def _solve_mode(
    layers: PlaneLayers, faces: Faces, streams: Streams, geometry: Geometry,
    views: tuple[DirectLight, DirectLight], mode: int,
) -> np.ndarray:  # fmt: skip
    """Return 2π times the contribution of a mode, without light scattered only once.

    The shape is (2, ..., beams, views).
    """
    n_beams, n_views = geometry.beams.size, geometry.views.size
    beam, view = layers.refract(geometry.beams), layers.refract(geometry.views)
    elements, isotropic, reflecting, transmitting = solve_layer_radiance(
        layers.optics, streams, beam, view, mode
    )
    n_streams = isotropic.shape[-1] - n_beams * layers.optics.extinction.shape[-1]
    interfaces, (top, bottom) = faces
    # A Lambertian ground reflects into mode 0 only.
    ground = layers.ground if mode == 0 else np.zeros_like(layers.ground)
    reflection, _ = reflect_at_bottom(bottom, isotropic[-1], ground, n_streams)
    # Light that layers scatter upwards and downwards out of the beams of the views, those from the
    # top first, shape (layers, ..., radiances, 2 × views).
    both = []
    for one in views:
        falling, rising = (np.swapaxes(values, -1, -2) for values in (one.falling, one.rising))
        both.append([
            np.einsum("...rsv,...sv->...rv", reflecting, a)
            + np.einsum("...rsv,...sv->...rv", transmitting, b)
            for a, b in ((falling, rising), (rising, falling))
        ])  # fmt: skip
    upward, downward = (np.concatenate(parts, axis=-1) for parts in zip(*both, strict=True))
    # The ground reflects beams from the top.
    gain = ground / (1.0 - ground * bottom.outer_reflectance[..., -1])
    passing = (bottom.transmission * isotropic[-1])[..., :, np.newaxis]
    rising = np.zeros(upward.shape[1:])
    rising[..., :n_views] = (
        2.0 * gain[..., np.newaxis, np.newaxis] * passing * views[0].transmitted[..., np.newaxis, :]
    )
    for layer in reversed(range(len(elements))):
        interface = interfaces[layer] if layer < len(elements) - 1 else None
        if interface is not None:
            reflection, passage = add_above(interface, reflection)
            rising = passage @ rising
        below, (reflection, passage) = reflection, add_above(elements[layer], reflection)
        rising = upward[layer] + passage @ (rising + below @ downward[layer])
    leaving = make_outlet(reflection, top, isotropic[0], n_streams)[..., :-1, :] @ rising
    return np.stack([leaving[..., :n_views], leaving[..., n_views:]])
