"""Polarization of the incident light."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.core.arrays import as_1d_array
from splits.core.incident_stokes import INCIDENT_STOKES
from splits.core.validation import as_scalar, invalid
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.stokes import UNPOLARIZED, Stokes
from splits.media.medium import Medium

ALLOWED_STOKES = "true, false, or I, Q, U, V of the incident light"


class IncidentPolarization(NamedTuple):
    """Q, U and V over I of the incident light, for the plane of incidence as reference.

    None in its place denotes a run without polarization, which differs from unpolarized light.
    """

    q: float = 0.0
    u: float = 0.0
    v: float = 0.0

    def make_stokes(self, incidence_deg: float | str) -> Stokes:
        """Return the `Stokes` of a beam, whose reference is in the plane of incidence.

        The beam travels along (sin θ, 0, −cos θ).  At normal incidence the plane contains azimuth
        0, the x axis.  For diffuse light, whose directions are sampled, the reference is arbitrary.
        """
        if isinstance(incidence_deg, str):
            return UNPOLARIZED
        angle = math.radians(incidence_deg)
        return Stokes(Vector(math.cos(angle), 0.0, math.sin(angle)), *self)


def describe_polarization(polarization: IncidentPolarization | None) -> dict[str, list[float]]:
    """Return the attribute of a dataset: the Stokes vector of the incident light, if any."""
    return {} if polarization is None else {INCIDENT_STOKES: [1.0, *polarization]}


def requests_polarization(stokes: Any) -> bool:
    """Return whether a value of `stokes` is anything but false."""
    return as_scalar(stokes) is not False


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
    if not requests_polarization(stokes):
        return IncidentPolarization() if medium.polarized else None
    light = IncidentPolarization()
    if as_scalar(stokes) is not True:
        values = as_1d_array("stokes", stokes, ALLOWED_STOKES)
        if values.size != 4:
            raise invalid("stokes", stokes, ALLOWED_STOKES)
        intensity, *polarized = values.tolist()
        total = math.hypot(*polarized)
        # Values may have been rounded to single precision.
        if not intensity > 0.0 or total > intensity * (1.0 + 1e-6):
            raise invalid("stokes", stokes, "I > 0 and √(Q² + U² + V²) at most I")
        intensity = max(intensity, total)
        light = IncidentPolarization(*(value / intensity for value in polarized))
    if isinstance(incidence_deg, str) and any(light):
        raise invalid("stokes", stokes, "true for diffuse light", "which is unpolarized")
    for number, layer in enumerate(medium.scene_layers):
        if not (layer.has_grains or layer.polarized):
            key = "polarized" if len(medium.scene_layers) == 1 else f"layers[{number}].polarized"
            raise invalid(key, False, "true with stokes")
    return light
