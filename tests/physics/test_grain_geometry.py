"""Chords and overlaps of spheroids against direct evaluation, and single coated grains."""

import cmath
import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, draw_samples, judge_z
from events import play_roulette, sample_entry, trace_grain
from numba import njit
from scenes import make_coated_grains, make_optics, make_scene, sample_pore
from scipy import integrate
from spheroids import normalize, to_real_space, to_unit_sphere

import splits
from splits.kernels import rng
from splits.kernels.arithmetic import dot
from splits.kernels.grains import spheroid
from splits.kernels.grains.spheroid import EntryPoint, GrainSize, Spheroid
from splits.kernels.scene import PROJECTED_ENTRY, UNIFORM_ENTRY, Segment, Vector

B = 1.7
SPHERICITIES = (0.35, 0.7, 0.9, 1.0)
NO_SEGMENT_LENGTH = -1.0


@pytest.fixture
def random():
    return np.random.default_rng(11)


def compute_shape(psi):
    """Return semi-minor axis and flattening, the parameters of the kernels."""
    return B * psi * psi, 1.0 - psi * psi


def make_grain(q, axis, psi):
    """Return a grain with the ray at a point of its unit sphere."""
    c, flattening = compute_shape(psi)
    return Spheroid(Vector(*q), Vector(*axis), flattening, c)


def make_quadratic_form(psi, axis):
    """Return the matrix M of the spheroid xᵀ M x = 1 by a rotation from its principal axes."""
    c = B * psi * psi
    rotation = np.linalg.qr(np.column_stack([axis, np.eye(3)[:, np.argsort(np.abs(axis))[:2]]]))[0]
    return rotation @ np.diag([1 / B**2, 1 / c**2, 1 / c**2]) @ rotation.T


def sample_surface_point(random, psi, axis):
    """Return a random point on the surface, by scaling a random direction."""
    direction = normalize(random.normal(size=3))
    return direction / np.sqrt(direction @ make_quadratic_form(psi, axis) @ direction)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_unit_sphere_points_map_to_the_surface(random, psi):
    c, flattening = compute_shape(psi)
    for _ in range(100):
        axis = normalize(random.normal(size=3))
        m = make_quadratic_form(psi, axis)
        p = sample_surface_point(random, psi, axis)
        q = to_unit_sphere(p, axis, c, flattening)
        assert q @ q == pytest.approx(1.0, abs=1e-13)
        assert to_real_space(q, axis, c, flattening) == pytest.approx(p, abs=1e-13)
        n = np.array(spheroid.compute_outward_normal(make_grain(q, axis, psi)))
        assert n == pytest.approx(normalize(m @ p), abs=1e-12)
        z = q @ axis
        # The squared length of the normal before normalization, in units of q.
        assert spheroid.normal_length_squared(z, flattening) == pytest.approx(
            np.square(spheroid.scale_along_axis(Vector(*q), Vector(*axis), flattening)).sum(),
            abs=1e-13,
        )
        assert z == pytest.approx(p @ axis / B, abs=1e-13)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_chord_agrees_with_roots_of_the_quadratic(random, psi):
    c, flattening = compute_shape(psi)
    for _ in range(300):
        axis = normalize(random.normal(size=3))
        m = make_quadratic_form(psi, axis)
        p = sample_surface_point(random, psi, axis)
        d = normalize(random.normal(size=3))
        d = -d if d @ m @ p > 0.0 else d
        roots = np.roots([d @ m @ d, 2.0 * d @ m @ p, p @ m @ p - 1.0])
        q = to_unit_sphere(p, axis, c, flattening)
        length, exit_grain = spheroid.compute_chord(make_grain(q, axis, psi), Vector(*d))
        other = np.array(exit_grain.q)
        assert exit_grain[1:] == make_grain(q, axis, psi)[1:]
        assert length > 0.0
        assert length == pytest.approx(roots.real.max(), rel=1e-7, abs=1e-7)
        end = p + length * d
        assert end @ m @ end == pytest.approx(1.0, abs=1e-12)
        assert np.dot(other, other) == pytest.approx(1.0, abs=1e-15)
        assert to_real_space(other, axis, c, flattening) == pytest.approx(end, abs=1e-12)
        n = np.array(spheroid.compute_outward_normal(exit_grain))
        assert n == pytest.approx(normalize(m @ end), abs=1e-12)
        assert n @ d > 0.0


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_outward_ray_has_no_chord(random, psi):
    for _ in range(100):
        axis, q, d = normalize(random.normal(size=(3, 3)))
        grain = make_grain(q, axis, psi)
        n = spheroid.compute_outward_normal(grain)
        d = d if d @ n > 0.0 else -d
        length, exit_grain = spheroid.compute_chord(grain, Vector(*d))
        assert (length, *exit_grain.q) == pytest.approx((0.0, *q), abs=1e-15)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_chord_normalizes_points_off_the_unit_sphere(random, psi):
    for _ in range(100):
        axis, q, d = normalize(random.normal(size=(3, 3)))
        for offset in (-1e-6, 1e-6):
            exit_grain = spheroid.compute_chord(
                make_grain((1.0 + offset) * q, axis, psi), Vector(*d)
            ).grain
            # The error of Newton's method is quadratic: 3/8 (2e-6)².
            assert np.linalg.norm(exit_grain.q) == pytest.approx(1.0, abs=2e-12)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_boundary_overlap_agrees_with_extreme_heights(random, psi):
    c, flattening = compute_shape(psi)
    major, depth = c / (1.0 - flattening), 12.0
    for _ in range(50):
        axis = normalize(random.normal(size=3))
        m = make_quadratic_form(psi, axis)
        p = sample_surface_point(random, psi, axis)
        q = to_unit_sphere(p, axis, c, flattening)
        normal = Vector(*normalize(m @ p))
        entry = EntryPoint(make_grain(q, axis, psi), normal, float(q @ axis), major)
        # At the topmost point the gradient is along z.
        top = np.linalg.solve(m, [0.0, 0.0, 1.0])
        top = (top / np.sqrt(top @ m @ top))[2]
        for excess in (-1e-12, 1e-12):
            for height in (p[2] - top + excess, p[2] + top - depth - excess):
                overlaps = spheroid.overlaps_boundary(entry, height, -depth, 0.0)
                assert overlaps == (excess > 0.0)
        # A random height, and boundaries closer than the height of the grain.
        height = random.uniform(-depth, 0.0)
        outside = height - p[2] + top > 0.0 or height - p[2] - top < -depth
        assert spheroid.overlaps_boundary(entry, height, -depth, 0.0) == outside
        assert spheroid.overlaps_boundary(entry, -0.5 * top + p[2], -1.9 * top, 0.0)


def overlaps_segment(start, d, length, p, axis, psi):
    """Return whether a segment, relative to the centre, overlaps a grain of surface point p."""
    grain = make_grain(to_unit_sphere(p, axis, *compute_shape(psi)), axis, psi)
    end = start + length * d - p
    return spheroid.overlaps_segment(grain, Segment(Vector(*end), Vector(*d), length))


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_segment_overlap_agrees_with_sampled_points(random, psi):
    c, flattening = compute_shape(psi)
    steps = 2000
    n_overlapping = n_separate = 0
    for _ in range(400):
        axis = normalize(random.normal(size=3))
        m = make_quadratic_form(psi, axis)
        # Segments through a point inside or near the grain, in any direction.
        d = normalize(random.normal(size=3))
        near = sample_surface_point(random, psi, axis) * random.uniform(0.0, 2.0)
        start = near - d * random.normal() * B
        length = random.exponential(2.0 * B)
        points = start + np.linspace(0.0, length, steps)[:, None] * d
        nearest = np.einsum("ij,jk,ik->i", points, m, points).min()
        # Between two points the quadratic form is at most (half a step)² / c² below the lower one.
        tolerance = (0.5 * length / (steps - 1) / c) ** 2
        # The result must not depend on the surface point that represents the grain.
        result = [
            overlaps_segment(start, d, length, sample_surface_point(random, psi, axis), axis, psi)
            for _ in range(3)
        ]
        if nearest < 1.0:
            assert all(result)
            n_overlapping += 1
        elif nearest > 1.0 + tolerance:
            assert not any(result)
            n_separate += 1
        p = sample_surface_point(random, psi, axis)
        # A missing segment overlaps nothing.
        grain = make_grain(to_unit_sphere(p, axis, c, flattening), axis, psi)
        assert not spheroid.overlaps_segment(
            grain, Segment(Vector(*-p), Vector(*d), NO_SEGMENT_LENGTH)
        )
    assert n_overlapping > 50 and n_separate > 50


@njit
def _sample_chord(state, types, entry):
    """Return the chord of a straight ray through a sampled grain."""
    b = 1.0 / rng.interpolate_quantile(types.inverse_semi_major, 0, rng.uniform(state))
    psi = rng.interpolate_quantile(types.sphericity, 0, rng.uniform(state))
    d = Vector(0.48, -0.64, 0.6)
    return spheroid.compute_chord(
        sample_entry(state, d, GrainSize(b, 1.0 - psi * psi), entry).grain, d
    ).length


MEDIA = {
    "Table 1": {},
    "fine needles": {"grain_size_um": (50.0, 80.0), "sphericity": (0.3, 0.6, 0.4, 0.1)},
    "one sphere": {"grain_size_um": (500.0, 500.0), "sphericity": (1.0, 1.0, 1.0, 0.0)},
}


@NEEDS_JIT
def test_mean_chord_is_the_inverse_attenuation():
    # Cauchy: volume over mean projected area, averaged over the grains that are hit, is 1/K.
    z = []
    for settings in MEDIA.values():
        snow = splits.Snow(**settings)
        chords = draw_samples(
            _sample_chord, 400_000, snow.make_grain_population().types, PROJECTED_ENTRY
        )
        error = chords.std() / np.sqrt(chords.size)
        z.append((chords.mean() - 1.0 / snow.attenuation_per_m) / error)
    judge_z(z, "mean chord")
    assert np.abs(z).max() < 3.0


@NEEDS_JIT
def test_uniform_entry_shortens_the_chord_of_a_sphere():
    # Uniform entry makes cos uniform, with chord s cos, so the mean is s/2 instead of 2s/3.
    snow = splits.Snow(**MEDIA["one sphere"])
    chords = draw_samples(_sample_chord, 400_000, snow.make_grain_population().types, UNIFORM_ENTRY)
    error = chords.std() / np.sqrt(chords.size)
    judge_z([(chords.mean() - 250e-6) / error], "uniform entry")


RADIUS = 2.5e-4
COUNT = 100_000
CORE, COAT = 2, 3
OPAQUE = 1e15


@njit
def _trace(state, psi, facetness, scene, optics, true_absorption, length):
    """Return cosθ of scattering, paths in core and coatings, the score and the pore of exit.

    Roulette is applied at the exit from the grain.
    """
    d = Vector(0.48, -0.64, 0.6)
    size = GrainSize(RADIUS, 1.0 - psi * psi)
    ray, _ = trace_grain(state, d, size, facetness, False, scene, optics, length)
    score = play_roulette(state, ray)
    if not scene.rules.analog:
        score *= math.exp(-(true_absorption * length).sum())
    pore = float(sample_pore(ray.pore_variate, scene))
    return dot(d, ray.direction), length[2], length[3:].sum(), score, pore


def make_coated(thickness, materials=None):
    """Return grains of one type with coatings of given relative thickness, from the outside."""
    return make_coated_grains(thickness, [*(materials or range(COAT, COAT + len(thickness))), CORE])


def sample_paths(
    grains, index, absorption, psi=1.0, facetness=0.0, saturation=0.0,
    entry="projected", analog=False, roulette_scale=1.0, ray=0,
):  # fmt: skip
    """Return samples of `_trace`; roulette uses absorption scaled by `roulette_scale`."""
    index = np.array([1.0, 1.33, *index], dtype=complex)
    absorption = np.array([0.0, 0.0, *absorption], dtype=float)
    optics = make_optics(index.real, index.imag, roulette_scale * absorption)
    rules = splits.SandInterpretation(entry_point=entry).to_sampling_rules(analog)
    scene = make_scene(grains, saturation=saturation, rules=rules)
    return draw_samples(
        _trace, COUNT, psi, facetness, scene, optics, absorption, np.zeros(index.size),
        width=5, ray=ray,
    )  # fmt: skip


def compute_moments(sample):
    """Return the moments by which two samples of grain paths are compared, one row each."""
    cosine, core, coat, score, pore = sample.T
    core, coat = core / RADIUS, coat / RADIUS
    # Grazing segments make the variance of the coating path infinite, hence its exponential.
    thin = np.exp(-20.0 * coat)
    return np.stack([
        cosine, cosine**2, core, core**2, thin, thin**2, thin * core, score, score * cosine,
        score**2, pore,
    ])  # fmt: skip


def compare_moments(one, other):
    """Return z of every moment with a positive error."""
    a, b = compute_moments(one), compute_moments(other)
    error = np.sqrt((a.var(axis=1) + b.var(axis=1)) / COUNT)
    return (a.mean(axis=1) - b.mean(axis=1))[error > 0.0] / error[error > 0.0]


def fresnel(m1, m2, i):
    """Return unpolarized reflectance and angle of refraction; the near index is taken as real."""
    m1 = complex(m1.real)
    c1, c2 = math.cos(i), cmath.sqrt(1.0 - (m1 * math.sin(i) / m2) ** 2)
    s = (m1 * c1 - m2 * c2) / (m1 * c1 + m2 * c2)
    p = (m2 * c1 - m1 * c2) / (m2 * c1 + m1 * c2)
    angle = math.atan2(m1.real * math.sin(i), (m2 * c2).real)
    return 0.5 * (abs(s) ** 2 + abs(p) ** 2), angle


def stack_reflectance(m, depth, i):
    """Return the reflectance of a stack of slabs on an opaque body, summed over all orders.

    `depth` are the optical thicknesses of the slabs.  Of the fraction 1 − r that enters a slab,
    T² R returns to its top from below, where r' is reflected again: a geometric series per slab.
    """
    r, t = fresnel(m[0], m[1], i)
    if len(m) == 2:
        return r
    internal_reflectance, _ = fresnel(m[1], m[0], t)
    below = stack_reflectance(m[1:], depth[1:], t) * math.exp(-2.0 * depth[0] / math.cos(t))
    return r + (1.0 - r) * (1.0 - internal_reflectance) * below / (
        1.0 - internal_reflectance * below
    )


def integrate_impacts(value, entry="projected"):
    """Return the mean of value(i) over angles of incidence on a sphere."""

    def integrand(i):
        return value(i) * (math.sin(2.0 * i) if entry == "projected" else math.sin(i))

    return integrate.quad(integrand, 0.0, 0.5 * math.pi, limit=400)[0]


@NEEDS_JIT
@pytest.mark.long
@pytest.mark.parametrize("facetness", [0.0, 0.5])
def test_coatings_of_equal_material_merge(facetness):
    """No facet between equal materials deviates rays: segments h₁/|n·d| and h₂/|n·d| add up."""
    z = []
    for number, (h1, h2, coat) in enumerate(
        [(0.004, 0.004, 1.7), (0.001, 0.02, 1.3), (0.03, 0.01, 2.2 + 0.1j)]
    ):
        settings = {"index": [1.55, coat], "absorption": [200.0, 3e4], "psi": 0.8}
        settings |= {"facetness": facetness, "saturation": 0.4}
        grains = make_coated([h1, h2], [COAT, COAT]), make_coated([h1 + h2])
        # Weights are compared without roulette, which terminates paths.
        double, single = (
            sample_paths(g, **settings, roulette_scale=0.0, ray=2 * number + i)
            for i, g in enumerate(grains)
        )
        assert single[:, 2].max() > 0.0
        z.append(compare_moments(double, single))
        double, single = (
            sample_paths(g, **settings, analog=True, ray=120 + 2 * number + i)
            for i, g in enumerate(grains)
        )
        survival = np.array([double[:, 3].mean(), single[:, 3].mean()])
        error = np.sqrt((survival * (1.0 - survival)).sum() / COUNT)
        z.append([(survival[0] - survival[1]) / error])
    # Moments of a pair of samples are correlated.
    judge_z(np.concatenate(z), f"two coatings, facetness {facetness}", independent=len(z))


@NEEDS_JIT
@pytest.mark.parametrize("facetness", [0.0, 0.5])
def test_index_matched_transparent_coating_has_no_effect(facetness):
    """The result also holds for rough grains: facets of a matched interface do not refract."""
    z = []
    for number, (psi, core) in enumerate([(1.0, 1.31), (0.7, 1.55 + 0.05j)]):
        settings = {"psi": psi, "facetness": facetness, "saturation": 0.4}
        bare = sample_paths(make_coated([]), [core], [3000.0], **settings, ray=10 + number)
        coated = sample_paths(
            make_coated([0.01]), [core, core], [3000.0, 0.0], **settings, ray=20 + number
        )
        assert (bare[:, 2] == 0.0).all() and coated[:, 2].max() > 0.0
        coated[:, 2] = 0.0
        z.append(compare_moments(bare, coated))
    judge_z(np.concatenate(z), f"matched coating, facetness {facetness}", independent=len(z))


@NEEDS_JIT
def test_coating_paths_are_those_of_a_slab():
    """With equal indices the path is a chord 2R cos i and two coating segments h/cos i."""
    sample = sample_paths(make_coated([0.01]), [1.0, 1.0], [0.0, 0.0])
    cosine, core, coat, score, _ = sample.T
    assert np.abs(cosine - 1.0).max() < 1e-12 and (score == 1.0).all()
    np.testing.assert_allclose(core * coat, 8.0 * RADIUS**2 * 0.01, rtol=1e-6)
    judge_z([(core.mean() / RADIUS - 4 / 3) / (core.std() / RADIUS / math.sqrt(COUNT))], "chord")


# Stacks of several films are transparent in Fresnel's equations: in absorbing films, planes of
# constant phase return at another angle than they went down.
STACKS = {
    "absorbing film": ([1.56, 2.0 + 1.5j], [0.7], [0.004]),
    "bright core": ([1.56, 0.2 + 6.0j], [0.3], [0.004]),
    "absorbing film of high index": ([2.8 + 0.6j, 1.5 + 2.0j], [0.4], [0.004]),
    "two films": ([1.4, 2.2, 0.3 + 4.0j], [0.2, 0.4], [0.003, 0.006]),
    "three films": ([1.4, 2.2, 1.6, 0.3 + 4.0j], [0.2, 0.1, 0.3], [0.002, 0.01, 0.001]),
}  # fmt: skip


@NEEDS_JIT
@pytest.mark.parametrize("entry", ["projected", "uniform"])
def test_coated_opaque_cores_reflect_by_the_series(entry):
    """The reference sums all orders of reflection, by quadrature over impact parameters."""
    z = []
    for number, (index, depth, thickness) in enumerate(STACKS.values()):
        m = [complex(v) for v in (1.0, *index)]
        expected = integrate_impacts(
            lambda i, m=m, depth=depth: stack_reflectance(m, depth, i), entry
        )
        absorption = [OPAQUE, *np.array(depth) / (2.0 * RADIUS * np.array(thickness))]
        for analog in (False, True):
            score = sample_paths(
                make_coated(thickness), [index[-1], *index[:-1]], absorption,
                entry=entry, analog=analog, ray=30 + 2 * number + analog,
            )[:, 3]  # fmt: skip
            z.append((score.mean() - expected) / (score.std() / math.sqrt(COUNT)))
    judge_z(z, f"coated opaque cores, {entry}")


@NEEDS_JIT
@pytest.mark.parametrize("entry", ["projected", "uniform"])
def test_pure_magnetite_reflects_by_fresnel(entry):
    sand = splits.Sand(
        iron_oxide=0.0,
        magnetite=1.0,
        partition=(1, 0, 0),
        sphericity=(1, 1, 1, 0),
        roundness=(1, 0),
    )
    z = []
    for number, wavelength in enumerate((400.0, 700.0, 1000.0)):
        index = complex(sand.compute_refractive_indices([wavelength])[0, CORE])
        absorption = 4.0 * math.pi * index.imag / (wavelength * 1e-9)
        expected = integrate_impacts(lambda i, m=index: fresnel(1.0 + 0j, m, i)[0], entry)
        for analog in (False, True):
            score = sample_paths(
                sand.make_grain_population(), [index], [absorption],
                entry=entry, analog=analog, ray=60 + 2 * number + analog,
            )[:, 3]  # fmt: skip
            assert analog or set(np.unique(score[score > 1e-12])) == {1.0}
            error = math.sqrt(expected * (1.0 - expected) / COUNT)
            z.append((score.mean() - expected) / error)
    judge_z(z, f"magnetite, {entry}")


@NEEDS_JIT
@pytest.mark.parametrize("facetness", [0.0, 0.5])
def test_roulette_in_coatings_is_unbiased(facetness):
    """Weighted scores agree with analog absorption, also where roulette is too frequent.

    Roulette stays unbiased with absorption overestimated by `roulette_scale`; from a factor of 2 on
    the variance is infinite.
    """
    z = []
    for number, (core, coat, roulette_scale) in enumerate(
        [(0.5, 1.0, 1.0), (1.0, 0.2, 1.8), (0, 0.5, 1.8)]
    ):
        grains, index = make_coated([0.005, 0.01]), [1.55, 2.2 + 0.05j, 1.3]
        absorption = np.array([core, 100.0 * coat, 10.0 * coat]) / (2.0 * RADIUS)
        settings = {"psi": 0.8, "facetness": facetness, "saturation": 0.3}
        with_roulette, without_roulette, analog = (
            sample_paths(grains, index, absorption, **settings, **options, ray=80 + 3 * number + i)
            for i, options in enumerate(
                ({"roulette_scale": roulette_scale}, {"roulette_scale": 0.0}, {"analog": True})
            )
        )
        # The longest fifth of the paths is compared separately: only these are subject to roulette.
        threshold = np.quantile(without_roulette[:, 1:3].sum(axis=1), 0.8)
        longest = [
            s[:, 3] * (s[:, 1:3].sum(axis=1) > threshold) for s in (with_roulette, without_roulette)
        ]
        scores = with_roulette[:, 3], without_roulette[:, 3], analog[:, 3]
        for one, other in (longest, scores[:2], scores[1:]):
            z.append((one.mean() - other.mean()) / np.sqrt((one.var() + other.var()) / COUNT))
    judge_z(z, f"roulette, facetness {facetness}", independent=3)
