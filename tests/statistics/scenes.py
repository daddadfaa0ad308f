"""Scenes, optics and rays of tests in the form that the kernels take."""

import math

import numpy as np
from numba import njit
from oracle import scene as oracle_scene

import splits
from splits.kernels.compiler.jit import replace
from splits.kernels.grains import grain_path as ray_state
from splits.kernels.rays import make_ray
from splits.kernels.scene import (
    NO_GROUND,
    NO_MAX_ORDER,
    NO_PARTICLES,
    ORIGIN,
    OVERLAP_KEEP,
    GrainPopulation,
    GrainTypes,
    Layers,
    Optics,
    Scene,
    Segment,
    Source,
    Vector,
    make_bounding_optics,
)
from splits.kernels.transport import history
from splits.materials.library import absorption_coefficient
from splits.simulation.scene import build_scene


def make_coated_grains(thickness, materials, facetness=0.0):
    """Return grains of one type, one size and one shape, coated from the outside inwards.

    Parameters
    ----------
    thickness : sequence of float
        Of the coatings, as a fraction of the major axis.
    materials : sequence of int
        Of the coatings and of the core.
    """
    one = np.ones((1, 2))
    types = GrainTypes(
        np.array([len(materials)]), np.array([materials]), np.array([[*thickness, 0.0]]),
        one, one, facetness * one,
    )  # fmt: skip
    return GrainPopulation(1e3, np.ones(1), types)


def make_scene(grains, depth=1.0, saturation=0.0, rules=None, cos=1.0, diffuse=0.0):
    """Return a slab of grains under a beam or diffuse light, with sampling rules."""
    rules = splits.Interpretation().to_sampling_rules() if rules is None else rules
    layers = Layers(
        np.array([0.0, -depth]), np.array([grains.collision_coefficient]),
        np.array([float(saturation)]),
        grains.type_cdf[np.newaxis], np.array([0]), np.array([0]), np.empty((1, 0)),
        np.array([NO_PARTICLES]),
    )  # fmt: skip
    return Scene(
        Source(float(cos), float(diffuse)),
        layers,
        grains.types,
        rules,
        None,
        NO_GROUND,
        False,
    )


def make_medium_scene(medium, incidence=0.0, analog=False, depth=None, saturation=None):
    """Return the scene of a medium, optionally with another depth or saturation."""
    scene = build_scene(medium, incidence, analog)
    layers = scene.layers
    if depth is not None:
        layers = layers._replace(boundaries=np.array([0.0, -float(depth)]))
    if saturation is not None:
        layers = layers._replace(wet_fraction=np.array([float(saturation)]))
    return scene._replace(layers=layers)


def make_oracle_slab(medium, incidence):
    """Return grains, slab and rules of a medium in the form that the oracle takes."""
    grains, rules = medium.make_grain_population(), medium.interpretation.to_sampling_rules(False)
    cos = make_medium_scene(medium, incidence).source.cos_incidence
    slab = oracle_scene.Slab(medium.depth_m, medium.saturation, cos, incidence == "diffuse")
    return (
        oracle_scene.Grains(grains.collision_coefficient, grains.type_cdf, *grains.types),
        slab,
        rules,
    )


def make_optics(n, k=None, absorption=None):
    """Return the optics of materials of given indices; defaults are 0."""
    n, k, absorption = (
        np.zeros(len(n)) if x is None else np.array(x, dtype=float) for x in (n, k, absorption)
    )
    return Optics(n, k, absorption)


def compute_optics(medium, wavelength_nm):
    """Return the optics of a medium at one wavelength."""
    index = medium.compute_refractive_indices(np.array([wavelength_nm]))[0]
    return make_bounding_optics(index, absorption_coefficient(index, wavelength_nm)[np.newaxis])


def to_single_item(optics):
    """Return optics with a leading axis for a single work item of the vectorized kernel."""
    return Optics(*(values[np.newaxis] for values in optics))


def keep_all_grains(scene):
    """Return a scene in which no grain is rejected for overlap."""
    return scene._replace(
        rules=scene.rules._replace(segment_overlap=OVERLAP_KEEP, boundary_overlap=OVERLAP_KEEP)
    )


@njit
def sample_pore(u, scene):
    """Return the pore material that a uniform number selects."""
    return ray_state.pore_material(scene.layers, 0, u)


@njit
def make_ray_at(z, d, wet=False, limit=math.inf):
    """Return a new ray at a height, in wet pores or in dry ones."""
    return make_ray(Vector(0.0, 0.0, z), d, None, 0.0 if wet else 1.0, limit, NO_MAX_ORDER)


@njit
def make_ray_after_segment(z, displacement, d, direction_back, length):
    """Return a ray at a height, displaced from the end of its previous segment."""
    position = Vector(-displacement.x, -displacement.y, z - displacement.z)
    return replace(
        make_ray_at(z, d), position=position, exit_offset=displacement,
        previous_segment=Segment(ORIGIN, direction_back, length),
    )  # fmt: skip


@njit
def find_next_event(state, ray, scene, optics):
    """Return the next sampled event of a ray."""
    return history.sample_next_event(state, ray, scene, optics)


@njit
def _trace(state, scene, optics, length, max_order):
    length[:] = 0.0
    ray = history.sample_source(state, scene, optics, None, max_order)
    if ray.status == history.ALIVE:
        ray = history.trace_history(state, ray, scene, optics, length, None, None)
    return ray


def trace_ray(state, scene, optics, max_order=NO_MAX_ORDER):
    """Return a ray at the end of its history, and its path lengths in all materials (m)."""
    length = np.zeros(optics.n.size)
    return _trace(state, scene, optics, length, max_order), length
