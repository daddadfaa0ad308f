"""Hemispherical reflectance, transmittance and absorption of layers, by adding (van de Hulst 1980).

Beams need no solution of their own.  By reciprocity, the reflectance under a beam is the radiance
in the direction of the beam under isotropic light, and the fraction that a layer or the ground
absorbs is the radiance in that direction from isothermal emission by this layer or by the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.slab import Slab
from splits.discrete_ordinates.streams import Streams


class Budget(NamedTuple):
    """Fate of the incident light, for the beams and for diffuse light (last).

    Attributes
    ----------
    reflectance : float, shape (..., directions + 1)
    transmittance : float, shape (..., directions + 1)
        Of an open lower boundary, or the light that the ground absorbs.
    absorption : float, shape (layers, ..., directions + 1)
    """

    reflectance: np.ndarray
    transmittance: np.ndarray
    absorption: np.ndarray


def compute_budget(slabs: Sequence[Slab], ground: np.ndarray, streams: Streams) -> Budget:
    """Return the reflectance, the transmittance and the absorption of every layer.

    Parameters
    ----------
    slabs : sequence of Slab
        Layers, top first, with one batch shape.
    ground : float, shape (...)
        Albedo of the Lambertian ground; 0 for an open lower boundary.
    streams : Streams
    """
    lambertian, n_directions = streams.flux_vector, streams.directions.size
    batch = slabs[0].reflection.shape[:-2]
    albedo = np.broadcast_to(ground, batch)[..., np.newaxis]
    # Radiances in the streams and in the directions that rise from what lies below: for reflected
    # light as matrices, for emitted light one column for the ground and each layer.
    reflection = 2.0 * albedo[..., np.newaxis] * np.outer(lambertian, lambertian)
    beam_reflection = 2.0 * albedo[..., np.newaxis] * np.outer(np.ones(n_directions), lambertian)
    emission = (1.0 - albedo)[..., np.newaxis, :] * lambertian[:, np.newaxis]
    beam_emission = np.broadcast_to((1.0 - albedo)[..., np.newaxis, :], (*batch, n_directions, 1))
    for slab in reversed(slabs):
        inverse = np.linalg.inv(np.eye(lambertian.size) - slab.reflection @ reflection)
        inverse_t = np.swapaxes(inverse, -1, -2)
        own, own_beam = _emit(slab, lambertian)
        # The layer emits downwards, too.
        rising = inverse_t @ np.concatenate([emission, reflection @ own], axis=-1)
        falling = slab.reflection @ rising
        falling[..., -1:] += own
        arriving = beam_reflection @ falling
        arriving[..., :-1] += beam_emission
        emission = slab.transmission @ rising
        emission[..., -1:] += own
        beam_emission = slab.beam_transmission @ rising + slab.direct[..., np.newaxis] * arriving
        beam_emission[..., -1:] += own_beam
        passed = inverse @ slab.transmission
        beam_reflection = slab.beam_reflection + (
            slab.beam_transmission @ (reflection @ passed)
            + slab.direct[..., np.newaxis] * (beam_reflection @ passed)
        )
        reflection = slab.reflection + slab.transmission @ reflection @ passed
    incident = reflection @ lambertian
    reflectance = np.concatenate(
        [beam_reflection @ lambertian, 2.0 * (incident @ lambertian)[..., np.newaxis]], axis=-1
    )
    diffuse = 2.0 * np.einsum("i,...ij->...j", lambertian, emission)[..., np.newaxis, :]
    absorbed = np.moveaxis(np.concatenate([beam_emission, diffuse], axis=-2), -1, 0)
    return Budget(reflectance, absorbed[0], absorbed[:0:-1])


def _emit(slab: Slab, lambertian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the isothermal emission of a layer, in the streams and in the directions."""
    both_sides = slab.reflection @ lambertian + slab.transmission @ lambertian
    beam = (slab.beam_reflection + slab.beam_transmission) @ lambertian
    emission = (lambertian - both_sides)[..., np.newaxis]
    return emission, (1.0 - beam - slab.direct)[..., np.newaxis]
