"""Directions outside plane layers, and the layers with all that refracts light on its way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.adding import Faces
from splits.discrete_ordinates.layer_optics import LayerOptics
from splits.discrete_ordinates.pores import make_wet_faces, refract_directions
from splits.discrete_ordinates.streams import Streams

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
        clipped: np.ndarray = np.clip(sines * np.cos(self.azimuths) + turned, -1.0, 1.0)
        return clipped


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
        if self.water_index is None:
            n_layers = self.optics.thickness.shape[0]
            return Faces.make_transparent(n_layers, streams.cosines.size, cosines.size)
        return make_wet_faces(self.wet_fractions, self.water_index, streams, cosines)

    def refract(self, cosines: np.ndarray) -> np.ndarray:
        """Return the cosines within the layers, shape (..., states, directions)."""
        if self.water_index is None:
            return cosines[np.newaxis]
        return refract_directions(cosines, self.water_index)

    def truncate(self, streams: int) -> PlaneLayers:
        """Return truncated layers (`LayerOptics.truncate`), with moments of 0 if unknown."""
        optics = self.optics
        missing = max(streams + 1 - optics.scattering.shape[-1], 0)
        padding = [(0, 0)] * (optics.scattering.ndim - 1) + [(0, missing)]
        padded = optics._replace(scattering=np.pad(optics.scattering, padding))
        return self._replace(optics=padded.truncate(streams))
