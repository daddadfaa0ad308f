"""Light that is not scattered, or only once, in plane layers with refracting faces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.adding import Boundary, Element, add_above
from splits.discrete_ordinates.geometry import REFLECTED, TRANSMITTED, Geometry, PlaneLayers
from splits.discrete_ordinates.integrals import convolve_exponentials
from splits.discrete_ordinates.streams import Streams

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
    faces = layers.make_faces(Streams.from_number(2), cosines)
    depth = (optics.thickness[..., np.newaxis] * optics.extinction)[..., np.newaxis]
    direct = np.swapaxes(np.exp(-depth / directions), -1, -2)
    n_states, shape = direct.shape[-1], direct.shape[1:]
    elements: list[Element] = []
    is_layer: list[bool] = []
    for passing, interface in zip(direct, [*faces.interfaces, None], strict=True):
        matrix = passing[..., np.newaxis] * np.eye(n_states)
        elements.append(Element(0.0 * matrix, 0.0 * matrix, matrix, matrix, None))
        is_layer.append(True)
        if interface is not None:
            elements.append(_select_directions(interface, n_states))
            is_layer.append(False)
    root = np.sqrt(optics.equilibrium)
    top, bottom = (
        _make_end(boundary, root[end], shape)
        for boundary, end in zip(faces.boundaries, (0, -1), strict=True)
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
                weight = _pair(beam, view, (a, b), turn) * paths[turn]
                if weight.any():
                    total[side] += (weight[..., np.newaxis] * source).sum(axis=0)
    return total


def _pair(beam: DirectLight, view: DirectLight, states: tuple[int, int], turn: int) -> np.ndarray:
    """Return products of amplitudes, shape (layers, ..., beams, views).

    Scattering that turns light back joins amplitudes of the same direction.
    """
    pairs = [(beam.falling, view.falling), (beam.rising, view.rising)]
    if turn == TRANSMITTED:
        pairs = [(beam.falling, view.rising), (beam.rising, view.falling)]
    first, second = (
        one[..., states[0]][..., :, np.newaxis] * other[..., states[1]][..., np.newaxis, :]
        for one, other in pairs
    )
    amplitude: np.ndarray = first + second
    return amplitude


def _select_directions(interface: Element, n_states: int) -> Element:
    """Return an interface for the beams in each direction, which are reverse to radiances."""
    above, below, down, up = (
        _split_directions(matrix, n_states) for matrix in interface[:-1] if matrix is not None
    )
    return Element(above, below, np.swapaxes(up, -1, -2), np.swapaxes(down, -1, -2), None)


def _split_directions(matrix: np.ndarray, n_states: int) -> np.ndarray:
    """Return the blocks of each direction, shape (..., directions, states, states).

    Each state has one stream, which comes first.
    """
    block = matrix[..., n_states:, n_states:]
    n = block.shape[-1] // n_states
    block = block.reshape(*block.shape[:-2], n_states, n, n_states, n)
    return np.moveaxis(np.diagonal(block, axis1=-3, axis2=-1), -1, -3)


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
