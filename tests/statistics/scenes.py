"""Scenes and optics for tests: the one place that knows what kernels are told, and how."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from oracle import scene as oracle_scene

import splits
from splits.instruments.scenes import granular_scene, particles_of
from splits.materials.refractive_index import absorption_coefficient
from splits.transport.grains import granular, scalar
from splits.transport.grains.flight import Flier, Purse
from splits.transport.grains.scalar import Beam
from splits.transport.grains.scene import (
    GRAINS,
    KEPT,
    NO_GROUND,
    UNLIMITED,
    Grains,
    Layers,
    Optics,
    Scene,
    Types,
    shared_optics,
)
from splits.transport.grains.spheroid import Segment
from splits.transport.lanes.batch import passing_of
from splits.transport.numerics.vectors import ORIGIN, Vector
from splits.transport.optics.light import Light


def coated(thickness, materials, facetness=0.0):
    """Return grains of one type, one size and one shape, coated from the outside inwards.

    Parameters
    ----------
    thickness : sequence of float
        Of the coatings, as a fraction of the major axis.
    materials : sequence of int
        Of the coatings and of the core.
    """
    one = np.ones((1, 2))
    types = Types(
        np.array([len(materials)]), np.array([materials]), np.array([[*thickness, 0.0]]),
        one, one, facetness * one,
    )  # fmt: skip
    return Grains(1e3, np.ones(1), types)


def scene_of(grains, depth=1.0, saturation=0.0, rules=None, cos=1.0, diffuse=0.0):
    """Return a slab of grains under a beam, or diffuse light, and how the papers are read."""
    rules = splits.Readings().rules() if rules is None else rules
    layers = Layers(
        np.array([0.0, -depth]), np.array([grains.attenuation]), np.array([float(saturation)]),
        grains.type_cdf[np.newaxis], np.array([0]), np.array([0]), np.empty((1, 0)),
        np.array([GRAINS]),
    )  # fmt: skip
    return Scene(
        Light(float(cos), float(diffuse)),
        layers,
        grains.types,
        rules,
        particles_of([]),
        NO_GROUND,
        False,
    )


def medium_scene(medium, incidence=0.0, analog=False, depth=None, saturation=None):
    """Return the scene that instruments make of a medium, or one of other depth or saturation."""
    scene = granular_scene(medium, incidence, analog)
    layers = scene.layers
    if depth is not None:
        layers = layers._replace(boundaries=np.array([0.0, -float(depth)]))
    if saturation is not None:
        layers = layers._replace(saturation=np.array([float(saturation)]))
    return scene._replace(layers=layers)


def oracle_slab(medium, incidence):
    """Return grains, slab and rules of a medium as the oracle wants them."""
    grains, rules = medium.make_grain_population(), medium.interpretation.to_sampling_rules(False)
    cos = medium_scene(medium, incidence).source.cos_incidence
    slab = oracle_scene.Slab(medium.depth_m, medium.saturation, cos, incidence == "diffuse")
    return oracle_scene.Grains(grains.attenuation, grains.type_cdf, *grains.types), slab, rules


def optics_of(n, k=None, absorption=None):
    """Return the optics of materials of given indices; what is not given is 0."""
    n, k, absorption = (
        np.zeros(len(n)) if x is None else np.array(x, dtype=float) for x in (n, k, absorption)
    )
    return Optics(n, k, absorption, absorption > 0.0)


def optics_at(medium, wavelength_nm):
    """Return the optics of a medium at one wavelength."""
    index = medium.compute_refractive_indices(np.array([wavelength_nm]))[0]
    return shared_optics(index, absorption_coefficient(index, wavelength_nm)[np.newaxis])


def alone(optics):
    """Return the optics of work on lanes of a single item."""
    return Optics(*(values[np.newaxis] for values in optics))


def passing(scene):
    """Return what the passes over lanes need to know of a scene, in the precision they take."""
    return passing_of(scene)


def boundless(scene):
    """Return a scene in which every grain fits."""
    return scene._replace(rules=scene.rules._replace(segment_overlap=KEPT, boundary_overlap=KEPT))


@njit
def space_of(scene):
    """Return the pore space between the boundaries of a scene."""
    return scalar.space_of(scene.layers, 0)


@njit
def pore_drawn(u, scene):
    """Return the material of the pores that a number stands for."""
    return scalar.pore_of(scene.layers, 0, u)


@njit
def carried(d, wet=False, limit=math.inf):
    """Return what a ray carries, through wet pores where there are any, or through dry ones."""
    return Beam(d, 0, 0.0 if wet else 1.0, Purse(0.0, limit, 1.0))


@njit
def starting(z, d):
    """Return a ray at a height that has not travelled yet."""
    return Flier(Vector(0.0, 0.0, z), ORIGIN, d, scalar.NO_LEG, 0.0)


@njit
def coming(z, displacement, d, direction_back, length):
    """Return a ray at a height, some way from the end of the leg that it travelled last."""
    place = Vector(-displacement.x, -displacement.y, z - displacement.z)
    return Flier(place, displacement, d, Segment(ORIGIN, direction_back, length), 0.0)


@njit
def next_of(state, flier, scene, optics):
    """Return what a ray meets next."""
    return granular.find(state, flier, carried(flier.direction), scene, optics)


@njit
def _traced(state, scene, optics, length, max_order):
    length[:] = 0.0
    ray = granular.launch(state, scene, optics, None, max_order)
    if ray.status == granular.TRAVELS:
        ray = granular.follow(state, ray, scene, optics, length, None, None, None)
    return ray


def trace(state, scene, optics, max_order=UNLIMITED):
    """Return a ray at its end, and the lengths of its paths in all materials (m)."""
    length = np.zeros(optics.n.size)
    return _traced(state, scene, optics, length, max_order), length
