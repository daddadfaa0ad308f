"""Single events of a ray history, sampled by the functions of the kernels.

Functions work in double precision like the scalar kernel, and those whose names end in `_by_lane`
in single precision, with the random numbers of a lane of the vectorized kernel.
"""

import math

import numpy as np
from chi2 import start_random_stream
from numba import njit
from scenes import make_ray_at

from splits.kernels import rng
from splits.kernels.arithmetic import Angle
from splits.kernels.grains import spheroid, surface
from splits.kernels.grains.grain_path import (
    GrainSample,
    sample_entry_variates,
    sample_interaction,
    trace_through_grain,
)
from splits.kernels.grains.spheroid import FIRST_ROULETTE_DEPTH, Spheroid
from splits.kernels.grains.surface import InteractionVariates, InterfaceState
from splits.kernels.interface import InterfaceSample
from splits.kernels.scene import ALIVE, ALL_FEATURES, NO_MAX_ORDER, UP, WRONG_SIDE_LOBE, Vector
from splits.kernels.transport import history
from splits.kernels.vectorized import lanes as lane_module
from splits.kernels.vectorized.lanes import Lane
from splits.kernels.vectorized.passes import draw_interaction_variates

single = np.float32


@njit
def sample_unit_sphere(state):
    """Return a direction uniform on the sphere (Marsaglia 1972)."""
    z = 2.0 * rng.uniform(state) - 1.0
    azimuth = rng.sample_azimuth(state)
    r = np.sqrt((1.0 - z) * (1.0 + z))
    return Vector(r * azimuth.cos, r * azimuth.sin, z)


@njit
def to_single_precision(v):
    """Return a vector in single precision."""
    return Vector(single(v.x), single(v.y), single(v.z))


@njit
def start_lane(lanes, i, start):
    """Set the random stream of a lane to its start."""
    lane = Lane(lanes, i)
    lane.key_high, lane.key_low = np.uint32(start >> np.uint64(32)), np.uint32(start)
    lane.n_drawn, lane.max_order = np.uint32(1), NO_MAX_ORDER


def make_lanes(ray=0):
    """Return the state of lanes at the start of their random streams."""
    lanes = np.zeros(lane_module.STATE_SIZE, dtype=np.uint32)
    for i in range(lane_module.N_LANES):
        start_lane(lanes, i, start_random_stream(ray + i)[0])
    return lanes


# --- grains -----------------------------------------------------------------------------------


@njit
def sample_entry(state, d, size, entry_rule):
    """Return a sampled entry point of a ray along d into a grain."""
    variates = sample_entry_variates(state, size)
    return spheroid.sample_entry_point(d, size, variates, entry_rule)


@njit
def trace_grain(state, d, size, facetness, wet, scene, optics, length):
    """Return the path of a ray through a grain of the first type, and its entry point.

    `length` is overwritten with the path lengths in the materials.
    """
    length[:] = 0.0
    entry = sample_entry(state, d, size, scene.rules.entry_sampling)
    limit = math.inf if scene.rules.analog else FIRST_ROULETTE_DEPTH
    grain_sample = GrainSample(0, size, 0.5 * facetness)
    ray = make_ray_at(0.0, d, wet, limit)
    return trace_through_grain(state, ray, grain_sample, entry, scene, optics, length), entry


@njit
def play_roulette(state, ray):
    """Return the weight of a ray after a grain and roulette, 0 if it is terminated."""
    ray = history.apply_roulette(state, ray, None)
    return ray.weight if ray.status == ALIVE else 0.0


# --- surfaces ---------------------------------------------------------------------------------


@njit
def make_flat_surface(normal):
    """Return a sphere at the point where its outward normal is `normal`."""
    return Spheroid(normal, UP, 0.0, 1.0)


@njit
def make_flat_surface_by_lane(normal):
    return Spheroid(normal, to_single_precision(UP), single(0.0), single(1.0))


@njit
def sample_facet(state, d, normal, facetness, rule):
    """Return a sampled facet of a surface, as `grain_path.sample_interaction` samples it."""
    smooth = surface.make_smooth_facet(d, make_flat_surface(normal), 1.0)
    while True:
        azimuth = rng.sample_azimuth(state)
        azimuth = Angle(abs(azimuth.cos), azimuth.sin)
        variates = InteractionVariates(
            rng.uniform(state), 0.5, 0.0, rng.sample_half_normal(state), azimuth
        )
        facet = surface.sample_microfacet(d, smooth, 0.5 * facetness, variates, False, rule)
        if facet.accepted:
            return facet


@njit
def sample_facet_by_lane(lanes, d, normal, sigma, rule):
    """Return a sampled facet of a surface, as the vectorized surface pass samples it."""
    smooth = surface.make_smooth_facet(d, make_flat_surface_by_lane(normal), single(1.0))
    while True:
        variates = draw_interaction_variates(Lane(lanes, 0), True, True)
        facet = surface.sample_microfacet(d, smooth, sigma, variates, False, rule)
        if facet.accepted:
            return facet


@njit
def compute_facet_normal(d, facet):
    """Return the normal of a facet on the side of the ray, as `reflect_or_refract` uses it."""
    normal = surface.compute_facet_normal(d, facet.normal, facet.cos_i, facet.tilt, facet.azimuth)
    sign = -1.0 if facet.back_side else 1.0
    return Vector(sign * normal.x, sign * normal.y, sign * normal.z)


@njit
def attempt_interaction(state, d, interface_state, normal, facetness, media, rules):
    """Return the result of one sampling attempt at a surface."""
    return sample_interaction(
        state, d, None, interface_state, make_flat_surface(normal), 0.5 * facetness, media, rules
    ).result


@njit
def attempt_interaction_by_lane(lanes, d, interface_state, normal, sigma, media, rules):
    """Return the result of one sampling attempt, as the vectorized surface pass makes it."""
    variates = draw_interaction_variates(Lane(lanes, 0), True, True)
    facet = surface.make_smooth_facet(d, make_flat_surface_by_lane(normal), interface_state.side)
    if sigma > single(0.0):
        facet = surface.sample_microfacet(
            d, facet, sigma, variates, interface_state.in_lobe, rules.facet_sampling
        )
    mirrored = rules.wrong_side != WRONG_SIDE_LOBE
    return surface.reflect_or_refract(
        d, interface_state, facet, media, variates.u_fresnel, mirrored, ALL_FEATURES
    )


@njit
def resolve_interaction(state, d, normal, facetness, near, far, rules):
    """Return the accepted interaction of a ray with a surface whose normal points against it."""
    interface_state = InterfaceState(0.0, 1.0, False, False)
    media = surface.relative_index(near, far)
    while True:
        result = attempt_interaction(state, d, interface_state, normal, facetness, media, rules)
        if result.accepted:
            return InterfaceSample(result.transmitted, result.direction)
        interface_state = InterfaceState(0.0, 1.0, result.needs_lobe, result.transmitted)


@njit
def resolve_interaction_by_lane(lanes, d, normal, sigma, near, far, rules):
    """Return the accepted interaction of a ray with a surface, by random numbers of a lane."""
    zero, one = single(0.0), single(1.0)
    interface_state = InterfaceState(zero, one, False, False)
    media = surface.relative_index(near, far)
    while True:
        result = attempt_interaction_by_lane(lanes, d, interface_state, normal, sigma, media, rules)
        if result.accepted:
            return InterfaceSample(result.transmitted, result.direction)
        interface_state = InterfaceState(zero, one, result.needs_lobe, result.transmitted)
