"""Scenes and optics for tests: the one place that knows what kernels are told, and how."""

from __future__ import annotations

import numpy as np
from numba import njit

import splits
from splits.instruments.scenes import granular_scene
from splits.materials.refractive_index import absorption_coefficient
from splits.transport import granular, scalar, tally
from splits.transport.flight import Flier, Purse
from splits.transport.lanes.batch import passing_of
from splits.transport.light import Light
from splits.transport.scene import KEPT, UNLIMITED, Layers, Optics, Scene
from splits.transport.spheroid import Segment
from splits.transport.vectors import ORIGIN, Vector


def scene_of(grains, depth=1.0, saturation=0.0, rules=None, cos=1.0, diffuse=0.0):
    """Return a slab of grains under a beam, or diffuse light, and how the papers are read."""
    rules = splits.Readings().rules() if rules is None else rules
    layers = Layers(
        face=np.array([0.0, -float(depth)]),
        attenuation=np.array([float(grains.attenuation)]),
        saturation=np.array([float(saturation)]),
        share=grains.share[np.newaxis],
        first=np.zeros(1, dtype=np.int64),
        pore=np.zeros(1, dtype=np.int64),
    )
    return Scene(Light(float(cos), float(diffuse)), layers, grains.types, rules)


def medium_scene(medium, incidence=0.0, analog=False, depth=None, saturation=None):
    """Return the scene that instruments make of a medium, of another depth or saturation."""
    scene = granular_scene(medium, incidence, analog)
    layers = scene.layers
    if depth is not None:
        layers = layers._replace(face=np.array([0.0, -float(depth)]))
    if saturation is not None:
        layers = layers._replace(saturation=np.array([float(saturation)]))
    return scene._replace(layers=layers)


def optics_of(n, k=None, absorption=None):
    """Return the optics of materials of given indices; what is not given is 0."""
    n, k, absorption = (
        np.zeros(len(n)) if x is None else np.array(x, dtype=float) for x in (n, k, absorption)
    )
    return Optics(n, k, absorption, absorption > 0.0)


def optics_at(medium, wavelength_nm):
    """Return the optics of a medium at one wavelength."""
    index = medium.indices(np.array([wavelength_nm]))[0]
    return optics_of(index.real, index.imag, absorption_coefficient(index, wavelength_nm))


def alone(optics):
    """Return the optics of work on lanes of a single item."""
    return Optics(*(values[np.newaxis] for values in optics))


@njit
def space_of(scene):
    """Return the pore space between the boundaries of a scene."""
    return scalar.space_of(scene.layers, 0)


def passing(scene):
    """Return what the passes over lanes need to know of a scene, in the precision they take."""
    return passing_of.py_func(scene)


def boundless(scene):
    """Return a scene in which every grain fits."""
    return scene._replace(rules=scene.rules._replace(on_last_leg=KEPT, across_boundary=KEPT))


@njit
def starting(z, d):
    """Return a ray at a height that has not travelled yet."""
    return Flier(Vector(0.0, 0.0, z), ORIGIN, d, scalar.NO_LEG, 0.0)


@njit
def coming(z, way, d, back, length):
    """Return a ray at a height, some way from the end of the leg that it travelled last."""
    place = Vector(-way.x, -way.y, z - way.z)
    return Flier(place, way, d, Segment(ORIGIN, back, length), 0.0)


_DRY = 1.0
"""A number that decides for a dry pore, whatever the saturation."""
_NOTHING = optics_of(np.ones(2))


@njit
def found_by(state, flier, scene):
    """Return what a ray in the only layer of a scene meets next."""
    beam = scalar.Beam(flier.d, 0, _DRY, Purse(0.0, np.inf, 1.0))
    return granular.find(state, flier, beam, scene, _NOTHING)


@njit
def _traced(state, scene, optics, length, most):
    length[:] = 0.0
    ray = granular.launch(state, scene, optics)
    if ray.fate == tally.TRAVELS:
        ray = granular.follow(state, ray, scene, optics, length, None, most)
    return ray


def trace(state, scene, optics, most=UNLIMITED):
    """Return a ray at its end, and the lengths of its paths in all materials (m)."""
    length = np.zeros(optics.n.size)
    return _traced(state, scene, optics, length, most), length
