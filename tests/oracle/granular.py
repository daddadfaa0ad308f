"""A slab of grains generated on the fly: the path of one ray, and rays of a work item.

SPLITS section 4.3 and SPLITSnow section 3.1: only the grain that the ray hits exists.  Distance,
type, size, shape, orientation and entry point are sampled; a grain that overlaps a boundary or the
previous segment is sampled again.  The slab is bounded by two horizontal planes.
"""

import math

import numpy as np

from oracle.absorption import WEIGHT, attenuate_segment, start_roulette
from oracle.fresnel import compute_interface, refract
from oracle.grain import sample_pore, trace_through_grain
from oracle.jit import entry, kernel
from oracle.rng import sample_table, sample_type, start_stream, uniform, unit_circle
from oracle.scene import DRY_PORE, OVERLAP_KEEP, OVERLAP_SKIP, WET_PORE
from oracle.spheroid import (
    PROJECTED,
    compute_entry_point,
    overlaps_boundary,
    overlaps_segment,
    sample_axial_position,
)
from oracle.tally import EXIT_LENGTH, record_exit

ABSORBED = 0
REFLECTED = 1
TRANSMITTED = 2
LOST = 3
"""No sampled grain was accepted, which is an error that the kernel reports."""
IN_FLIGHT = 4

MAX_REJECTIONS = 10_000_000
"""Number of consecutive rejections after which a ray is lost.  At grazing incidence few grains fit
below the boundary: 3e5 are rejected on average at 89.9999 degrees."""

NO_SEGMENT = (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, -1.0)
"""The previous segment of a ray at its start."""


@kernel
def cross_interface(state, dx, dy, dz, n1, n2, k2):
    """Reflect or refract a ray at a smooth horizontal boundary from index n1 to n2 + i k2.

    Returns
    -------
    passed : bool
    d : 3 float
    """
    up = math.copysign(1.0, -dz)
    cos_i = max(abs(dz), 1e-12)
    reflectance, ratio, cos_t = compute_interface(n1, n2, k2, cos_i)
    if uniform(state) < reflectance:
        return False, dx, dy, -dz
    dx, dy, dz = refract(dx, dy, dz, 0.0, 0.0, up, cos_i, ratio, cos_t)
    return True, dx, dy, dz


@kernel
def make_no_collision(distance):
    """Return the result of `sample_collision` when the ray hits no grain."""
    return distance, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@kernel
def sample_collision(state, z, dx, dy, dz, to_boundary, previous_segment, grains, slab, rules):
    """Sample the next grain on a ray, unless the ray reaches a boundary first.

    SPLITS 4.3.3: distance from Eq 21 (SPLITSnow Eq 1), then size, shape and entry point; a grain
    that overlaps a boundary or the previous segment is sampled again, distance included, from the
    same origin.  Skipping such grains instead, which is not in the papers, thins the Poisson
    process of grains along the ray.

    Parameters
    ----------
    z : float
        Height of the ray's origin (m).
    dx, dy, dz : float
        Direction of the ray.
    to_boundary : float
        Distance to the boundary ahead (m), or infinity.
    previous_segment : 7 float
        Vector from the end of the previous segment to the origin of this one, and direction and
        length of the previous segment; length −1 when there is none.

    Returns
    -------
    distance : float
        Distance to the grain; `to_boundary` when no grain comes first; −1 when none is accepted.
    kind, minor, flattening : int, float, float
    q, w, n : 3 float each
        Entry point, major axis, outward normal, see `splits.kernels.grains.spheroid`.
    """
    g1, g2, g3, lx, ly, lz, last_length = previous_segment
    skipped_distance = 0.0
    for _ in range(MAX_REJECTIONS):
        distance = skipped_distance - math.log(uniform(state)) / grains.attenuation
        if distance >= to_boundary:
            return make_no_collision(to_boundary)
        kind = 0
        if grains.type_cdf.size > 1:
            kind = sample_type(grains.type_cdf, uniform(state))
        curvature = sample_table(grains.curvature, kind, uniform(state))
        sphericity = sample_table(grains.sphericity, kind, uniform(state))
        ratio = sphericity * sphericity
        flattening = 1.0 - ratio
        major = 1.0 / curvature
        minor = ratio * major
        axial = sample_axial_position(state, flattening)
        cos_incidence = uniform(state)
        if rules.entry_sampling == PROJECTED:
            cos_incidence = math.sqrt(cos_incidence)
        ca, sa = unit_circle(state)
        ct, st = unit_circle(state)
        q1, q2, q3, w1, w2, w3, n1, n2, n3 = compute_entry_point(
            dx, dy, dz, cos_incidence, ca, sa, axial, ct, st, flattening
        )
        if rules.boundary_overlap != OVERLAP_KEEP and overlaps_boundary(
            z + distance * dz, q3, w3, axial, minor, major, slab.depth
        ):
            if rules.boundary_overlap == OVERLAP_SKIP:
                skipped_distance = distance
            continue
        if rules.segment_overlap != OVERLAP_KEEP and last_length > 0.0 and overlaps_segment(
            q1, q2, q3, w1, w2, w3, minor, flattening,
            -g1 - distance * dx, -g2 - distance * dy, -g3 - distance * dz, lx, ly, lz, last_length,
        ):  # fmt: skip
            if rules.segment_overlap == OVERLAP_SKIP:
                skipped_distance = distance
            continue
        return distance, kind, minor, flattening, q1, q2, q3, w1, w2, w3, n1, n2, n3
    return make_no_collision(-1.0)


@kernel
def sample_source(state, slab, rules, optics):
    """Start a ray at the top of the slab.

    Returns
    -------
    status : int
        `IN_FLIGHT`, or `REFLECTED` by the boundary of a wet pore.
    d : 3 float
        Direction.
    pore : int
        Material of the pore space that the ray enters.
    """
    mu = math.sqrt(uniform(state)) if slab.diffuse else slab.cos_incidence
    dx, dy, dz = math.sqrt(max(0.0, 1.0 - mu * mu)), 0.0, -mu
    pore = sample_pore(state, slab.saturation)
    if pore == WET_PORE and rules.boundary_fresnel:
        passed, dx, dy, dz = cross_interface(
            state, dx, dy, dz, optics.n[DRY_PORE], optics.n[pore], optics.k[pore]
        )
        if not passed:
            return REFLECTED, dx, dy, dz, pore
    return IN_FLIGHT, dx, dy, dz, pore


@kernel
def trace_history(
    state, x, y, z, dx, dy, dz, previous_segment, pore,
    grains, slab, rules, optics, path_lengths, roulette_state, max_order,
):  # fmt: skip
    """Trace a ray until it leaves the slab or is absorbed.

    Parameters
    ----------
    state, grains, slab, rules, optics
        See `trace_ray`.
    x, y, z, dx, dy, dz : float
        Origin and direction.
    previous_segment : 7 float
        See `sample_collision`.
    pore : int
        Material of the next segment.
    path_lengths, roulette_state : float64[materials], float64[3]
        Advanced in place.
    max_order : int
        Order of scattering after which a ray counts as absorbed.

    Returns
    -------
    status : int
        `ABSORBED`, `REFLECTED`, `TRANSMITTED` or `LOST`.
    x, y, z, dx, dy, dz, previous_segment, pore
        State of the ray at the end.
    n_segments, order : int
        Number of segments through the pore space, and order of scattering.
    """
    g1, g2, g3, lx, ly, lz, last_length = previous_segment
    n_segments = 0
    order = 0
    while True:
        n_segments += 1
        to_boundary = math.inf
        if dz > 0.0:
            to_boundary = -z / dz
        elif dz < 0.0:
            to_boundary = (-slab.depth - z) / dz
        previous_segment = (g1, g2, g3, lx, ly, lz, last_length)
        distance, kind, minor, flattening, q1, q2, q3, w1, w2, w3, n1, n2, n3 = sample_collision(
            state, z, dx, dy, dz, to_boundary, previous_segment, grains, slab, rules
        )
        if distance < 0.0:
            return LOST, x, y, z, dx, dy, dz, previous_segment, pore, n_segments, order
        hits_boundary = distance >= to_boundary
        if hits_boundary:
            distance = to_boundary
        if not attenuate_segment(
            state, distance, pore, optics, rules, path_lengths, roulette_state
        ):
            return ABSORBED, x, y, z, dx, dy, dz, previous_segment, pore, n_segments, order
        lx, ly, lz, last_length = dx, dy, dz, distance
        x += distance * dx
        y += distance * dy
        z += distance * dz
        if hits_boundary:
            z = 0.0 if dz > 0.0 else -slab.depth
            g1, g2, g3 = 0.0, 0.0, 0.0
            passed = True
            if pore == WET_PORE and rules.boundary_fresnel:
                passed, dx, dy, dz = cross_interface(
                    state, dx, dy, dz, optics.n[pore], optics.n[DRY_PORE], 0.0
                )
            if passed:
                status = REFLECTED if dz > 0.0 else TRANSMITTED
                return status, x, y, z, dx, dy, dz, previous_segment, pore, n_segments, order
            continue
        if order == max_order:
            return ABSORBED, x, y, z, dx, dy, dz, previous_segment, pore, n_segments, order
        order += 1
        facetness = sample_table(grains.facetness, kind, uniform(state))
        alive, g1, g2, g3, dx, dy, dz, pore = trace_through_grain(
            state, q1, q2, q3, dx, dy, dz, w1, w2, w3, n1, n2, n3,
            minor, flattening, facetness, kind, pore, slab.saturation,
            grains, optics, rules, path_lengths, roulette_state,
        )  # fmt: skip
        if not alive:
            return ABSORBED, x, y, z, dx, dy, dz, previous_segment, pore, n_segments, order
        # The ray is outside the slab only if overlap with a boundary is ignored, or by rounding.
        # It is then placed on that boundary.
        z = min(max(z + g3, -slab.depth), 0.0)
        x += g1
        y += g2


@kernel
def trace_ray(state, grains, slab, rules, optics, path_lengths, roulette_state, max_order):
    """Trace one ray from the light source until it leaves the slab or is absorbed.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    grains, slab, rules, optics
        See `splits.kernels.scene`.
    path_lengths : float64[materials]
        Set to the path length in each material (m).
    roulette_state : float64[3]
        Set to the roulette state, see `oracle.absorption`.
    max_order : int
        Order of scattering after which the ray counts as absorbed, or `NO_MAX_ORDER`.

    Returns
    -------
    status : int
        `ABSORBED`, `REFLECTED`, `TRANSMITTED` or `LOST`.
    x, y, z, dx, dy, dz : float
        Point and direction of exit, the latter outside the slab.
    n_segments : int
        Number of segments through the pore space, which measures the cost of the ray.
    order : int
        Order of scattering.
    """
    path_lengths[:] = 0.0
    start_roulette(roulette_state)
    status, dx, dy, dz, pore = sample_source(state, slab, rules, optics)
    if status != IN_FLIGHT:
        return status, 0.0, 0.0, 0.0, dx, dy, dz, 0, 0
    status, x, y, z, dx, dy, dz, _, _, n_segments, order = trace_history(
        state, 0.0, 0.0, 0.0, dx, dy, dz, NO_SEGMENT, pore,
        grains, slab, rules, optics, path_lengths, roulette_state, max_order,
    )  # fmt: skip
    return status, x, y, z, dx, dy, dz, n_segments, order


@entry
def trace_rays(seed, work, grains, slab, rules, optics, exits):
    """Trace the rays of a work item and record their exits.

    Parameters
    ----------
    seed : int
    work : int64[4]
        Ensemble, first ray, number of rays, and order of scattering after which a ray counts as
        absorbed.  Seed, ensemble and number of a ray determine its random stream.
    grains, slab, rules, optics
        See `splits.kernels.scene`.
    exits : float64[rays, columns]
        A row for each ray, see `oracle.tally`; must come from `allocate_exits`.

    Returns
    -------
    n_segments : int
        Number of segments traced.
    lost : bool
        Whether a ray was lost, which ends the call early.
    """
    n_segments = 0
    materials = optics.n.size
    path_lengths = np.zeros(materials)
    roulette_state = np.zeros(3)
    state = np.zeros(1, dtype=np.uint64)
    for ray in range(work[2]):
        start_stream(state, seed, work[0], work[1] + ray)
        status, x, y, _, dx, dy, dz, n_ray_segments, order = trace_ray(
            state, grains, slab, rules, optics, path_lengths, roulette_state, work[3]
        )
        n_segments += n_ray_segments
        if status == LOST:
            return n_segments, True
        if status == ABSORBED:
            continue
        weight = roulette_state[WEIGHT]
        record_exit(exits[ray], status == REFLECTED, x, y, dx, dy, dz, weight, order)
        exits[ray, EXIT_LENGTH : EXIT_LENGTH + materials] = path_lengths
    return n_segments, False
