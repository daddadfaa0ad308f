"""Kernel that traces rays of several work items at once on lanes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import config

from splits.kernels.compiler.jit import (
    ZERO,
    entry_point,
    entry_point_no_refcount,
    inline_allocating,
    inline_only,
    replace,
)
from splits.kernels.interface import fresnel
from splits.kernels.records import TraceResult
from splits.kernels.scene import (
    DRY_PORE,
    N_RAYS,
    NO_PARTICLES,
    WET_PORE,
    Features,
    GrainTypes,
    Optics,
    Scene,
)
from splits.kernels.tallies.exits import (
    allocate_crossings,
    count_recorded,
    enlarge_buffer,
    get_recorded,
    has_capacity,
)
from splits.kernels.vectorized import lanes
from splits.kernels.vectorized.lanes import (
    N_LANES,
    STRIDE,
    Lane,
    align_stack,
    allocate_aligned,
    set_grain_optics,
)
from splits.kernels.vectorized.layers import (
    TraceJob,
    attenuate_segment,
    compact_lanes,
    cross_boundary,
    cross_interface,
    flush_path_lengths,
    locate_layer,
    reaches_ground,
    record_lane_exit,
    reflect_from_ground,
    restart_flight,
    sample_source,
)
from splits.kernels.vectorized.passes import (
    draw_grain_properties,
    run_flight_pass,
    run_surface_pass,
)

# --------------------------------------------------------------------------------------------------
# Choice of the kernel for a scene, and the features for which it is compiled.

EXTINCTION_TOLERANCE = 1e-5
"""Largest change of the diffuse reflectance for which extinction coefficients are neglected in
reflection.  Their effect is largest for an absorbing medium of lower index."""

MIN_FIRST_DEPTH = 1e-6
"""Smallest mean depth of the first grain in a beam for single precision, in semi-major axes of the
largest grain.

It decides whether the grain fits below the boundary.  Relative to the grains that fit, 1 % of the
decisions differ at this depth from double precision, in both directions alike.
"""

MAX_INDEX = 1e3
"""Largest refractive index and extinction coefficient whose powers single precision can hold."""

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(96)

MAX_DEPTH_MFP = 1e5
"""Largest depth in mean free paths for single precision.

Rounding of positions is then below 1 % of the mean free path.
"""


def select_features(scene: Scene, optics: Optics) -> Features | None:
    """Return the features of a scene, or None if only the scalar kernel supports it.

    The vectorized kernel does not support polarization, layers of particles, grains other than
    spheroids, pores of more than two media, analog absorption, more than one coating, samples
    deeper than `MAX_DEPTH_MFP` mean free paths, beams with their first grain above
    `MIN_FIRST_DEPTH`, and indices above `MAX_INDEX` or below its inverse; and it needs the
    compiler.

    Parameters
    ----------
    scene, optics
        See `splits.kernels.scene`.
    """
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return None
    source, layers, types, rules, *_ = scene
    depth = layers.boundaries[0] - layers.boundaries[-1]
    if (layers.particle_row != NO_PARTICLES).any() or layers.pore_cdf.shape[1] > 0:
        return None
    if type(types) is not GrainTypes or scene.stokes is not None:
        return None
    if (
        rules.analog
        or types.n_shells.max() > 2
        or depth * layers.collision_coefficient.max() > MAX_DEPTH_MFP
    ):
        return None
    first_depth = (
        source.cos_incidence / layers.collision_coefficient[0] * types.inverse_semi_major.min()
    )
    if source.diffuse_fraction < 1.0 and first_depth < MIN_FIRST_DEPTH:
        return None
    if max(optics.n.max(), optics.k.max()) > MAX_INDEX or optics.n.min() < 1.0 / MAX_INDEX:
        return None
    layered = layers.collision_coefficient.size > 1
    mixed = layered or types.n_shells.size > 1 or types.n_shells.max() > 1
    absorbing = False
    if not mixed:
        core = types.material[0, 0]
        pores = [DRY_PORE, WET_PORE] if layers.wet_fraction.max() > 0.0 else [DRY_PORE]
        pairs = [(pore, core) for pore in pores] + [(core, pore) for pore in pores]
        absorbing = any(
            compute_extinction_effect(optics, near, far) > EXTINCTION_TOLERANCE
            for near, far in pairs
        )
    return Features(
        wet=_to_feature(layers.wet_fraction.max() > 0.0),
        faceted=_to_feature(bool((types.facetness > 0.0).any())),
        absorbing=_to_feature(absorbing),
        mixed=_to_feature(bool(mixed)),
        layered=_to_feature(layered),
    )


def compute_extinction_effect(optics: Optics, near: int, far: int) -> float:
    """Return the effect of the extinction of the far side on the diffuse reflectance.

    The integral of 2μ |R(n, k) − R(n, 0)| over the cosine of incidence μ.

    Parameters
    ----------
    optics : Optics
    near, far : int
        Materials on the side of incidence and on the far side.
    """
    n1, n2, k2 = float(optics.n[near]), float(optics.n[far]), float(optics.k[far])
    return float(_integrate_extinction_effect(n1, n2, k2)) if k2 > 0.0 else 0.0


@entry_point_no_refcount
def _integrate_extinction_effect(n1, n2, k2):
    """Integrate the effect on both sides of the critical angle, where the difference peaks.

    Nodes are quadratically denser towards that angle, where the reflectance has a square root.
    """
    critical = math.sqrt(max(1.0 - (n2 / n1) ** 2, 0.0)) if n2 < n1 else 0.0
    total = 0.0
    for i in range(_GAUSS_NODES.size):
        t = 0.5 * (_GAUSS_NODES[i] + 1.0)
        for span in (critical - 1.0, critical):
            # A fraction t² of the interval from the critical cosine to 1 or to 0.
            mu = critical - span * t * t
            if span != 0.0:
                effect = fresnel(n1, n2, k2, mu)[0] - fresnel(n1, n2, 0.0, mu)[0]
                total += _GAUSS_WEIGHTS[i] * t * abs(span) * 2.0 * mu * abs(effect)
    return total


def _to_feature(present: bool) -> bool | None:
    return True if present else None


# --------------------------------------------------------------------------------------------------
# Kernel that traces rays of several work items at once on lanes.


@inline_allocating
def allocate_lanes():
    """Return the state of idle lanes."""
    state = allocate_aligned(lanes.STATE_SIZE)
    for i in range(N_LANES):
        Lane(state, i).status = lanes.IDLE
    return state


@inline_only
def advance_flights(state, path_lengths, width, tables, job, crossings):
    """Sample the next grain for all lanes between grains."""
    features = job.features
    draw_grain_properties(state, width, features, tables, job.scene.layers.type_cdf)
    if features.mixed is not None:
        for i in range(width):
            lane = Lane(state, i)
            if lane.status == lanes.IN_FLIGHT:
                flush_path_lengths(lane, path_lengths[i], job.scene)
    run_flight_pass(state, width, features, job.scene.rules)
    if features.mixed is not None:
        for i in range(width):
            lane = Lane(state, i)
            if lane.status == lanes.AT_SURFACE and lane.shell == ZERO:
                set_grain_optics(lane, job)
                if features.layered is not None and not lane.segment_attenuated:
                    attenuate_segment(lane, job, path_lengths[i], crossings)


class SourceQueue(NamedTuple):
    """Rays still to be launched, and the number of active rays.

    Attributes
    ----------
    next_ray, n_rays : int
        Next ray, and number of all rays.
    item, ray_in_item : int
        Work item of the next ray, and its number within the item.
    n_active : int
        Rays in the lanes.
    lost : bool
        A ray was lost.
    """

    next_ray: int
    n_rays: int
    item: int
    ray_in_item: int
    n_active: int
    lost: bool


@inline_only
def launch_next_ray(lane, job, path_lengths, exits, queue):
    """Launch rays in a free lane until one enters the sample or none is left."""
    while queue.next_ray < queue.n_rays:
        item, number = queue.item, queue.ray_in_item
        while number == job.work[item, N_RAYS]:
            item += 1
            number = 0
        path_lengths[:] = 0.0
        entered = sample_source(lane, job, queue.next_ray, item, number)
        n_active = queue.n_active + 1 if entered else queue.n_active
        queue = replace(
            queue, next_ray=queue.next_ray + 1, item=item, ray_in_item=number + 1,
            n_active=n_active,
        )  # fmt: skip
        if entered:
            return queue
        record_lane_exit(lane, path_lengths, exits)
    lane.status = lanes.IDLE
    return queue


@inline_only
def handle_boundary(lane, job, path_lengths, crossings):
    """Handle a ray at a boundary, or one that changes its layer; return whether it leaves."""
    if lane.status == lanes.AT_GROUND:
        return True
    if job.features.layered is None:
        return cross_boundary(lane, job)
    if lane.status == lanes.RESTART:
        restart_flight(lane, job)
        return False
    if lane.status == lanes.RELOCATE:
        locate_layer(lane, job, path_lengths, crossings)
        return False
    return cross_interface(lane, job, path_lengths, crossings)


@inline_only
def handle_waiting_lanes(state, all_path_lengths, width, job, crossings, exits, n_segments, queue):
    """Record finished rays, handle rays at boundaries, and launch new rays."""
    for i in range(width):
        lane, path_lengths = Lane(state, i), all_path_lengths[i]
        status = lane.status
        if status < lanes.AT_BOUNDARY:
            continue
        if status == lanes.LANE_LOST:
            return replace(queue, lost=True)
        if status == lanes.IDLE and queue.next_ray == queue.n_rays:
            continue
        leaves = False
        if status <= lanes.RELOCATE:
            leaves = handle_boundary(lane, job, path_lengths, crossings)
            if leaves and reaches_ground(lane, job):
                reflect_from_ground(lane, job, path_lengths, crossings)
                leaves = False
            if not leaves:
                continue
        if status != lanes.IDLE:
            queue = replace(queue, n_active=queue.n_active - 1)
            n_segments[lane.item] += lane.n_segments
        if leaves:
            flush_path_lengths(lane, path_lengths, job.scene)
            record_lane_exit(lane, path_lengths, exits)
        queue = launch_next_ray(lane, job, path_lengths, exits, queue)
    return queue


@inline_only
def count_lanes(state, width):
    """Return the number of lanes in flight, and of those for `handle_waiting_lanes`."""
    n_in_flight, n_waiting = np.int32(0), np.int32(0)
    for i in range(width):
        status = Lane(state, i).status
        n_in_flight = np.int32(n_in_flight + (status == lanes.IN_FLIGHT))
        n_waiting = np.int32(n_waiting + (status >= lanes.AT_BOUNDARY))
    return n_in_flight, n_waiting


@entry_point
def trace_rays(seed, work, scene, optics, exits, features):
    """Trace the rays of several work items and record their exits.

    All items use the same lanes, which are idle only after the last ray was launched.

    Parameters
    ----------
    seed : int
    work : int64[items, 4]
        See `splits.kernels.scene`.  Results of a ray do not depend on its lane either.
    scene : Scene
        See `splits.kernels.scene`; at most one coating.
    optics : Optics
        With a row for each item.
    exits : float64[rays, columns]
        A row for each ray, item after item; must come from `exits.allocate_exits`.
    features : Features

    Returns
    -------
    TraceResult
        `n_segments` counts sampled grains.  `crossings` has the boundaries, if the scene records
        them, and the hits of the ground.
    """
    align_stack()
    types = scene.types
    tables = (
        types.inverse_semi_major.astype(np.float32),
        (1.0 - types.sphericity * types.sphericity).astype(np.float32),
        (0.5 * types.facetness).astype(np.float32),
    )
    job = TraceJob(seed, work, scene, optics, features)
    state, path_lengths = allocate_lanes(), np.zeros((N_LANES, optics.n.shape[1]))
    n_segments = np.zeros(len(work), dtype=np.int64)
    queue = SourceQueue(0, work[:, N_RAYS].sum(), 0, 0, 0, False)
    crossings = allocate_crossings(optics.n.shape[1])
    width = min(N_LANES, max(1, -(-queue.n_rays // STRIDE)) * STRIDE)
    # Between two checks of the capacity, a ray may hit a grain once and be served once.
    max_new_crossings = 2 * width * scene.layers.boundaries.size
    while True:
        if not has_capacity(crossings, max_new_crossings):
            n_kept = count_recorded(crossings)
            crossings = enlarge_buffer(crossings, n_kept, max_new_crossings)
        n_in_flight, n_waiting = count_lanes(state, width)
        if n_waiting > 0:
            queue = handle_waiting_lanes(
                state, path_lengths, width, job, crossings, exits, n_segments, queue
            )
            if queue.lost or queue.n_active == 0:
                return TraceResult(n_segments, queue.lost, get_recorded(crossings))
            if queue.n_active <= width - STRIDE:
                width = compact_lanes(state, path_lengths, width, queue.n_active)
            n_in_flight, _ = count_lanes(state, width)
        # The pass that serves more lanes is next.
        if 2 * n_in_flight >= queue.n_active:
            advance_flights(state, path_lengths, width, tables, job, crossings)
        else:
            run_surface_pass(state, width, features, scene.rules)
