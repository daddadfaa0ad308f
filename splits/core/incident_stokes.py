"""Stokes vector of the incident light, an attribute of datasets with polarization."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

INCIDENT_STOKES = "incident_stokes"
UNPOLARIZED_LIGHT = (1.0, 0.0, 0.0, 0.0)


def get_incident_stokes(attributes: Mapping[Any, Any]) -> tuple[float, ...]:
    """Return I, Q, U and V of the incident light, unpolarized without the attribute."""
    return tuple(float(value) for value in attributes.get(INCIDENT_STOKES, UNPOLARIZED_LIGHT))
