"""Refraction in wet layers: at their boundaries, between them, on the way to an instrument."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from splits.discrete_ordinates.adding import Boundary, Element, Faces
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams, join_blocks

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
        return Faces([None] * (n_layers - 1), (face, face))
    cells = RefractingCells.from_index(index, streams)
    interfaces = [
        None if pair[0] == pair[1] else make_wet_interface(pair, index, cells, cosines)
        for pair in pairwise(wet_fractions)
    ]
    top, bottom = (
        make_wet_boundary(wet_fraction, index, cells, cosines)
        for wet_fraction in (wet_fractions[0], wet_fractions[-1])
    )
    return Faces(interfaces, (top, bottom))


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
