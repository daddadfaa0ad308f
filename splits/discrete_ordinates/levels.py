"""Light at the levels between dry layers, for light that enters at the top or at the bottom."""

from __future__ import annotations

import numpy as np

from splits.discrete_ordinates.adding import Element, add_above
from splits.discrete_ordinates.slab import LayerMatrices
from splits.discrete_ordinates.streams import Streams

MEASUREMENT, INCIDENT, RISING = range(3)
"""Light that enters at the top for the measurement, incident light, and light from the ground."""


def trace_light(
    layers: LayerMatrices, streams: Streams, ground: np.ndarray, measurement: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the light that falls and that rises at every level, shape (..., streams, 3).

    The matrices have a leading dimension of layers.  The last dimension of the light is
    `MEASUREMENT`, `INCIDENT` and `RISING`.
    """
    flux = streams.flux_vector
    elements = [
        Element(reflection, reflection, transmission, transmission, None)
        for reflection, transmission in zip(layers.reflection, layers.transmission, strict=True)
    ]
    lambertian = ground[..., np.newaxis, np.newaxis] * (2.0 * np.outer(flux, flux))
    below, above = [lambertian], [np.zeros_like(lambertian)]
    rising_passages: list[np.ndarray] = []
    falling_passages: list[np.ndarray] = []
    for element in reversed(elements):
        reflection, passage = add_above(element, below[0])
        below.insert(0, reflection)
        rising_passages.insert(0, np.swapaxes(passage, -1, -2))
    for element in elements:
        reflection, passage = add_above(element, above[-1])
        above.append(reflection)
        falling_passages.append(np.swapaxes(passage, -1, -2))
    source = np.stack([measurement, flux], axis=-1)
    falling = [np.broadcast_to(source, (*ground.shape, *source.shape))]
    for passage in rising_passages:
        falling.append(passage @ falling[-1])
    emission = (1.0 - ground)[..., np.newaxis, np.newaxis] * flux[:, np.newaxis]
    rising = [np.linalg.inv(np.eye(flux.size) - lambertian @ above[-1]) @ emission]
    for passage in reversed(falling_passages):
        rising.insert(0, passage @ rising[0])
    down, up = (
        [np.concatenate(parts, axis=-1) for parts in zip(*both, strict=True)]
        for both in (
            (falling, [a @ one for a, one in zip(above, rising, strict=True)]),
            ([b @ one for b, one in zip(below, falling, strict=True)], rising),
        )
    )
    return down, up
