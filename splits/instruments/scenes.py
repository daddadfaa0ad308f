"""Scenes: a light on media, as kernels take them."""

from __future__ import annotations

import numpy as np

from splits.media.granular import GranularMedium
from splits.transport.light import Light
from splits.transport.scene import Layers, Scene


def light_of(incidence_deg: float | str) -> Light:
    """Return the light of an incidence: degrees of a beam, or "diffuse"."""
    if incidence_deg == "diffuse":
        return Light(1.0, 1.0)
    return Light(float(np.cos(np.radians(float(incidence_deg)))), 0.0)


def granular_scene(medium: GranularMedium, incidence_deg: float | str, analog: bool) -> Scene:
    """Return a granular medium under a light; `analog` is absorption by coin toss."""
    grains = medium.grains()
    layers = Layers(
        face=np.array([0.0, -float(medium.depth_m)]),
        attenuation=np.array([grains.attenuation]),
        saturation=np.array([float(medium.saturation)]),
        share=grains.share[np.newaxis],
        first=np.zeros(1, dtype=np.int64),
        pore=np.zeros(1, dtype=np.int64),
    )
    return Scene(light_of(incidence_deg), layers, grains.types, medium.readings.rules(analog))
