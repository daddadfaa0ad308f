"""What the scalar kernel knows of a ray on its way, and how it draws its random numbers."""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.kernels.compiler.jit import inline_only
from splits.kernels.grains.free_path import (
    Collision,
    LayerGeometry,
    RayGeometry,
    RejectionRules,
    RouletteState,
)
from splits.kernels.grains.scene import OVERLAP_KEEP, OVERLAP_SKIP
from splits.kernels.grains.spheroid import (
    EntryVariates,
    GrainSize,
    Segment,
    accept_axial_position,
)
from splits.kernels.math.elementary import Angle
from splits.kernels.math.rng import interpolate_quantile, sample_azimuth, sample_discrete, uniform
from splits.kernels.math.vectors import ORIGIN, Vector
from splits.kernels.optics.interface import ComplexIndex
from splits.kernels.optics.phase_function import PhaseFunction, sample_phase_function

_ZERO_ANGLE = Angle(1.0, 0.0)

NO_SEGMENT = Segment(ORIGIN, Vector(0.0, 0.0, -1.0), -1.0)
"""In place of the leg travelled last, for a ray that has not travelled yet."""


class RayPayload(NamedTuple):
    """What a ray carries besides its place.

    Attributes
    ----------
    direction : Vector
    layer : int
        Of the scene, in which it is.
    pore_variate : float
        The number that decides its pore: wet where it is below the layer's saturation.
    roulette : RouletteState
    """

    direction: Vector
    layer: int
    pore_variate: float
    roulette: RouletteState


class Ray(NamedTuple):
    """A ray between grains, or at its end.

    Attributes
    ----------
    status : int
        `TRAVELS`, or how it ended.
    geometry : RayGeometry
    payload : RayPayload
    n_segments, order : int
        Legs through the sample, which is what the ray cost, and grains, particles and facets of a
        rough surface met.
    max_order : int
        As many of these, after which it counts as absorbed.
    """

    status: int
    geometry: RayGeometry
    payload: RayPayload
    n_segments: int
    order: int
    max_order: int


class GrainSample(NamedTuple):
    """A grain drawn, but not yet met: its type, size and half its facetness."""

    grain_type: int
    size: GrainSize
    roughness: float


class NextEvent(NamedTuple):
    """What a ray meets next, and in which layer; `lost` where nothing was found."""

    grain_sample: GrainSample
    collision: Collision
    layer: int
    lost: bool


class EventResult(NamedTuple):
    """Whether a ray from outside passed the sample's face, and what it carries then."""

    continues: bool
    payload: RayPayload


class AttenuationResult(NamedTuple):
    """A purse after a leg, and whether the ray survived it."""

    roulette: RouletteState
    alive: bool


@inline_only
def terminate(ray, status):
    """Return a ray that has come to its end."""
    return Ray(status, ray.geometry, ray.payload, ray.n_segments, ray.order, ray.max_order)


@inline_only
def with_direction(geometry, direction):
    """Return a ray at the same place that goes along d now."""
    return RayGeometry(
        geometry.position, geometry.exit_offset, direction, geometry.previous_segment, 0.0
    )


@inline_only
def attenuate(state, roulette_state, distance, material, optics, analog, path_lengths):
    """Take a leg through a material, and tell whether the ray goes on.

    Lambert's law, SPLITS section 4.3.4 and SPLITSnow Eqs 5-6: exp(−αd) is the probability to
    pass.  Weighted rays add the leg to `path_lengths` (float64[materials], m), and end only by roulette.
    """
    path_lengths[material] += distance
    depth = optics.absorption[material] * distance
    if analog:
        return AttenuationResult(roulette_state, depth == 0.0 or uniform(state) < math.exp(-depth))
    return AttenuationResult(
        RouletteState(
            roulette_state.optical_depth + depth,
            roulette_state.next_roulette,
            roulette_state.weight,
        ),
        True,
    )


@inline_only
def pore_material(layers, layer, pore_variate):
    """Return the material of the pore space for a leg in a layer (SPLITS 4.3.2, SPLITSnow 3.4)."""
    pore = layers.pore[layer]
    if pore_variate < layers.saturation[layer]:
        return pore + 1
    for other in range(layers.pore_cdf.shape[1]):
        if pore_variate < layers.pore_cdf[layer, other]:
            return pore + 2 + other
    return pore


@inline_only
def refractive_index_of(optics, material):
    """Return the complex refractive index of a material."""
    return ComplexIndex(optics.n[material], optics.k[material])


@inline_only
def get_layer_geometry(layers, layer):
    """Return the space of a layer of a scene."""
    bottom, top = layers.boundaries[layers.boundaries.size - 1], layers.boundaries[0]
    low, high = layers.boundaries[layer + 1], layers.boundaries[layer]
    return LayerGeometry(1.0 / layers.attenuation[layer], low, high, bottom, top, min(top, 0.0))


@inline_only
def sample_grain(state, scene, layer):
    """Draw type, size, shape and roughness of a grain of a layer."""
    share, types = scene.layers.type_cdf[layer], scene.types
    kind = scene.layers.first_type[layer]
    if share.size > 1:
        kind += sample_discrete(share, uniform(state))
    major = 1.0 / interpolate_quantile(types.curvature, kind, uniform(state))
    sphericity = interpolate_quantile(types.sphericity, kind, uniform(state))
    roughness = 0.5 * interpolate_quantile(types.facetness, kind, uniform(state))
    return GrainSample(kind, GrainSize(major, 1.0 - sphericity * sphericity), roughness)


@inline_only
def sample_entry_variates(state, flattening):
    """Draw how a ray strikes a grain."""
    while True:
        aim = EntryVariates(
            uniform(state), _ZERO_ANGLE, _ZERO_ANGLE, uniform(state), uniform(state)
        )
        if accept_axial_position(aim, flattening):
            return EntryVariates(
                aim.u_cos_incidence,
                sample_azimuth(state),
                sample_azimuth(state),
                aim.u_axial,
                aim.u_accept,
            )


@inline_only
def sample_scattering_direction(state, particles, row, direction):
    """Return the direction into which a layer's particle scatters light along d."""
    size = particles.table_size[row]
    phase = PhaseFunction(
        particles.kind[row], particles.g[row], 0.0, particles.cosines[row, :size],
        particles.density[row, :size], particles.cdf[row, :size],
    )  # fmt: skip
    return sample_phase_function(state, phase, direction)


@inline_only
def make_rejection_rules(rules):
    """Return what becomes of grains that do not fit."""
    return RejectionRules(
        rules.entry_sampling,
        rules.segment_overlap != OVERLAP_KEEP,
        rules.boundary_overlap != OVERLAP_KEEP,
        rules.segment_overlap == OVERLAP_SKIP,
        rules.boundary_overlap == OVERLAP_SKIP,
    )
