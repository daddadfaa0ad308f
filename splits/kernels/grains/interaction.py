"""One trial at a grain's surface: facet, Fresnel, direction, way through the grain.

SPLITS section 4.3.4 and SPLITSnow section 3.3: at each meeting with the surface a microfacet is
drawn, Fresnel's reflectance decides between reflection and refraction, and inside the grain the
walk goes from wall to wall until the ray leaves or is absorbed.  A trial that is rejected changes
nothing; another follows.

The shells of a grain are numbered from 0, the pore space, over the coatings inwards to the core.
A coating is so thin that it acts where the ray meets it as a flat slab: a leg through it is h/|n·d|
long and leaves the point on the grain unchanged (SPLITS 4.2.3, 4.3.4).  The pore is drawn anew
whenever a ray reaches the outermost interface from the inside (SPLITS 4.3.2) and when it is
reflected there from the outside (SPLITSnow 3.3).

The kernels, scalar and lanes, load a ray, look up the media on both sides, and store what the
functions here return; these serve both precisions and hold no loops and no branches.
"""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.compiler.jit import ONE, TWO, ZERO, inline
from splits.kernels.grains.microfacet import compute_facet_normal
from splits.kernels.math.arithmetic import fma, get_precision, rsqrt, sqrt
from splits.kernels.math.elementary import Angle
from splits.kernels.math.vectors import (
    Vector,
    dot,
    linear_combination,
    normalize,
    reflect,
    select,
)
from splits.kernels.optics.fresnel import NormalWave, normal_component, unpolarized_reflectance


class InteractionVariates(NamedTuple):
    """Random numbers of a trial; the last two are looked at where grains are rough.

    Attributes
    ----------
    u_facet, u_fresnel, u_pore : float
        Uniform.
    half_normal : float
        The modulus of a standard normal number.
    azimuth : Angle
        Uniform on the right half of the circle.
    """

    u_facet: float
    u_fresnel: float
    u_pore: float
    half_normal: float
    azimuth: Angle


class InterfaceState(NamedTuple):
    """Where a ray is at a grain.

    Attributes
    ----------
    shell : float
        0 in the pore space, 1 in the outermost shell of the grain, and so on to its core.
    side : float
        1 where the ray goes inwards, −1 outwards.
    in_lobe : bool
        The next trial sends it into a cosine lobe: it was to go to the wrong side of the surface.
    transmitted_lobe : bool
        That lobe is on the far side.
    """

    shell: float
    side: float
    in_lobe: bool
    transmitted_lobe: bool


class RelativeIndex(NamedTuple):
    """The medium beyond an interface, as seen from this side.

    Attributes
    ----------
    m, m_minus_1 : float
        Real part of the relative index, and that less 1.
    k : float
        Imaginary part; not looked at where extinction does not show in reflection.
    inverse : float
        1/m; looked at only there.
    equal : bool
        Both media are one, and there is no interface; looked at where scenes are mixed.
    """

    m: float
    m_minus_1: float
    k: float
    inverse: float
    equal: bool


class TransmittedWave(NamedTuple):
    """The wave beyond an interface, and the ratio of the sines of the angles on both sides."""

    wave: NormalWave
    sine_ratio: float


class InteractionResult(NamedTuple):
    """What a trial led to.

    Attributes
    ----------
    direction : Vector
        New direction.
    transmitted : bool
        Whether the ray goes on behind the surface.
    accepted : bool
        False asks for another trial.
    needs_lobe : bool
        The next trial is a lobe's.
    cos_out : float
        Cosine between d and the surface's normal on the side that the ray came from.
    """

    direction: Vector
    transmitted: bool
    accepted: bool
    needs_lobe: bool
    cos_out: float


class NextRegion(NamedTuple):
    """Where a trial leads.

    Attributes
    ----------
    interface : InterfaceState
        After it.
    in_pore : bool
        The ray is back in the pore space.
    in_coating, in_core : bool
        It crosses a coating, or the core.
    """

    interface: InterfaceState
    in_pore: bool
    in_coating: bool
    in_core: bool


@inline
def relative_index(near, far):
    """Return the contrast of two media of complex index n + i k, None of it known beforehand."""
    per_near = ONE / near.n
    same = (near.n == far.n) & (near.k == far.k)
    m, less_one = far.n * per_near, (far.n - near.n) * per_near
    return RelativeIndex(m, less_one, far.k * per_near, near.n / far.n, same)


@inline
def compute_transmitted_wave(media, cos_facet, sin2, features):
    """Return the wave beyond an interface and the ratio of the sines, see `fresnel.Passage`."""
    if features.mixed is None and features.absorbing is None:
        wave = normal_component(media.m, media.m_minus_1, ZERO, cos_facet, False)
        return TransmittedWave(wave, media.inverse)
    wave = normal_component(media.m, media.m_minus_1, media.k, cos_facet, True)
    if features.mixed is None:
        return TransmittedWave(wave, rsqrt(fma(wave.a, wave.a, sin2)))
    a = cos_facet if media.equal else wave.a
    b2 = ZERO if media.equal else wave.b2
    ratio = ONE if media.equal else rsqrt(fma(a, a, sin2))
    return TransmittedWave(NormalWave(a, b2), ratio)


@inline
def reflect_or_refract(d, interface, facet, media, u, mirror_wrong_side, features):
    """Reflect or refract a ray at a facet, or send it into a lobe.

    Parameters
    ----------
    d : Vector
    interface : InterfaceState
    facet : Microfacet
    media : RelativeIndex
    u : float
        A uniform random number.
    mirror_wrong_side : bool
        Directions on the wrong side of the surface are mirrored in it, instead of a lobe (SPLITS
        4.3.4) standing for multiple scattering between facets.
    features : Features

    Returns
    -------
    Outcome
    """
    normal, cos_facet, lobe = facet.normal, facet.cos_facet, interface.in_lobe
    sin2 = max((ONE - cos_facet) * (ONE + cos_facet), ZERO)
    wave, ratio = compute_transmitted_wave(media, cos_facet, sin2, features)
    share = unpolarized_reflectance(media.m, media.m_minus_1, media.k, cos_facet, sin2, wave)
    reflected = (u * share.denominator < share.numerator) | (wave.a == ZERO)
    if features.mixed is not None:
        reflected = reflected & (not media.equal)
    passed = not reflected
    # Both outcomes are g d + h n' for a facet of normal n'; a lobe is n' alone.
    g = ONE if reflected else ratio
    h = TWO * cos_facet if reflected else ratio * (cos_facet - wave.a)
    struck = normal
    if features.faceted is not None:
        h = -h if facet.back_side else h
        g = ZERO if lobe else g
        h = ONE if lobe else h
        passed = interface.transmitted_lobe if lobe else passed
        cos_lobe = sqrt(u)
        c = (-cos_lobe if passed else cos_lobe) if lobe else facet.tilt.cos
        cos_azimuth = facet.cos_lobe_azimuth if lobe else facet.azimuth.cos
        leaned, azimuth = Angle(c, facet.tilt.sin), Angle(cos_azimuth, facet.azimuth.sin)
        struck = compute_facet_normal(d, normal, facet.cos_i, leaned, azimuth)
    # Normals come out shorter than 1 by 1e-8 on average.  Left so, rays in smooth spheres, in
    # which all reflections are alike, would creep into total reflection and stay for ever;
    # what creep remains leads out.
    h = fma(h, ONE - dot(struck, struck), h)
    e = normalize(linear_combination(g, d, h, struck))
    out = dot(e, normal)
    if features.faceted is None:
        return InteractionResult(e, passed, True, False, out)
    right = (out < ZERO) if passed else (out > ZERO)
    e = select(mirror_wrong_side & (not right), reflect(e, normal), e)
    right = right | mirror_wrong_side
    done = lobe | (facet.accepted & right)
    return InteractionResult(e, passed, done, (not lobe) & facet.accepted & (not right), out)


@inline
def find_next_region(interface, result, core_shell, mixed):
    """Return where a ray goes that leaves a surface as `result` says.

    Parameters
    ----------
    interface : InterfaceState
    result : Outcome
    core_shell : float
        Number of the grain's core among its shells.
    mixed : True or None
        None where all grains are without coatings.
    """
    done = result.accepted
    shell = interface.shell + interface.side if result.transmitted else interface.shell
    out = shell == ZERO
    if mixed is None:
        in_core = not out
        side = -ONE
    else:
        in_core = shell == core_shell
        side = interface.side if result.transmitted else -interface.side
        side = -ONE if in_core else side
    shell = shell if done else interface.shell
    side = side if done else interface.side
    interface = InterfaceState(shell, side, result.needs_lobe, result.transmitted)
    return NextRegion(interface, done & out, done & (not out) & (not in_core), done & in_core)


@inline
def compute_coating_path_length(thickness, result, in_coating):
    """Return the way through a coating (m), 0 where none is crossed."""
    length = thickness / max(abs(result.cos_out), get_precision(result.cos_out).min_cos_incidence)
    return length if in_coating else ZERO
