"""Light at the levels between dry layers, for light that enters at the top or at the bottom."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.adding import Element, add_above
from splits.discrete_ordinates.integrals import compute_impedances
from splits.discrete_ordinates.slab import Modes
from splits.discrete_ordinates.streams import Streams

MEASUREMENT, INCIDENT, RISING = range(3)
"""Light that enters at the top for the measurement, incident light, and light from the ground."""


class LayerMatrices(NamedTuple):
    """Matrices of layers, each of shape (layers, ..., streams, streams).

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

    def get_element(self, layer: int) -> Element:
        """Return one layer."""
        reflection, transmission = self.reflection[layer], self.transmission[layer]
        return Element(reflection, reflection, transmission, transmission, None)


def solve_layers(modes: Modes, thickness: np.ndarray) -> LayerMatrices:
    """Return the matrices of layers, as in `splits.discrete_ordinates.slab.solve_slab`."""
    even, odd, difference = compute_impedances(modes.rates, thickness)
    y, y_t = modes.differences, np.swapaxes(modes.differences, -1, -2)
    unit = np.eye(y.shape[-1])
    even_inverse, odd_inverse = np.linalg.inv(
        unit + (y * np.stack([even, odd])[..., np.newaxis, :]) @ y_t
    )
    transmission = odd_inverse @ (y * difference[..., np.newaxis, :]) @ (y_t @ even_inverse)
    matrices = even_inverse + odd_inverse - unit, transmission, even_inverse, odd_inverse
    return LayerMatrices(*(0.5 * (one + np.swapaxes(one, -1, -2)) for one in matrices))


def trace_light(
    layers: LayerMatrices, streams: Streams, ground: np.ndarray, measurement: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the light that falls and that rises at every level, shape (..., streams, 3).

    The last dimension is `MEASUREMENT`, `INCIDENT` and `RISING`.
    """
    n_layers, flux = len(layers.reflection), streams.flux_vector
    elements = [layers.get_element(layer) for layer in range(n_layers)]
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
