"""Surface of a grain: microfacets, and the interaction of rays with them, polarized or not."""

from __future__ import annotations

from typing import Any, NamedTuple

from splits.kernels.arithmetic import (
    Angle,
    add_scaled,
    cross,
    dot,
    fma,
    get_precision,
    linear_combination,
    normalize,
    reflect,
    rsqrt,
    scale,
    select,
    sqrt,
)
from splits.kernels.compiler.jit import HALF, ONE, TWO, ZERO, inline, inline_only
from splits.kernels.grains.spheroid import compute_outward_normal
from splits.kernels.interface import (
    NormalWave,
    apply_mueller,
    compute_mueller,
    normal_component,
    rotate_to_plane_of_incidence,
    unpolarized_reflectance,
)
from splits.kernels.scene import ALL_FEATURES, ANY_FACETS, PROJECTED_FACETS, Stokes, Vector
from splits.kernels.stokes import make_unpolarized

# --------------------------------------------------------------------------------------------------
# Microfacets: sampling of the facet normal at a rough grain surface.
#
# SPLITS section 4.2.3, Eq 3 and section 4.3.4; SPLITSnow section 3.3, Eqs 3-4: the facet normal n'
# is tilted from the macroscopic normal n by n·n' = 1 − |ξ|, ξ normal with standard deviation
# facetness/2 and n·n' > 0, at a uniform azimuth.  Facets have equal area, so a ray along d hits one
# with probability proportional to its projected area |n'·d|, among those facing the ray.


class FacetSample(NamedTuple):
    """Sampled facet, accepted or not.

    Attributes
    ----------
    accepted : bool
        False requires another sample.
    cos_azimuth : float
        Cosine of the azimuth of the facet from the tangential part of −d, with its sign.
    cos_incidence : float
        Cosine of incidence on the facet, −d·n' (negative only under `ANY_FACETS`).
    """

    accepted: bool
    cos_azimuth: float
    cos_incidence: float


class Microfacet(NamedTuple):
    """Surface and facet at the hit point of a ray.

    Attributes
    ----------
    normal : Vector
        Normal of the macroscopic surface, on the side of the ray.
    cos_i : float
        Cosine of incidence on it.
    accepted : bool
    back_side : bool
        The ray hits the back side of the facet.
    cos_facet : float
        Cosine of incidence on the facet.
    tilt, azimuth : Angle
        See `compute_facet_normal`, for a facet or a lobe.
    cos_lobe_azimuth : float
        Cosine of the azimuth of a lobe; its sine is that of the facet.
    """

    normal: Vector
    cos_i: float
    accepted: bool
    back_side: bool
    cos_facet: float
    tilt: Angle
    azimuth: Angle
    cos_lobe_azimuth: float


@inline
def sample_projected_facet(tilt, cos_azimuth, incidence, u):
    """Accept or reject a facet in proportion to its projected area, and determine its azimuth.

    Exact rejection sampling of two mirror azimuths at once: for φ and π − φ the weights are
    max(0, A ± B), A = cosτ cosθ, B = sinτ sinθ |cosφ|; their sum never exceeds max(2 cosθ, 1),
    and the fraction of the second determines the sign of cosφ.

    Parameters
    ----------
    tilt : Angle
        τ, from n.
    cos_azimuth : float
        |cosφ|.
    incidence : Angle
        θ, between −d and n.
    u : float
        A uniform random number.
    """
    a = tilt.cos * incidence.cos
    b = tilt.sin * incidence.sin * cos_azimuth
    opposite = max(ZERO, a - b)
    variate = u * max(TWO * incidence.cos, ONE)
    mirror = variate < opposite
    cos_facet = a - b if mirror else a + b
    return FacetSample(
        variate < a + b + opposite, -cos_azimuth if mirror else cos_azimuth, cos_facet
    )


@inline
def sample_unweighted_facet(tilt, cos_azimuth, incidence, u, rule):
    """Sample a facet with the rule `UNWEIGHTED_FACETS` or `ANY_FACETS`."""
    cos_azimuth = -cos_azimuth if u < HALF else cos_azimuth
    cos_facet = fma(tilt.cos, incidence.cos, tilt.sin * incidence.sin * cos_azimuth)
    accepted = (cos_facet > ZERO) | ((rule == ANY_FACETS) & (cos_facet < ZERO))
    return FacetSample(accepted, cos_azimuth, cos_facet)


@inline
def compute_facet_normal(d, n, cos_i, tilt, azimuth):
    """Return the normal of a facet, with azimuths from the tangential part of −d.

    c n + (s / sinθ) (cosφ t + sinφ d×n), t = −d − cosθ n: both tangents have length sinθ.

    Parameters
    ----------
    d, n : Vector
    cos_i : float
        cosθ.
    tilt : Angle
        Cosine c of the tilt, and s / sinθ in place of its sine.
    azimuth : Angle
    """
    p = tilt.sin * azimuth.cos
    q = tilt.sin * azimuth.sin
    a = fma(-p, cos_i, tilt.cos)
    return add_scaled(q, cross(d, n), add_scaled(-p, d, scale(a, n)))


@inline
def make_smooth_facet(d, grain, side):
    """Return the smooth surface at the position of a ray along d, as its only facet."""
    normal = scale(side, compute_outward_normal(grain))
    cos_i = max(-dot(d, normal), get_precision(d.x).min_cos_incidence)
    precision = get_precision(d.x)
    flat = Angle(precision.one, precision.zero)
    return Microfacet(normal, cos_i, True, False, cos_i, flat, flat, precision.one)


@inline
def sample_microfacet(d, smooth, roughness, variates, in_lobe, rule):
    """Sample a facet of a rough surface with a rule, by default `PROJECTED_FACETS`."""
    normal, cos_i = smooth.normal, smooth.cos_i
    tangential = add_scaled(cos_i, normal, d)
    square = max(dot(tangential, tangential), get_precision(d.x).min_sin2_incidence)
    per_sin = rsqrt(square)
    incidence = Angle(cos_i, square * per_sin)
    # 1 − n·n' = |ξ|, ξ ~ N(0, facetness/2) (SPLITSnow Eqs 3-4), below 1.
    one_minus_cos_tilt = roughness * variates.half_normal
    # One root serves the sine of a facet or of a lobe.
    tilt = Angle(
        ONE - one_minus_cos_tilt,
        sqrt(
            max(
                ONE - variates.u_fresnel
                if in_lobe
                else one_minus_cos_tilt * (TWO - one_minus_cos_tilt),
                ZERO,
            )
        ),
    )
    half = variates.azimuth
    cos_lobe = -half.cos if variates.u_facet < HALF else half.cos
    if rule != PROJECTED_FACETS:
        sample = sample_unweighted_facet(tilt, half.cos, incidence, variates.u_facet, rule)
    else:
        sample = sample_projected_facet(tilt, half.cos, incidence, variates.u_facet)
    return Microfacet(
        normal,
        cos_i,
        sample.accepted & (one_minus_cos_tilt < ONE),
        sample.cos_incidence < ZERO,
        max(abs(sample.cos_incidence), get_precision(d.x).min_cos_incidence),
        Angle(tilt.cos, tilt.sin * per_sin),
        Angle(sample.cos_azimuth, half.sin),
        cos_lobe,
    )


# --------------------------------------------------------------------------------------------------
# Interaction of a ray with the surface of a grain: microfacet, Fresnel, and next region.
#
# SPLITS section 4.3.4 and SPLITSnow section 3.3: at each hit of the surface a microfacet is
# sampled, the Fresnel reflectance decides between reflection and refraction, and inside the grain
# the ray goes from surface to surface until it leaves or is absorbed.  After a rejected attempt the
# ray has not moved, and the interaction is repeated, with a cosine lobe if the direction was on the
# wrong side.
#
# The shells of a grain are numbered inwards: 0 is the pore space, then come the coatings and the
# core.  A coating is so thin that it acts as a flat slab where the ray hits it: a path segment
# through it has the length h/|n·d| and leaves the point on the grain unchanged (SPLITS 4.2.3,
# 4.3.4). The pore is sampled again whenever a ray reaches the outermost interface from the inside
# (SPLITS 4.3.2) and when it is reflected there from the outside (SPLITSnow 3.3).
#
# The scalar and the vectorized kernel load a ray, look up the media on both sides, and store the
# results of these functions, which serve both precisions and have no loops and no branches.


class InteractionVariates(NamedTuple):
    """Random numbers of an interaction; the last two are used for rough grains only.

    Attributes
    ----------
    u_facet, u_fresnel, u_pore : float
        Uniform.
    half_normal : float
        Absolute value of a standard normal number.
    azimuth : Angle
        Uniform on the half circle with positive cosine.
    """

    u_facet: float
    u_fresnel: float
    u_pore: float
    half_normal: float
    azimuth: Angle


class InterfaceState(NamedTuple):
    """Position of a ray among the shells of a grain.

    Attributes
    ----------
    shell : float
        0 in the pore space, 1 in the outermost shell of the grain, and so on to its core.
    side : float
        1 if the ray travels inwards, −1 outwards.
    in_lobe : bool
        The next interaction samples a cosine lobe, because the last direction was on the wrong side
        of the surface.
    transmitted_lobe : bool
        The lobe is on the far side.
    """

    shell: float
    side: float
    in_lobe: bool
    transmitted_lobe: bool


class RelativeIndex(NamedTuple):
    """Refractive index of the far side of an interface relative to the near side.

    Attributes
    ----------
    m, m_minus_1 : float
        Real part of the relative index, and that minus 1.
    k : float
        Imaginary part; unused if extinction does not affect reflection.
    inverse : float
        1/m; used in that case only.
    equal : bool
        Both media are the same and there is no interface; used in mixed scenes only.
    """

    m: float
    m_minus_1: float
    k: float
    inverse: float
    equal: bool


class InteractionResult(NamedTuple):
    """Result of one interaction.

    Attributes
    ----------
    direction : Vector
        New direction.
    transmitted : bool
        Whether the ray continues on the far side.
    accepted : bool
        False requires another interaction.
    needs_lobe : bool
        The next interaction samples a cosine lobe.
    cos_out : float
        Cosine between the new direction and the surface normal on the near side.
    """

    direction: Vector
    transmitted: bool
    accepted: bool
    needs_lobe: bool
    cos_out: float


class NextRegion(NamedTuple):
    """Region of a ray after an interaction.

    Attributes
    ----------
    interface : InterfaceState
        State for the next interaction.
    in_pore : bool
        The ray is back in the pore space.
    in_coating, in_core : bool
        The ray crosses a coating, or the core.
    """

    interface: InterfaceState
    in_pore: bool
    in_coating: bool
    in_core: bool


@inline
def relative_index(near, far):
    """Return the `RelativeIndex` of two media of complex index n + i k."""
    per_near = ONE / near.n
    same = (near.n == far.n) & (near.k == far.k)
    m, m_minus_1 = far.n * per_near, (far.n - near.n) * per_near
    return RelativeIndex(m, m_minus_1, far.k * per_near, near.n / far.n, same)


@inline
def compute_transmitted_wave(media, cos_facet, sin2, features):
    """Return the `NormalWave` of the transmitted light, and the `sine_ratio` of `FresnelResult`."""
    if features.mixed is None and features.absorbing is None:
        wave = normal_component(media.m, media.m_minus_1, ZERO, cos_facet, False)
        return wave, media.inverse
    wave = normal_component(media.m, media.m_minus_1, media.k, cos_facet, True)
    if features.mixed is None:
        return wave, rsqrt(fma(wave.a, wave.a, sin2))
    a = cos_facet if media.equal else wave.a
    b2 = ZERO if media.equal else wave.b2
    ratio = ONE if media.equal else rsqrt(fma(a, a, sin2))
    return NormalWave(a, b2), ratio


@inline
def reflect_or_refract(d, interface, facet, media, u, mirror_wrong_side, features):
    """Reflect or refract a ray at a facet, or direct it into a cosine lobe.

    Parameters
    ----------
    d : Vector
    interface : InterfaceState
    facet : Microfacet
    media : RelativeIndex
    u : float
        A uniform random number.
    mirror_wrong_side : bool
        Directions on the wrong side of the surface are mirrored in it, instead of the cosine lobe
        (SPLITS 4.3.4) that represents multiple scattering between facets.
    features : Features

    Returns
    -------
    InteractionResult
    """
    normal, cos_facet, lobe = facet.normal, facet.cos_facet, interface.in_lobe
    sin2 = max((ONE - cos_facet) * (ONE + cos_facet), ZERO)
    wave, ratio = compute_transmitted_wave(media, cos_facet, sin2, features)
    numerator, denominator = unpolarized_reflectance(
        media.m, media.m_minus_1, media.k, cos_facet, sin2, wave
    )
    reflected = (u * denominator < numerator) | (wave.a == ZERO)
    if features.mixed is not None:
        reflected = reflected & (not media.equal)
    transmitted = not reflected
    # Both directions are g d + h n' for a facet of normal n'; that of a lobe is n' alone.
    g = ONE if reflected else ratio
    h = TWO * cos_facet if reflected else ratio * (cos_facet - wave.a)
    facet_normal_vector = normal
    if features.faceted is not None:
        h = -h if facet.back_side else h
        g = ZERO if lobe else g
        h = ONE if lobe else h
        transmitted = interface.transmitted_lobe if lobe else transmitted
        cos_lobe = sqrt(u)
        c = (-cos_lobe if transmitted else cos_lobe) if lobe else facet.tilt.cos
        cos_azimuth = facet.cos_lobe_azimuth if lobe else facet.azimuth.cos
        tilt, azimuth = Angle(c, facet.tilt.sin), Angle(cos_azimuth, facet.azimuth.sin)
        facet_normal_vector = compute_facet_normal(d, normal, facet.cos_i, tilt, azimuth)
    # Computed normals are shorter than 1 by 1e-8 on average.  Uncorrected, rays in smooth spheres,
    # where all reflections are equal, would drift into total reflection and never leave; the
    # correction makes the remaining drift lead outwards.
    h = fma(h, ONE - dot(facet_normal_vector, facet_normal_vector), h)
    e = normalize(linear_combination(g, d, h, facet_normal_vector))
    cos_out = dot(e, normal)
    if features.faceted is None:
        return InteractionResult(e, transmitted, True, False, cos_out)
    correct_side = (cos_out < ZERO) if transmitted else (cos_out > ZERO)
    e = select(mirror_wrong_side & (not correct_side), reflect(e, normal), e)
    correct_side = correct_side | mirror_wrong_side
    accepted = lobe | (facet.accepted & correct_side)
    return InteractionResult(
        e, transmitted, accepted, (not lobe) & facet.accepted & (not correct_side), cos_out
    )


@inline
def find_next_region(interface, result, core_shell, mixed):
    """Return the `NextRegion` of a ray after an interaction.

    Parameters
    ----------
    interface : InterfaceState
    result : InteractionResult
    core_shell : float
        Shell number of the core.
    mixed : True or None
        None if no grain has coatings.
    """
    accepted = result.accepted
    shell = interface.shell + interface.side if result.transmitted else interface.shell
    out = shell == ZERO
    if mixed is None:
        in_core = not out
        side = -ONE
    else:
        in_core = shell == core_shell
        side = interface.side if result.transmitted else -interface.side
        side = -ONE if in_core else side
    shell = shell if accepted else interface.shell
    side = side if accepted else interface.side
    interface = InterfaceState(shell, side, result.needs_lobe, result.transmitted)
    return NextRegion(
        interface, accepted & out, accepted & (not out) & (not in_core), accepted & in_core
    )


@inline
def compute_coating_path_length(thickness, result, in_coating):
    """Return the path length in a coating (m), 0 if none is crossed."""
    length = thickness / max(abs(result.cos_out), get_precision(result.cos_out).min_cos_incidence)
    return length if in_coating else ZERO


# --------------------------------------------------------------------------------------------------
# Interaction of polarized light with the surface of a grain.
#
# The facet is that of the scalar interaction.  The Mueller matrices of Fresnel's equations apply to
# it, with the plane of incidence on the facet as reference.  Whether light is reflected is sampled
# with the reflectance of the polarized light.  A cosine lobe, which represents multiple scattering
# between facets, depolarizes.


class SurfaceInteraction(NamedTuple):
    """An `InteractionResult`, and the `Stokes` (or None) after it."""

    result: InteractionResult
    stokes: Any


@inline_only
def reflect_or_refract_polarized(d, stokes, interface, facet, media, u, mirror_wrong_side):
    """Reflect or refract polarized light at a facet, or direct it into a cosine lobe.

    Parameters
    ----------
    d : Vector
    stokes : Stokes
    interface, facet, media, u, mirror_wrong_side
        See `reflect_or_refract`.

    Returns
    -------
    SurfaceInteraction
        With the polarization of the incident light if the interaction must be repeated.
    """
    normal = compute_facet_normal(d, facet.normal, facet.cos_i, facet.tilt, facet.azimuth)
    if facet.back_side:
        normal = scale(-1.0, normal)
    light = rotate_to_plane_of_incidence(d, stokes, normal)
    k = 0.0 if media.equal else media.k
    mueller = compute_mueller(media.m, media.m_minus_1, k, facet.cos_facet)
    if not interface.in_lobe:
        # A variate of 0 or 1 has the scalar interaction reflect or refract.
        reflectance = mueller.reflection.plus + mueller.reflection.minus * light.q
        u = 0.0 if u < reflectance else 1.0
    result = reflect_or_refract(d, interface, facet, media, u, False, ALL_FEATURES)
    if interface.in_lobe:
        return SurfaceInteraction(result, make_unpolarized(result.direction, stokes))
    if not (result.accepted or (mirror_wrong_side and result.needs_lobe)):
        return SurfaceInteraction(result, stokes)
    elements = mueller.transmission if result.transmitted else mueller.reflection
    stokes = apply_mueller(result.direction, light, elements)
    if not result.accepted:
        # A mirror image reverses the sense of U and V.
        direction = reflect(result.direction, facet.normal)
        e = reflect(stokes.e, facet.normal)
        stokes = Stokes(e, stokes.q, -stokes.u, -stokes.v)
        result = InteractionResult(
            direction, result.transmitted, True, False, dot(direction, facet.normal)
        )
    return SurfaceInteraction(result, stokes)
