"""Hemispherical reflectance, transmittance and absorption of layers, by adding (van de Hulst 1980).

Beams need no solution of their own.  By reciprocity, the reflectance under a beam is the radiance
in the direction of the beam under isotropic light, and the fraction that a layer or the ground
absorbs is the radiance in that direction from isothermal emission by this layer or by the ground.

Radiances are vectors over the streams of all states, followed by the further directions of all
states; they are scaled as in `splits.discrete_ordinates.homogeneous_layer`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from splits.discrete_ordinates.homogeneous_layer import (
    LayerOptics,
    Slab,
    Streams,
    join_blocks,
)


class Element(NamedTuple):
    """Reflection and transmission of a layer, or of the interface between two layers.

    Attributes
    ----------
    reflection_above, reflection_below : float, shape (..., radiances, radiances)
        Of light from above and from below.
    transmission_down, transmission_up : float, shape (..., radiances, radiances)
    isotropic : float, shape (..., radiances) or None
        Radiance of the layer in equilibrium with a radiance of 1 outside; None for an interface.
    """

    reflection_above: np.ndarray
    reflection_below: np.ndarray
    transmission_down: np.ndarray
    transmission_up: np.ndarray
    isotropic: np.ndarray | None

    @classmethod
    def from_slab(cls, slab: Slab, isotropic: np.ndarray, own: np.ndarray | None = None) -> Element:
        """Return a layer, which is the same from both sides, with its isotropic radiance.

        Parameters
        ----------
        slab : Slab
        isotropic : float, shape (..., radiances)
            Radiance in equilibrium with a radiance of 1 outside.
        own : float, shape (..., radiances), optional
            Radiance in equilibrium within the layer, by which the slab is scaled.
        """
        n_directions = slab.direct.shape[-1]
        none = np.zeros((*slab.reflection.shape[:-1], n_directions))
        no_beam = np.zeros((*slab.direct.shape, n_directions))
        reflection = join_blocks([[slab.reflection, none], [slab.beam_reflection, no_beam]])
        direct = slab.direct[..., np.newaxis] * np.eye(n_directions)
        transmission = join_blocks([[slab.transmission, none], [slab.beam_transmission, direct]])
        if own is not None:
            # Rows are those of the light before: fluxes at a beam follow from light that rises.
            ratio = own / isotropic
            change = ratio[..., np.newaxis, :] / ratio[..., np.newaxis]
            reflection, transmission = reflection * change, transmission * change
        return cls(reflection, reflection, transmission, transmission, isotropic)

    def split(self, counts: Sequence[int] | None = None) -> list[Element]:
        """Return the layers along the first dimension, or as many of its items for each layer."""
        assert self.isotropic is not None
        arrays: Any = (*self[:4], self.isotropic)
        if counts is not None:
            arrays = [np.split(array, np.cumsum(counts)[:-1]) for array in arrays]
        return [Element(*one) for one in zip(*arrays, strict=True)]

    def compute_emission(self) -> np.ndarray:
        """Return the isothermal emission of a layer on both sides, shape (..., radiances, 1)."""
        assert self.isotropic is not None
        vector = self.isotropic[..., np.newaxis]
        emission: np.ndarray = (
            vector - self.reflection_above @ vector - self.transmission_down @ vector
        )
        return emission


class Boundary(NamedTuple):
    """Upper or lower boundary of the sample, with the air outside.

    Attributes
    ----------
    reflection, transmission : float, shape (..., radiances)
        Of light from inside; of light from both sides.
    shares : float, shape (..., states × directions)
        Share of each state in the light that leaves along a direction.
    outer_reflectance : float, shape (..., directions + 1)
        Reflectance of the boundary itself from outside, for the beams and for diffuse light.
    """

    reflection: np.ndarray
    transmission: np.ndarray
    shares: np.ndarray
    outer_reflectance: np.ndarray

    @classmethod
    def make_transparent(cls, n_streams: int, n_directions: int) -> Boundary:
        """Return the boundary of a layer without water, which neither reflects nor refracts."""
        ones = np.ones(n_streams + n_directions)
        return cls(0.0 * ones, ones, ones[n_streams:], np.zeros(n_directions + 1))


Faces = tuple[Sequence[Element | None], tuple[Boundary, Boundary]]
"""Interfaces below each layer except the last one, None where light passes unchanged; and the
boundaries of the sample at the top and at the bottom."""


class Budget(NamedTuple):
    """Fate of the incident light, for the beams and for diffuse light (last).

    Attributes
    ----------
    reflectance : float, shape (..., directions + 1)
    transmittance : float, shape (..., directions + 1)
        Of an open lower boundary, or the light that the ground absorbs.
    absorption : float, shape (layers, ..., directions + 1)
        Top first; of no layer if it has not been asked for.
    """

    reflectance: np.ndarray
    transmittance: np.ndarray
    absorption: np.ndarray


def make_isotropic(optics: LayerOptics, streams: Streams, n_directions: int) -> np.ndarray:
    """Return the scaled radiance in equilibrium with a radiance of 1 outside."""
    states = np.sqrt(optics.equilibrium)[..., np.newaxis]
    parts = (states * np.sqrt(streams.weights * streams.cosines), states * np.ones(n_directions))
    return np.concatenate([part.reshape(*part.shape[:-2], -1) for part in parts], axis=-1)


def compute_budget(
    elements: Sequence[Element], isotropic: Sequence[np.ndarray], boundaries: Sequence[Boundary],
    ground: np.ndarray, n_streams: int, *, with_absorption: bool = False,
    seen: Sequence[Any] | None = None,
) -> Budget:  # fmt: skip
    """Return the reflectance and the transmittance, and the absorption of every layer.

    Parameters
    ----------
    elements : sequence of Element
        Layers and the interfaces between them, top first.
    isotropic : sequence of two arrays, shape (..., radiances)
        Isotropic radiance in the top layer and in the bottom layer.
    boundaries : sequence of two Boundary
        At the top and at the bottom.
    ground : float, shape (...)
        Albedo of the Lambertian ground; 0 for an open lower boundary.
    n_streams : int
        Number of the streams of all states in one hemisphere.
    with_absorption : bool
        Whether the absorption of the layers is computed, too.
    seen : sequence, optional
        Where along the leading dimensions each element is seen, and solved; those below are then
        not seen either, and black.  By default everywhere, as the absorption requires.
    """
    top, bottom = boundaries
    reflection, emission = reflect_at_bottom(bottom, isotropic[1], ground, n_streams)
    if seen is not None:
        dark = np.ones(reflection.shape[:-2], dtype=bool)
        dark[seen[-1]] = False
        reflection[dark] = emission[dark] = 0.0
    for element, here in zip(elements[::-1], (seen or [...] * len(elements))[::-1], strict=True):
        below = reflection[here]
        reflected, passage = add_above(element, below)
        if with_absorption and element.isotropic is not None:
            # The layer emits on both sides.
            own = element.compute_emission()
            emission = passage @ np.concatenate([emission, below @ own], axis=-1)
            emission[..., -1:] += own
        else:
            emission[here] = passage @ emission[here]
        reflection[here] = reflected
    outlet = make_outlet(reflection, top, isotropic[0], n_streams)
    entering = (top.transmission * isotropic[0])[..., np.newaxis]
    rising = np.concatenate([reflection @ entering, emission], axis=-1)
    values = np.moveaxis(outlet @ rising, -1, 0)
    return Budget(values[0] + top.outer_reflectance, values[1], values[:1:-1])


def add_above(element: Element, below: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the reflection of an element and of all below, and the passage of rising light.

    The passage is the transmission upwards of light that rises from below, with all reflections
    between both sides; light that falls from the same level rises after the reflection by what is
    below.
    """
    unit = np.eye(below.shape[-1])
    passage = element.transmission_up @ np.linalg.inv(unit - below @ element.reflection_below)
    reflection = element.reflection_above + passage @ (below @ element.transmission_down)
    return reflection, passage


def reflect_at_bottom(
    bottom: Boundary, isotropic: np.ndarray, ground: np.ndarray, n_streams: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the reflection by the lower boundary and the ground, and the emission of the latter.

    Light that the boundary reflects back to the ground is reflected there again.
    """
    passing = bottom.transmission * isotropic
    flux = passing.copy()
    flux[..., n_streams:] = 0.0
    diffuse = bottom.outer_reflectance[..., -1]
    gain = 1.0 / (1.0 - ground * diffuse)
    lambertian = 2.0 * (ground * gain)[..., np.newaxis, np.newaxis]
    reflection = lambertian * passing[..., :, np.newaxis] * flux[..., np.newaxis, :]
    diagonal = np.arange(passing.shape[-1])
    reflection[..., diagonal, diagonal] += bottom.reflection
    emission = ((1.0 - ground) * gain)[..., np.newaxis] * passing
    return reflection, emission[..., np.newaxis]


def make_outlet(
    reflection: np.ndarray, top: Boundary, isotropic: np.ndarray, n_streams: int
) -> np.ndarray:
    """Return the light that leaves through the upper boundary, for light that rises below it.

    Parameters
    ----------
    reflection : float, shape (..., radiances, radiances)
        Of all that is below the boundary.
    top, isotropic, n_streams
        As in `compute_budget`, of the top.

    Returns
    -------
    float, shape (..., directions + 1, radiances)
        Radiance in the directions of the beams, and flux (last).
    """
    n_beams, n_radiances = top.outer_reflectance.shape[-1] - 1, reflection.shape[-1]
    leaving = np.zeros((*reflection.shape[:-2], n_beams + 1, n_radiances))
    beams = np.arange(n_radiances - n_streams)
    by_state = top.shares / isotropic[..., n_streams:]
    leaving[..., beams % max(n_beams, 1), n_streams + beams] = by_state
    leaving[..., -1, :n_streams] = 2.0 * (top.transmission * isotropic)[..., :n_streams]
    unit = np.eye(n_radiances)
    return leaving @ np.linalg.inv(unit - reflection * top.reflection[..., np.newaxis, :])


def iterate_levels(
    elements: Sequence[Element], isotropic: Sequence[np.ndarray],
    boundaries: Sequence[Boundary], ground: np.ndarray, n_streams: int,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:  # fmt: skip
    """Yield, at each level from the top, what leaves of rising light, and the reflection below it.

    The first is the light that leaves the sample (`make_outlet`)
    for light that rises at the level, with all reflections by what is below.

    Parameters
    ----------
    elements : sequence of Element
        Layers and the interfaces between them, top first.
    isotropic : sequence of arrays, shape (..., radiances)
        Isotropic radiance at each level, of the layer in which the level is.
    boundaries, ground, n_streams
        As in `compute_budget`.
    """
    top, bottom = boundaries
    reflections = [reflect_at_bottom(bottom, isotropic[-1], ground, n_streams)[0]]
    passages = []
    for element in reversed(elements):
        reflection, passage = add_above(element, reflections[-1])
        reflections.append(reflection)
        passages.append(passage)
    outlet = make_outlet(reflections[-1], top, isotropic[0], n_streams)
    while True:
        yield outlet, reflections.pop()
        if not passages:
            return
        outlet = outlet @ passages.pop()


def apply_rows(rows: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Return the product of matrices with vectors."""
    return (rows @ source[..., np.newaxis])[..., 0]


# --------------------------------------------------------------------------------------------------
# Boundaries and interfaces of wet layers: reflection and refraction of light in wet pores.
#
# Light in a wet pore is refracted at the boundary of the sample, and at the boundary of a layer
# with another wet fraction, where a part of the pores is wet on one side only
# (`splits.media.stack.Stack`). A stream stands for a cell of solid angle: cells are equal to the
# weights of the streams in the projected solid angle y = sin²θ, which refraction multiplies by n².
# Reflectances are averages over cells, so that fluxes are conserved and total reflection does not
# depend on the number of streams.

N_SAMPLES = 24
"""Samples for the average of the reflectance over a cell."""
DRY, WET = range(2)


class RefractingCells(NamedTuple):
    """Transmission of light between the streams in air and those in water.

    Attributes
    ----------
    transmission : float, shape (..., streams in water, streams in air)
        Projected solid angle that both streams share, times the transmittance, in the unit of the
        weights of air.
    weights : float, shape (streams,)
        Projected solid angles of the streams, with a sum of 1.
    """

    transmission: np.ndarray
    weights: np.ndarray

    @classmethod
    def from_index(cls, index: np.ndarray, streams: Streams) -> RefractingCells:
        """Return the transmission for refractive indices of water, shape (...)."""
        weights = 2.0 * streams.weights * streams.cosines
        # Streams by increasing cosine have decreasing sin²θ, from 1 to 0.
        edges = 1.0 - np.concatenate([[0.0], np.cumsum(weights)])
        square = (np.asarray(index) ** 2)[..., np.newaxis, np.newaxis]
        high = np.minimum(square * edges[:-1, np.newaxis], edges[:-1])
        low = np.maximum(square * edges[1:, np.newaxis], edges[1:])
        shared = np.maximum(high - low, 0.0)
        position = (np.arange(N_SAMPLES) + 0.5) / N_SAMPLES
        y = low[..., np.newaxis] + shared[..., np.newaxis] * position
        cosine = np.sqrt(np.clip(1.0 - y, 0.0, 1.0))
        reflectance = compute_reflectance(cosine, np.asarray(index)[..., None, None, None])
        return cls(shared * (1.0 - reflectance.mean(axis=-1)), weights)

    def compute_outer_transmittance(self) -> np.ndarray:
        """Return the transmittance of the streams in air, shape (..., streams)."""
        return self.transmission.sum(axis=-2) / self.weights

    def compute_inner_transmittance(self, index: np.ndarray) -> np.ndarray:
        """Return the transmittance of the streams in water, shape (..., streams)."""
        etendue = np.asarray(index)[..., np.newaxis] ** 2 * self.weights
        return self.transmission.sum(axis=-1) / etendue


def compute_reflectance(cosine: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the Fresnel reflectance of water for unpolarized light from air."""
    refracted = np.sqrt(index**2 - 1.0 + cosine**2)
    perpendicular = ((cosine - refracted) / (cosine + refracted)) ** 2
    parallel = ((index**2 * cosine - refracted) / (index**2 * cosine + refracted)) ** 2
    return 0.5 * (perpendicular + parallel)


def refract_directions(cosines: np.ndarray, index: np.ndarray | None) -> np.ndarray:
    """Return the cosines of directions in dry and wet pores, shape (..., states, directions).

    `index` is the refractive index of water, None for layers without wet pores.
    """
    if index is None:
        return cosines[..., np.newaxis, :]
    sine2 = (1.0 - cosines**2) / np.asarray(index)[..., np.newaxis] ** 2
    refracted = np.sqrt(1.0 - sine2)
    return np.stack(np.broadcast_arrays(cosines, refracted), axis=-2)


def make_faces(
    n_layers: int, wet_fractions: Sequence[float], index: np.ndarray | None, streams: Streams,
    cosines: np.ndarray,
) -> Faces:  # fmt: skip
    """Return the interfaces and boundaries of layers, top first.

    Parameters
    ----------
    n_layers : int
    wet_fractions : sequence of float
        Above 0, for layers of two states.
    index : float, shape (...), or None
        Refractive index of water; None for layers of one state, which neither reflect nor refract.
    streams : Streams
    cosines : float, shape (..., directions)
        Directions in air; (directions,) for layers of two states.
    """
    if index is None:
        face = Boundary.make_transparent(streams.cosines.size, cosines.shape[-1])
        return [None] * (n_layers - 1), (face, face)
    cells = RefractingCells.from_index(index, streams)
    interfaces = [
        None if pair[0] == pair[1] else make_wet_interface(pair, index, cells, cosines)
        for pair in pairwise(wet_fractions)
    ]
    top, bottom = (
        make_wet_boundary(wet_fraction, index, cells, cosines)
        for wet_fraction in (wet_fractions[0], wet_fractions[-1])
    )
    return interfaces, (top, bottom)


def make_wet_boundary(
    wet_fraction: float, index: np.ndarray, cells: RefractingCells, cosines: np.ndarray
) -> Boundary:
    """Return the boundary of a layer of a wet fraction with the air.

    Parameters
    ----------
    wet_fraction : float
    index : float, shape (...)
        Refractive index of water.
    cells : RefractingCells
    cosines : float, shape (directions,)
        Directions in air.
    """
    inner = cells.compute_inner_transmittance(index)
    face = compute_reflectance(cosines, index[..., np.newaxis])
    dry_streams = np.ones_like(inner)
    dry = np.ones_like(face)
    transmission = np.concatenate([dry_streams, inner, dry, 1.0 - face], axis=-1)
    shares = np.concatenate([(1.0 - wet_fraction) * dry, wet_fraction * (1.0 - face)], axis=-1)
    diffuse = 1.0 - (cells.weights * cells.compute_outer_transmittance()).sum(axis=-1)
    outer = wet_fraction * np.concatenate([face, diffuse[..., np.newaxis]], axis=-1)
    return Boundary(1.0 - transmission, transmission, shares, outer)


def make_wet_interface(
    wet_fractions: tuple[float, float], index: np.ndarray, cells: RefractingCells,
    cosines: np.ndarray,
) -> Element:  # fmt: skip
    """Return the interface of two layers, for the wet fractions above and below.

    Pores that are wet in the layer of less water are wet in the other, too.  The rest of the wet
    pores of the other layer begins or ends there.  Scaled radiances make both directions symmetric.
    """
    n = index[..., np.newaxis, np.newaxis]
    streams = cells.transmission / np.sqrt(cells.weights[:, np.newaxis] * cells.weights) / n
    by_streams = _connect_states(
        wet_fractions, streams,
        _make_diagonal(1.0 - cells.compute_outer_transmittance()),
        _make_diagonal(1.0 - cells.compute_inner_transmittance(index)), 1.0,
    )  # fmt: skip
    face = compute_reflectance(cosines, index[..., np.newaxis])
    beams = _make_diagonal((1.0 - face) / index[..., np.newaxis])
    reflected = _make_diagonal(face)
    by_beams = _connect_states(wet_fractions, beams, reflected, reflected, n**2)
    above, below, down, up = (
        _join_diagonal(a, b) for a, b in zip(by_streams, by_beams, strict=True)
    )
    return Element(above, below, down, up, None)


def _connect_states(
    wet_fractions: tuple[float, float], transmission: np.ndarray, outer_reflection: np.ndarray,
    inner_reflection: np.ndarray, refraction: Any,
) -> tuple[np.ndarray, ...]:  # fmt: skip
    """Return the four matrices of an interface, for the streams or for the directions.

    Parameters
    ----------
    wet_fractions : (float, float)
        Above and below.
    transmission, outer_reflection, inner_reflection : float, shape (..., n, n)
        Light from air to water, and reflected in air and in water.
    refraction : float
        Factor of light that enters water, relative to light that leaves it: 1 for fluxes.
    """
    upper, lower = wet_fractions
    dry, wet, changing = 1.0 - max(upper, lower), min(upper, lower), abs(upper - lower)
    fractions = ((1.0 - upper, upper), (1.0 - lower, lower))
    none = np.zeros_like(outer_reflection)
    unit = none + np.eye(outer_reflection.shape[-1])

    def normalize(amount: float, a: float, b: float) -> float:
        return amount / np.sqrt(a * b) if amount else 0.0

    staying = [
        [normalize(dry, fractions[0][DRY], fractions[1][DRY]) * unit, none],
        [none, normalize(wet, fractions[0][WET], fractions[1][WET]) * unit],
    ]
    # The layer of less water has the dry side of the changing pores.
    down, up = ([list(row) for row in staying] for _ in range(2))
    above, below = ([[none, none], [none, none]] for _ in range(2))
    drier, wetter = (0, 1) if lower > upper else (1, 0)
    amount = normalize(changing, fractions[drier][DRY], fractions[wetter][WET])
    entering, leaving = (down, up) if drier == 0 else (up, down)
    entering[WET][DRY] = amount * refraction * transmission
    leaving[DRY][WET] = amount * np.swapaxes(transmission, -1, -2)
    dry_side, wet_side = (above, below) if drier == 0 else (below, above)
    dry_side[DRY][DRY] = changing / fractions[drier][DRY] * outer_reflection
    wet_side[WET][WET] = changing / fractions[wetter][WET] * inner_reflection
    return tuple(join_blocks(blocks) for blocks in (above, below, down, up))


def _make_diagonal(values: np.ndarray) -> np.ndarray:
    return values[..., np.newaxis] * np.eye(values.shape[-1])


def _join_diagonal(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the matrix of two blocks on its diagonal."""
    upper = np.zeros((*a.shape[:-1], b.shape[-1]))
    lower = np.zeros((*b.shape[:-1], a.shape[-1]))
    return join_blocks([[a, upper], [lower, b]])
