"""State of a ray between grains, or at its end."""

from __future__ import annotations

from typing import Any, NamedTuple

from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.vectors import ORIGIN, Vector, add

ABSORBED = 0
"""The history ended without an exit: by absorption, roulette, or the maximum order of
scattering."""
REFLECTED = 1
TRANSMITTED = 2
LOST = 3
"""Lost ray: no grain was accepted, no intersection with a surface was found, or a rough surface
extends below the top layer.  This should not happen and is reported."""
ALIVE = 4
TO_GROUND = 5
"""The ray reached the ground, or the Lambertian bottom in contact with the lowest layer."""


class Segment(NamedTuple):
    """Path segment: its end, its direction towards that end, and its length (m), −1 for none."""

    end: Vector
    direction: Vector
    length: float


NO_SEGMENT = Segment(ORIGIN, Vector(0.0, 0.0, -1.0), -1.0)
"""Previous segment of a ray that starts."""


class Ray(NamedTuple):
    """State of a ray.

    Attributes
    ----------
    status : int
        `ALIVE`, `TO_GROUND`, or the way it ended.
    position : Vector
        Point of the last event (m): the start, a boundary, a facet, a particle, or the entry point
        of a grain.
    exit_offset : Vector
        Vector from there to the exit point of the grain (m); zero except after a grain.  The ray is
        at the sum of both.
    direction : Vector
        Direction of travel.
    previous_segment : Segment
        Segment that ended at `position`; its end is unused.
    start_distance : float
        Distance at which the sampling of the next grain starts (m): that of the last skipped grain,
        or of the boundary through which the ray entered its layer.
    layer : int
        Layer of the scene in which the ray is.
    pore_variate : float
        Random number that selects the pore medium, see `state.pore_material`.
    weight : float
        Statistical weight without absorption in materials: the inverse probability of survival,
        times the single-scattering albedos of the particles hit and the reflectances of an opaque
        surface.
    optical_depth : float
        Lower bound, over the wavelengths that use the path, of the optical depth of absorption so
        far, including −ln of the albedos of particles and of the ground; for roulette only.
    next_roulette : float
        Optical depth at which Russian roulette is next played.
    n_segments : int
        Path segments in the sample, a measure of the cost.
    order : int
        Order of scattering: collisions with grains and particles, and hits of a rough surface and
        of the ground.
    max_order : int
        Order after which the ray counts as absorbed.
    stokes : Stokes or None
        Polarization; None in scenes without polarization.
    """

    status: int
    position: Vector
    exit_offset: Vector
    direction: Vector
    previous_segment: Segment
    start_distance: float
    layer: int
    pore_variate: float
    weight: float
    optical_depth: float
    next_roulette: float
    n_segments: int
    order: int
    max_order: int
    stokes: Any


@inline_only
def make_ray(position, direction, stokes, pore_variate, next_roulette, max_order):
    """Return a new ray in the top layer."""
    return Ray(
        ALIVE, position, ORIGIN, direction, NO_SEGMENT, 0.0, 0, pore_variate, 1.0, 0.0,
        next_roulette, 0, 0, max_order, stokes,
    )  # fmt: skip


@inline_only
def compute_position(ray):
    """Return the position of a ray (m)."""
    return add(ray.position, ray.exit_offset)
