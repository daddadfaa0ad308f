"""Randomly rough surface on top of layers of grains and particles (Budak & Grimailo 2020, 3.2).

Every ray has its own realization of the surface.  In the sample a ray may hit facets on its way to
the next particle; outside it is traced from facet to facet until it is in the sample again or
leaves.  A facet is the tangent plane at the point hit.  For a smooth top, `rough_top` is None and
all of this is compiled away.
"""

from __future__ import annotations

from splits.kernels.base.ray import ABSORBED, LOST, NO_SEGMENT, REFLECTED, compute_position
from splits.kernels.compiler.jit import inline_only
from splits.kernels.compiler.replace import replace
from splits.kernels.grains.state import interface_index, pore_material
from splits.kernels.math.vectors import ORIGIN, add_scaled, scale
from splits.kernels.optics.scattering import reflect_or_refract_ray
from splits.kernels.rough_surface.intersection import (
    NO_HIT,
    STEP_LIMIT_REACHED,
    compute_normal_from_slope,
    find_first_intersection,
    nudge_off_surface,
)
from splits.kernels.transport.events import reflect_from_opaque, sample_pore_variate
from splits.kernels.transport.flight import NO_EVENT, ROUGH_TOP

MAX_HEIGHT_SIGMA = 50.0
"""Bound of the height of realizations in standard deviations.

`bands.BOUND_SIGMA` times the root of −ln u, with u the smallest random number, is below it.
"""


@inline_only
def intersect_rough_top(rough_top, ray, event, layer_bottom):
    """Return the event of a ray in the sample, which is a hit of the rough top if that comes first.

    The ray is lost if the search was undecided, or if the surface extends below `layer_bottom` (m),
    see `ParticleLayer.depth_m`.
    """
    if rough_top is None:
        return event
    start, d = compute_position(ray), ray.direction
    is_below = max(start.z, start.z + event.distance * d.z) <= -rough_top.max_height
    if event.kind == NO_EVENT or is_below:
        return event
    hit = find_first_intersection(rough_top, start, d, -1.0, event.distance)
    if hit.distance == NO_HIT:
        return event
    position = add_scaled(hit.distance, d, start)
    lost = hit.distance == STEP_LIMIT_REACHED or position.z < layer_bottom
    return replace(
        event, kind=NO_EVENT if lost else ROUGH_TOP, layer=0, distance=hit.distance,
        position=position, slope=hit.slope,
    )  # fmt: skip


@inline_only
def scatter_at_facet(state, ray, slope, side, scene, optics):
    """Return a ray after reflection or refraction at a facet, and its side of the surface.

    Parameters
    ----------
    state, ray, scene, optics
        See `splits.kernels.transport.history.trace_history`.
    slope : SurfaceSlope
        Slope of the facet.
    side : float
        1 if the ray comes from outside, −1 from the sample.
    """
    # The top layer has particles, and one medium.  The new variate selects the pore behind it.
    pore_variate = sample_pore_variate(state, scene)
    inside = interface_index(scene, optics, pore_material(scene.layers, 0, pore_variate))
    outside = interface_index(scene, optics, scene.layers.first_pore_material[0])
    normal = compute_normal_from_slope(slope)
    if scene.opaque is not None:
        ray = reflect_from_opaque(ray, normal, outside, inside)
    else:
        near = outside if side > 0.0 else inside
        far = inside if side > 0.0 else outside
        sample = reflect_or_refract_ray(
            state, ray.direction, ray.stokes, scale(side, normal), near, far
        )
        ray = replace(ray, direction=sample.direction, stokes=sample.stokes)
        side = -side if sample.transmitted else side
    direction = nudge_off_surface(ray.direction, scale(side, normal))
    ray = replace(ray, direction=direction, layer=0, pore_variate=pore_variate, order=ray.order + 1)
    return ray, side


@inline_only
def trace_above_surface(state, ray, scene, optics, rough_top):
    """Trace a ray above the surface until it enters the sample or leaves.

    Returns
    -------
    Ray
        With the status `ALIVE` in the sample, `REFLECTED`, `LOST`, or `ABSORBED` at the largest
        order of scattering.
    """
    side = 1.0
    while side > 0.0:
        hit = find_first_intersection(rough_top, ray.position, ray.direction, side)
        if hit.distance < 0.0:
            leaves = hit.distance == NO_HIT and ray.direction.z > 0.0
            return replace(ray, status=REFLECTED if leaves else LOST)
        if ray.order >= ray.max_order:
            return replace(ray, status=ABSORBED)
        position = add_scaled(hit.distance, ray.direction, ray.position)
        ray = replace(
            ray, position=position, exit_offset=ORIGIN, previous_segment=NO_SEGMENT,
            start_distance=0.0,
        )  # fmt: skip
        ray, side = scatter_at_facet(state, ray, hit.slope, side, scene, optics)
    return ray


@inline_only
def interact_at_rough_top(state, ray, slope, scene, optics, rough_top):
    """Return a ray from the sample after a hit of the rough top.

    Parameters are those of `scatter_at_facet` and `trace_above_surface`.
    """
    if rough_top is None:
        # Compiles the rest away under a smooth top.
        return ray
    if ray.order >= ray.max_order:
        return replace(ray, status=ABSORBED)
    ray, side = scatter_at_facet(state, ray, slope, -1.0, scene, optics)
    return trace_above_surface(state, ray, scene, optics, rough_top) if side > 0.0 else ray
