"""Polarization of the incident light."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from splits.core.arrays import as_1d_array
from splits.core.validation import invalid
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.stokes import UNPOLARIZED, Stokes
from splits.media.medium import Medium


class IncidentPolarization(NamedTuple):
    """Q, U and V over I of the incident light, for the plane of incidence as reference."""

    q: float = 0.0
    u: float = 0.0
    v: float = 0.0

    def make_stokes(self, incidence_deg: float | str) -> Stokes:
        """Return the `Stokes` of a beam, whose reference is in the plane of incidence.

        At normal incidence that plane contains azimuth 0.  For diffuse light, whose directions are
        sampled, the reference is arbitrary.
        """
        if isinstance(incidence_deg, str):
            return UNPOLARIZED
        angle = math.radians(incidence_deg)
        return Stokes(Vector(math.cos(angle), 0.0, math.sin(angle)), *self)


def describe_polarization(polarization: IncidentPolarization | None) -> dict[str, list[float]]:
    """Return the attribute of a dataset: the Stokes vector of the incident light, if any."""
    return {} if polarization is None else {"incident_stokes": [1.0, *polarization]}


def check_stokes(
    stokes: Any, medium: Medium, incidence_deg: float | str
) -> IncidentPolarization | None:
    """Return the polarization of the incident light, None for runs without polarization.

    Parameters
    ----------
    stokes : bool or array_like
        Whether polarization is traced, or the Stokes vector (I, Q, U, V) of the incident light.
    medium : Medium
        Polarized layers of particles require polarization, and other ones do not allow it.
    incidence_deg : float or "diffuse"

    Raises
    ------
    ValueError
        For other values, polarized diffuse light, and layers that define no polarization.
    """
    allowed = "true, false, or I, Q, U, V of the incident light"
    if isinstance(stokes, bool | np.bool_):
        if not stokes:
            return IncidentPolarization() if medium.polarized else None
        light = IncidentPolarization()
    else:
        values = as_1d_array("stokes", stokes, allowed)
        if values.size != 4:
            raise invalid("stokes", stokes, allowed)
        intensity, *polarized = values.tolist()
        # A relative rounding error of a few digits is allowed.
        if not intensity > 0.0 or math.hypot(*polarized) > intensity * (1.0 + 1e-12):
            raise invalid("stokes", stokes, "I > 0 and √(Q² + U² + V²) at most I")
        light = IncidentPolarization(*(value / intensity for value in polarized))
    if isinstance(incidence_deg, str) and any(light):
        raise invalid("stokes", stokes, "true for diffuse light", "which is unpolarized")
    for layer in medium.scene_layers:
        if not (layer.has_grains or layer.polarized):
            raise invalid("stokes", stokes, "False", "layers of particles need polarized=True")
    return light
