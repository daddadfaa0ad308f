"""Hard paths below the interface: ten million scatterings, rays along an axis or a tangent."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, draw_samples, judge_z, start_random_stream
from events import (
    compute_facet_normal,
    resolve_interaction,
    sample_entry,
    sample_facet,
    trace_grain,
)
from numba import njit
from scenes import make_medium_scene, make_optics, make_scene, trace_ray
from scipy import integrate

import splits
from splits.kernels.grains import history, microfacet, spheroid
from splits.kernels.grains.grain_path import sample_interaction
from splits.kernels.grains.interaction import InterfaceState, relative_index
from splits.kernels.grains.spheroid import EntryPoint, GrainSize, Segment, Spheroid
from splits.kernels.math import vectors
from splits.kernels.math.vectors import Vector, add_scaled, dot, scale
from splits.kernels.optics.fresnel import FresnelResult, fresnel, refract
from splits.kernels.optics.interface import ComplexIndex

MANY = 10_000_000
DRIFT = 1e-9
EPS = 2.0**-52
FIRST_LONG_RAY = 189
RULES = splits.Interpretation().to_sampling_rules()
AXES = np.vstack([np.eye(3), -np.eye(3)])


# --- ten million scatterings ------------------------------------------------------------------


@njit
def _centred(grain):
    """Return the point at which a ray is, relative to the grain's centre (m)."""
    stretch = grain.flattening / (1.0 - grain.flattening)
    return scale(grain.semi_minor, add_scaled(stretch * dot(grain.q, grain.w), grain.w, grain.q))


@njit
def _trapped(state, steps, size, facetness, rules):
    """Return what drifts while a ray cannot get out of a grain.

    The worst |d² − 1| and |q² − 1|, the distance in the end of the sum of all legs from the point
    that q stands for, in semi-minor axes, and the least and the largest leg in diameters.
    """
    d = Vector(-0.48, 0.64, -0.6)
    grain = sample_entry(state, d, size, rules.entry_sampling).grain
    minor, flattening, w = grain.semi_minor, grain.flattening, grain.w
    p = _centred(grain)
    # An index of 1e9 inside: every angle that occurs is beyond the critical one.
    media = relative_index(ComplexIndex(1e9, 0.0), ComplexIndex(1.0, 0.0))
    norm, sphere, surface, shortest, longest, escaped = 0.0, 0.0, 0.0, 1.0, 0.0, 0.0
    for _ in range(steps):
        leg, grain = spheroid.compute_chord(grain, d)
        p = add_scaled(leg, d, p)
        stand = InterfaceState(1.0, -1.0, False, False)
        while True:
            after = sample_interaction(state, d, stand, grain, 0.5 * facetness, media, rules)
            if after.accepted:
                break
            stand = InterfaceState(1.0, -1.0, after.needs_lobe, after.transmitted)
        d = after.direction
        norm = max(norm, abs(dot(d, d) - 1.0))
        sphere = max(sphere, abs(dot(grain.q, grain.q) - 1.0))
        axial = dot(p, w)
        r = add_scaled(-axial, w, p)
        axial *= 1.0 - flattening
        square = (dot(r, r) + axial * axial) / (minor * minor)
        surface = max(surface, abs(square - 1.0))
        leg *= 0.5 * (1.0 - flattening) / minor
        shortest, longest = min(shortest, leg), max(longest, leg)
        escaped += after.transmitted
    gap = add_scaled(-1.0, _centred(grain), p)
    apart = math.sqrt(dot(gap, gap)) / minor
    return norm, sphere, surface, apart, shortest, longest, escaped


@NEEDS_JIT
@pytest.mark.parametrize(("psi", "facetness"), [(1.0, 0.0), (0.8, 0.3), (0.3, 1.0)])
def test_ten_million_reflections_in_one_grain_do_not_drift(psi, facetness):
    norm, sphere, surface, apart, shortest, longest, escaped = _trapped(
        start_random_stream(), MANY, GrainSize(1e-4, 1.0 - psi * psi), facetness, RULES
    )
    print(
        f"Ψ {psi}, facetness {facetness}: |d² − 1| {norm:.1e}, |q² − 1| {sphere:.1e}, "
        f"|Q − 1| {surface:.1e}, apart {apart:.1e}"
    )
    assert escaped == 0.0
    assert norm < DRIFT and sphere < DRIFT
    # The sum of ten million legs still ends on the surface, where the kernel believes it to be.
    assert surface < DRIFT and apart < DRIFT
    assert shortest >= 0.0 and longest <= 1.0 + DRIFT


@NEEDS_JIT
def test_ten_million_grains_of_index_1_leave_a_ray_as_it_was():
    # A straight line through 10 km of snow: where it ends is known to the last digit.
    depth, mu = 9e3, math.cos(math.radians(30.0))
    snow = splits.Snow(saturation=0.0, depth_m=depth)
    scene = make_medium_scene(snow, 30.0)
    ray, length = trace_ray(start_random_stream(), scene, make_optics(np.ones(3)))
    (x, y, z), d, legs = ray.geometry.position, ray.payload.direction, ray.n_segments
    assert legs >= MANY
    assert ray.order == legs - 1
    assert (ray.status, z) == (history.TRANSMITTED, -depth)
    sine = math.sqrt(1.0 - mu * mu)
    assert np.abs(np.subtract(d, (sine, 0.0, -mu))).max() < DRIFT
    assert abs(math.hypot(*d) - 1.0) < DRIFT
    assert x == pytest.approx(depth * sine / mu, rel=DRIFT)
    assert abs(y) < DRIFT * depth
    assert length.sum() == pytest.approx(depth / mu, rel=DRIFT)
    # Grains are met at random, with the mean distance stated: exponential, sd equal to the mean.
    z = (length[0] / legs / snow.mean_grain_distance_m - 1.0) * math.sqrt(legs)
    judge_z([z], "distance between grains")


@NEEDS_JIT
def test_ten_million_scatterings_between_boundaries_that_let_nothing_out():
    # Bubbles in a liquid of index 60: once inside, light meets a boundary thousands of times.
    snow = splits.Snow(saturation=1.0, facetness=(0.0,) * 4, sphericity=(1.0, 1.0, 1.0, 0.0))
    scene, optics = make_medium_scene(snow), make_optics([1.0, 60.0, 1.31])
    # The first of these rays is long enough today; with other random numbers a later one is.
    for number in range(FIRST_LONG_RAY, FIRST_LONG_RAY + 300):
        ray, length = trace_ray(start_random_stream(number), scene, optics)
        if ray.n_segments >= MANY:
            break
    print(f"ray {number} has {ray.n_segments} legs")
    assert ray.n_segments >= MANY
    assert ray.status in (history.REFLECTED, history.TRANSMITTED)
    place, d = ray.geometry.position, ray.payload.direction
    assert place.z == (0.0 if ray.status == history.REFLECTED else -snow.depth_m)
    assert (d.z > 0.0) == (ray.status == history.REFLECTED)
    assert abs(math.hypot(*d) - 1.0) < DRIFT
    assert np.isfinite([*place, *length]).all() and length.min() >= 0.0


# --- along an axis, along a tangent -----------------------------------------------------------


AIR_TO_ICE = ComplexIndex(1.0, 0.0), ComplexIndex(1.31, 0.0)


def grain_of(psi):
    """Return semi-minor axis, flattening and the semi-major axis that these two stand for."""
    minor, flattening = 1e-4 * psi * psi, 1.0 - psi * psi
    return minor, flattening, minor / (1.0 - flattening)


@pytest.mark.parametrize("axis", AXES, ids=str)
@pytest.mark.parametrize("psi", [1.0, 0.8, 0.3, 0.1])
def test_rays_along_the_axes_of_a_grain(axis, psi):
    c, flattening, a = grain_of(psi)
    assert a == pytest.approx(1e-4, rel=1e-14)
    for d in AXES:
        semi = a if abs(d @ axis) == 1.0 else c
        grain = Spheroid(Vector(*-d), Vector(*axis), flattening, c)
        chord, there = spheroid.compute_chord(grain, Vector(*d))
        assert chord == pytest.approx(2.0 * semi, rel=2e-12)
        assert there.q == pytest.approx(d, abs=2e-14)
        assert spheroid.compute_outward_normal(grain) == pytest.approx(-d, abs=1e-15)
        # Struck at this pole: it reaches over the boundary when it is a hair too near.
        height = a if abs(axis[2]) == 1.0 else c
        entered = EntryPoint(grain, Vector(*-d), float(-d @ axis), a)
        up = -semi * d[2]
        for hair, over in ((-1e-15, False), (1e-15, True)):
            at_top = up - height * (1.0 - hair)
            assert spheroid.overlaps_boundary(entered, at_top, -1.0, 0.0) == over
        # Four semi-axes below, heights have fewer digits left.
        depth = 4.0 * a
        for hair, over in ((-1e-12, False), (1e-12, True)):
            at_bottom = up + height * (1.0 - hair) - depth
            assert spheroid.overlaps_boundary(entered, at_bottom, -depth, 0.0) == over
        # Seen from afar, straight at the centre and past it by a hair more than the semi-axis.
        side = np.roll(d, 1)
        half = a if abs(side @ axis) == 1.0 else c
        for away, hit in ((0.0, True), (1.0 - 1e-9, True), (1.0 + 1e-9, False)):
            o = -10.0 * a * d + away * half * side
            for pole in AXES:
                p = pole * (a if abs(pole @ axis) == 1.0 else c)
                end = o + 20.0 * a * d - p
                grain = Spheroid(Vector(*pole), Vector(*axis), flattening, c)
                cut = spheroid.overlaps_segment(grain, Segment(Vector(*end), Vector(*d), 20.0 * a))
                assert cut == hit, (d, away, pole)


@pytest.mark.parametrize("axis", AXES, ids=str)
@pytest.mark.parametrize("psi", [1.0, 0.3])
def test_rays_tangent_to_a_grain(axis, psi):
    c, flattening, _ = grain_of(psi)
    for n in AXES:
        d = np.roll(n, 1)
        grain = Spheroid(Vector(*n), Vector(*axis), flattening, c)
        assert spheroid.compute_chord(grain, Vector(*d)) == (0.0, grain)
        assert spheroid.compute_outward_normal(grain) == pytest.approx(n, abs=1e-15)
        for facetness in (0.0, 0.5, 1.0):
            for ray in range(20):
                for d_on in (d, (d - 1e-17 * n), (d + 1e-17 * n)):
                    passed, out = resolve_interaction(
                        start_random_stream(ray),
                        Vector(*d_on),
                        Vector(*n),
                        facetness,
                        *AIR_TO_ICE,
                        RULES,
                    )
                    assert np.isfinite(out).all()
                    assert abs(math.hypot(*out) - 1.0) < 1e-11
                    assert (np.dot(out, n) < 0.0) == passed
                    if facetness == 0.0:
                        # At 1e-12 of a right angle all light is reflected, and stays grazing.
                        assert not passed


@pytest.mark.parametrize("axis", AXES, ids=str)
@pytest.mark.parametrize("facetness", [0.0, 1e-9, 0.5, 1.0])
@pytest.mark.parametrize(
    "rule", [microfacet.PROJECTED_FACETS, microfacet.UNWEIGHTED_FACETS, microfacet.ANY_FACETS]
)
def test_facets_struck_exactly_along_the_normal(axis, facetness, rule):
    rules = splits.Interpretation().to_sampling_rules()._replace(facet_sampling=rule)
    n, d = Vector(*axis), Vector(*-axis)
    for ray in range(50):
        facet = sample_facet(start_random_stream(ray), d, n, facetness, rule)
        assert 0.0 < facet.cos_facet <= 1.0
        assert facet.cos_facet == pytest.approx(abs(facet.tilt.cos), rel=1e-9)
        passed, out = resolve_interaction(
            start_random_stream(ray), d, n, facetness, *AIR_TO_ICE, rules
        )
        assert abs(math.hypot(*out) - 1.0) < 1e-14
        assert (np.dot(out, axis) < 0.0) == passed


def tilted(sine):
    """Return a normal and a direction against it, off by this sine."""
    n, t = np.array([0.48, -0.64, 0.6]), np.array([0.8, 0.6, 0.0])
    return Vector(*n), Vector(*-(math.sqrt(1.0 - sine * sine) * n + sine * t))


def worst_norm(sine):
    n, d = tilted(sine)
    drawn = (
        sample_facet(start_random_stream(ray), d, n, 1.0, microfacet.PROJECTED_FACETS)
        for ray in range(300)
    )
    return max(abs(math.hypot(*compute_facet_normal(d, facet)) - 1.0) for facet in drawn)


@pytest.mark.parametrize("sine", [1e-9, 1e-6, 1e-3])
def test_facet_normals_have_unit_length_near_the_normal(sine):
    # In units of the sine, directions have only so many digits left.
    assert worst_norm(sine) < 2.0 * EPS / sine


def test_facet_normals_have_unit_length_a_hair_off_the_normal():
    for sine in np.logspace(-9.9, -7.0, 30):
        assert worst_norm(sine) < 2.0 * EPS / sine


@pytest.mark.parametrize("sine", [0.0, 1e-17, 1e-15, 1e-12, 1e-11, 1e-10, 1e-9, 1e-6, 1e-3])
def test_directions_have_unit_length_near_the_normal(sine):
    n, d = tilted(sine)
    for ray in range(300):
        passed, out = resolve_interaction(start_random_stream(ray), d, n, 1.0, *AIR_TO_ICE, RULES)
        assert abs(math.hypot(*out) - 1.0) < 1e-14
        assert (np.dot(out, n) < 0.0) == passed


@pytest.mark.parametrize("indices", [(1.0, 1.31, 0.0), (1.31, 1.0, 0.0), (1.0, 1.31, 3.0)], ids=str)
def test_an_interface_towards_grazing_incidence(indices):
    for cos_i in (1e-12, 1e-100, 1e-150):
        reflectance, ratio, cos_t = fresnel(*indices, cos_i)
        assert reflectance == pytest.approx(1.0, abs=1e-10)
        assert 0.0 <= cos_t <= 1.0 and ratio >= 0.0


@pytest.mark.xfail(strict=True, reason="transport: 2e-16 below 1; docs/theory/hard-cases.md")
@pytest.mark.parametrize("cos_i", [0.0, 5e-324, 1e-200])
def test_an_interface_at_exactly_grazing_incidence(cos_i):
    assert fresnel(1.0, 1.31, 0.0, cos_i)[0] == 1.0


@pytest.mark.parametrize("cos_i", [0.0, 5e-324, 1e-200])
@pytest.mark.parametrize("indices", [(1.0, 1.31, 0.0), (1.0, 1.0, 1e-3), (1.0, 1.31, 3.0)], ids=str)
def test_an_interface_at_grazing_incidence_but_for_the_last_digit(indices, cos_i):
    reflectance, ratio, cos_t = fresnel(*indices, cos_i)
    assert reflectance == pytest.approx(1.0, abs=4e-16) and reflectance <= 1.0
    assert 0.0 < ratio <= 1.0 and 0.0 < cos_t < 1.0


def test_an_interface_whose_contrast_underflows():
    assert fresnel(1.0, 1.0, 1e-170, 1e-12)[0] == pytest.approx(0.0, abs=1e-100)


@pytest.mark.parametrize("axis", AXES, ids=str)
def test_frames_mirrors_and_refraction_along_the_axes(axis):
    n, d = Vector(*axis), Vector(*-axis)
    basis = np.array([*vectors.make_tangents(n), n])
    assert basis @ basis.T == pytest.approx(np.eye(3), abs=0.0)
    assert vectors.reflect(d, n) == n
    assert refract(d, n, 1.0, FresnelResult(0.0, 1.0 / 1.31, 1.0)) == pytest.approx(d, abs=1e-15)


# --- total reflection outside -----------------------------------------------------------------


@njit
def _bubble(state, scene, optics, length):
    d = Vector(0.0, 0.0, -1.0)
    walk, _ = trace_grain(state, d, GrainSize(1e-4, 0.0), 0.0, True, scene, optics, length)
    return -walk.payload.direction.z, length[2]


@NEEDS_JIT
@pytest.mark.parametrize("pore", [1.33, 2.0])
def test_bubbles_scatter_as_spheres_with_total_reflection_outside(pore):
    # A beam along −z on bubbles, struck by projected area: sums over orders, by quadrature.
    rules = splits.Interpretation(entry_point="projected").to_sampling_rules()
    scene = make_scene(splits.Snow().make_grain_population(), saturation=1.0, rules=rules)
    out = draw_samples(_bubble, 300_000, scene, make_optics([1.0, pore, 1.0]), np.zeros(3), width=2)

    def orders(i):
        r, _, cos_t = fresnel(pore, 1.0, 0.0, math.cos(i))
        t = math.acos(cos_t)
        through, inside = 0.0, 0.0
        if r < 1.0:
            series = np.exp(2j * (i - t)) / (1.0 - r * np.exp(1j * (math.pi - 2.0 * t)))
            through, inside = (1.0 - r) ** 2 * series.real, cos_t
        return math.sin(2.0 * i) * np.array([through - r * math.cos(2.0 * i), inside])

    critical = math.asin(1.0 / pore)
    expected = sum(
        integrate.quad_vec(orders, *limits, epsabs=1e-9)[0]
        for limits in ((1e-9, critical - 1e-12), (critical, 0.5 * math.pi - 1e-9))
    )
    sample = out / np.array([1.0, 2e-4])
    judge_z((sample.mean(axis=0) - expected) / (sample.std(axis=0) / math.sqrt(len(out))), "bubble")
