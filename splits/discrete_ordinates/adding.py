"""Hemispherical reflectance, transmittance and absorption of layers, by adding (van de Hulst 1980).

Beams need no solution of their own.  By reciprocity, the reflectance under a beam is the radiance
in the direction of the beam under isotropic light, and the fraction that a layer or the ground
absorbs is the radiance in that direction from isothermal emission by this layer or by the ground.

Radiances are vectors over the streams of all states, followed by the further directions of all
states; they are scaled as in `splits.discrete_ordinates.homogeneous_layer`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

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
    emission : float, shape (..., radiances) or None
        Isothermal emission on both sides; None for an interface.
    """

    reflection_above: np.ndarray
    reflection_below: np.ndarray
    transmission_down: np.ndarray
    transmission_up: np.ndarray
    emission: np.ndarray | None

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
        vector = isotropic[..., np.newaxis]
        emission = (vector - reflection @ vector - transmission @ vector)[..., 0]
        return cls(reflection, reflection, transmission, transmission, emission)


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


class Faces(NamedTuple):
    """Interfaces between layers, and boundaries of the sample.

    Attributes
    ----------
    interfaces : sequence of Element or None
        Below each layer except the last one; None where light passes unchanged.
    boundaries : (Boundary, Boundary)
        At the top and at the bottom.
    """

    interfaces: Sequence[Element | None]
    boundaries: tuple[Boundary, Boundary]


class Budget(NamedTuple):
    """Fate of the incident light, for the beams and for diffuse light (last).

    Attributes
    ----------
    reflectance : float, shape (..., directions + 1)
    transmittance : float, shape (..., directions + 1)
        Of an open lower boundary, or the light that the ground absorbs.
    absorption : float, shape (layers, ..., directions + 1)
        Top first.
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
    ground: np.ndarray, n_streams: int,
) -> Budget:  # fmt: skip
    """Return the reflectance, the transmittance and the absorption of every layer.

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
    """
    top, bottom = boundaries
    reflection, emission = reflect_at_bottom(bottom, isotropic[1], ground, n_streams)
    for element in reversed(elements):
        below, (reflection, passage) = reflection, add_above(element, reflection)
        if element.emission is None:
            emission = passage @ emission
            continue
        # The layer emits on both sides.
        own = element.emission[..., np.newaxis]
        emission = passage @ np.concatenate([emission, below @ own], axis=-1)
        emission[..., -1:] += own
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
