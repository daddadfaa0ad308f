"""Scenes: a light on a medium, as kernels take them."""

from __future__ import annotations

import numpy as np

from splits.media.granular import GranularMedium
from splits.transport.light import Light
from splits.transport.scene import Scene, Slab


def light_of(incidence_deg: float | str) -> Light:
    """Return the light of an incidence: degrees of a beam, or "diffuse"."""
    if incidence_deg == "diffuse":
        return Light(1.0, 1.0)
    return Light(float(np.cos(np.radians(float(incidence_deg)))), 0.0)


def granular_scene(medium: GranularMedium, incidence_deg: float | str, analog: bool) -> Scene:
    """Return a granular medium under a light; `analog` is absorption by coin toss."""
    slab = Slab(float(medium.depth_m), float(medium.saturation))
    return Scene(light_of(incidence_deg), slab, medium.grains(), medium.readings.rules(analog))
