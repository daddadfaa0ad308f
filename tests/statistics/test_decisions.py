"""Random decisions of the kernels: free paths, reflection, pore medium, source direction."""

import math

import numpy as np
import pytest
from chi2 import (
    NEEDS_JIT,
    compute_p_of_values,
    draw_samples,
    judge_p,
    judge_z,
    scale_sample_size,
    tabulate_cdf,
)
from events import (
    make_lanes,
    resolve_interaction,
    resolve_interaction_by_lane,
    sample_facet,
    sample_facet_by_lane,
    to_single_precision,
)
from numba import njit
from scenes import (
    find_next_event,
    make_medium_scene,
    make_optics,
    make_ray_after_segment,
    make_scene,
    sample_pore,
)
from spheroids import compute_normal, dot_product, find_closest_approach, to_real_space

import splits
from splits.kernels import interface, rng
from splits.kernels import scene as ray_module
from splits.kernels.interface import ComplexIndex
from splits.kernels.rays import sample_source_direction
from splits.kernels.scene import DRY_PORE, ORIGIN, UP, WET_PORE, Source, Vector
from splits.kernels.transport.flight import BOUNDARY, NO_EVENT
from splits.media import grain_statistics

N_SAMPLES = scale_sample_size(200_000)
# Displacement from the end of the previous segment, direction back along it, its length.
NO_SEGMENT = (ORIGIN, ray_module.NO_SEGMENT.direction, ray_module.NO_SEGMENT.length)
TRANSPARENT_OPTICS = make_optics([1.0, 1.0, 1.0])
# Semi-major axes of SPLITSnow Table 1 (m).
MIN_SEMI_AXIS_M, MAX_SEMI_AXIS_M = 1.5e-4, 3.75e-4
single = np.float32
DEEP_SLAB = {"depth": 1e4, "saturation": 0.0}


def compute_binomial_z(hits, p):
    """Return a list with the deviation of a binomial fraction from p in standard errors.

    For p = 0 or 1 the fraction must be exact, and the list is empty.
    """
    fraction = np.mean(hits)
    if p in (0.0, 1.0):
        assert fraction == p
        return []
    return [(fraction - p) / math.sqrt(p * (1.0 - p) / np.size(hits))]


@njit
def _sample_next_grain(state, z, d, scene, optics, displacement, direction_back, length):
    """Return distance, semi-minor axis, flattening, entry point, major axis and normal."""
    ray = make_ray_after_segment(z, displacement, d, direction_back, length)
    event = find_next_event(state, ray, scene, optics)
    grain, n = event.entry.grain, event.entry.normal
    q, w = grain.q, grain.w
    outside = 1.0 if event.kind == BOUNDARY else 0.0
    return (
        event.distance, grain.semi_minor, grain.flattening, q.x, q.y, q.z, w.x, w.y, w.z,
        n.x, n.y, n.z, outside,
    )  # fmt: skip


def sample_next_grains(count, z, d, snow, slab=None, previous_segment=NO_SEGMENT):
    """Return samples of the next grain, vectors as (count, 3), except at a boundary."""
    scene = make_medium_scene(snow, **(slab or DEEP_SLAB))
    out = draw_samples(
        _sample_next_grain,
        count,
        z,
        Vector(*d),
        scene,
        TRANSPARENT_OPTICS,
        *previous_segment,
        width=13,
    )
    out = out[out[:, 12] == 0.0]
    return *out[:, :3].T, out[:, 3:6], out[:, 6:9], out[:, 9:12]


def test_free_paths_and_grains_follow_their_distributions():
    p = {}
    for entry in ("uniform", "projected"):
        snow = splits.Snow(depth_m=1e4, saturation=0.0, interpretation={"entry_point": entry})
        d = (0.48, -0.64, 0.6)
        distance, minor, flattening, q, w, n = sample_next_grains(
            scale_sample_size(100_000), -5e3, d, snow
        )
        # The ray enters the grain from outside, and the normal is that of the entry point.
        assert np.abs((q * q).sum(axis=1) - 1.0).max() < 1e-12
        assert np.abs((w * w).sum(axis=1) - 1.0).max() < 1e-12
        at = to_real_space(q, w, minor, flattening)
        assert np.abs(compute_normal(at, w, minor, flattening) - n).max() < 1e-11
        assert dot_product(n, d).max() < 0.0
        b, psi = minor / (1.0 - flattening), np.sqrt(1.0 - flattening)
        mean_free_path = snow.mean_grain_distance_m
        p[entry, "distance"] = compute_p_of_values(
            distance, lambda x, d=mean_free_path: -np.expm1(-x / d)
        )
        p[entry, "size"] = compute_p_of_values(
            b, lambda s: (1 / MIN_SEMI_AXIS_M - 1 / s) / (1 / MIN_SEMI_AXIS_M - 1 / MAX_SEMI_AXIS_M)
        )
        limits = snow.sphericity

        def density(x, limits=limits):
            bell = np.exp(-0.5 * ((x - limits[2]) / limits[3]) ** 2)
            return grain_statistics.surface_to_volume_ratio(x) * bell

        p[entry, "sphericity"] = compute_p_of_values(psi, tabulate_cdf(density, *limits[:2]))
    judge_p(p)


def test_rays_stop_at_a_boundary_before_the_grain():
    snow = splits.Snow(depth_m=1e4, interpretation={"overlap_with_boundary": "keep"})
    mean_free_path = snow.mean_grain_distance_m
    out = draw_samples(
        _sample_next_segment,
        scale_sample_size(50_000),
        -mean_free_path,
        make_medium_scene(snow, **DEEP_SLAB),
        TRANSPARENT_OPTICS,
        width=4,
    )
    lengths, heights, reached, lost = out.T
    # The boundary is one mean free path ahead: e^-1 of all rays reach it.
    reached = reached == 1.0
    assert not lost.any()
    assert (lengths[reached] == mean_free_path).all() and (heights[reached] == 0.0).all()
    assert lengths.max() == mean_free_path and heights[~reached].max() < 0.0
    judge_z(compute_binomial_z(reached, math.exp(-1.0)), "boundary first")


@njit
def _sample_next_segment(state, z, scene, optics):
    """Return where the segment of a vertical ray ends, and whether at the boundary."""
    ray = make_ray_after_segment(z, Vector(0.0, 0.0, 0.0), UP, UP, -1.0)
    event = find_next_event(state, ray, scene, optics)
    outside = 1.0 if event.kind == BOUNDARY else 0.0
    lost = 1.0 if event.kind == NO_EVENT else 0.0
    return event.distance, event.position.z, outside, lost


@njit
def _sample_crossing(state, mu, n1, n2):
    d = Vector(math.sqrt(1.0 - mu * mu), 0.0, mu)
    near, far = ComplexIndex(n1, 0.0), ComplexIndex(n2, 0.0)
    transmitted, d = interface.sample_interface(
        d, interface.orient_horizontal_normal(d), near, far, rng.uniform(state)
    )
    return 1.0 if transmitted else 0.0, d.x, d.y, d.z


def test_reflected_fraction_at_a_plane_interface():
    z = []
    for n1, n2 in ((1.0, 1.33), (1.33, 1.0), (1.0, 1.0), (1.0, 3.0)):
        for mu in (1.0, 0.7, 0.3, 0.05, -0.9, -0.2):
            out = draw_samples(_sample_crossing, N_SAMPLES // 4, mu, n1, n2, width=4)
            transmitted, dx, dy, dz = out.T
            sine_t = n1 / n2 * math.sqrt(1.0 - mu * mu)
            reflectance = interface.fresnel(n1, n2, 0.0, abs(mu)).reflectance
            z += compute_binomial_z(transmitted, 1.0 - reflectance)
            crossed = transmitted == 1.0
            assert (dz[~crossed] == -mu).all() and (dy == 0.0).all()
            assert (np.sign(dz[crossed]) == np.sign(mu)).all()
            assert not crossed.any() or np.abs(dx[crossed] - sine_t).max() < 1e-12
    judge_z(z, "boundary")


@njit
def _sample_interaction(state, cos_i, near, far, facetness, rules):
    d = Vector(math.sqrt(1.0 - cos_i * cos_i), 0.0, -cos_i)
    transmitted, d = resolve_interaction(state, d, UP, facetness, near, far, rules)
    return 1.0 if transmitted else 0.0, d.x, d.y, d.z


@njit
def _sample_interaction_by_lane(state, lanes, cos_i, near, far, sigma, rules):
    d = to_single_precision(Vector(math.sqrt(1.0 - cos_i * cos_i), 0.0, -cos_i))
    transmitted, d = resolve_interaction_by_lane(
        lanes, d, to_single_precision(UP), sigma, near, far, rules
    )
    return 1.0 if transmitted else 0.0, np.float64(d.x), np.float64(d.y), np.float64(d.z)


def sample_interactions(precision, count, cos_i, n1, n2, k2, facetness, rules, ray=0):
    """Return samples of the interaction with a surface: transmitted or not, and directions."""
    if precision == "double":
        near, far = ComplexIndex(n1, 0.0), ComplexIndex(n2, k2)
        return draw_samples(
            _sample_interaction, count, cos_i, near, far, facetness, rules, width=4, ray=ray
        )
    near, far = ComplexIndex(single(n1), single(0.0)), ComplexIndex(single(n2), single(k2))
    return draw_samples(
        _sample_interaction_by_lane, count, make_lanes(ray), cos_i, near, far,
        single(0.5 * facetness), rules, width=4,
    )  # fmt: skip


PRECISIONS = ["double", pytest.param("single", marks=NEEDS_JIT)]


@pytest.mark.parametrize("precision", PRECISIONS)
def test_reflected_fraction_at_a_smooth_grain(precision):
    rules = splits.Interpretation().to_sampling_rules()
    z = []
    for n1, n2, k2 in ((1.0, 1.31, 0.0), (1.31, 1.0, 0.0), (1.31, 1.33, 1e-3), (1.0, 1.3, 0.5)):
        for cos_i in (1.0, 0.8, 0.5, 0.1):
            out = sample_interactions(precision, N_SAMPLES // 4, cos_i, n1, n2, k2, 0.0, rules)
            transmitted, _, _, dz = out.T
            z += compute_binomial_z(
                transmitted, 1.0 - interface.fresnel(n1, n2, k2, cos_i).reflectance
            )
            assert ((dz < 0.0) == (transmitted == 1.0)).all()
    judge_z(z, "grain")


@njit
def _sample_reflectance(state, cos_i, n1, n2, facetness, rules):
    """Return the reflectance of a sampled facet."""
    d = Vector(math.sqrt(1.0 - cos_i * cos_i), 0.0, -cos_i)
    facet = sample_facet(state, d, UP, facetness, rules.facet_sampling)
    return interface.fresnel(n1, n2, 0.0, facet.cos_facet).reflectance


@njit
def _sample_reflectance_by_lane(state, lanes, cos_i, n1, n2, sigma, rules):
    d = to_single_precision(Vector(math.sqrt(1.0 - cos_i * cos_i), 0.0, -cos_i))
    facet = sample_facet_by_lane(lanes, d, to_single_precision(UP), sigma, rules.facet_sampling)
    return interface.fresnel(n1, n2, 0.0, min(np.float64(facet.cos_facet), 1.0)).reflectance


def sample_reflectances(precision, count, cos_i, n1, n2, facetness, rules, ray):
    """Return samples of the reflectance of facets."""
    if precision == "double":
        return draw_samples(_sample_reflectance, count, cos_i, n1, n2, facetness, rules, ray=ray)
    lanes, sigma = make_lanes(ray), single(0.5 * facetness)
    return draw_samples(_sample_reflectance_by_lane, count, lanes, cos_i, n1, n2, sigma, rules)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_reflected_fraction_at_a_rough_grain(precision):
    # Reflectance averaged over facets against the fraction of reflected rays.  Whichever facet is
    # hit, the ray leaves on the side of the mean surface that was sampled.
    z = []
    ray = 0
    for wrong_side in ("cosine_lobe", "mirror"):
        for rule in ("projected", "unweighted", "any"):
            interpretation = splits.Interpretation(facet_sampling=rule, wrong_side_ray=wrong_side)
            rules = interpretation.to_sampling_rules()
            for n1, n2 in ((1.0, 1.31), (1.31, 1.0)):
                for cos_i in (0.9, 0.3):
                    geometry = cos_i, n1, n2
                    expected = sample_reflectances(
                        precision, N_SAMPLES // 8, *geometry, 0.8, rules, ray
                    )
                    out = sample_interactions(
                        precision, N_SAMPLES // 8, *geometry, 0.0, 0.8, rules, ray + 1
                    )
                    transmitted, dz = out[:, 0], out[:, 3]
                    reflected = 1.0 - transmitted
                    assert ((dz < 0.0) == (transmitted == 1.0)).all()
                    assert np.abs((out[:, 1:] ** 2).sum(axis=1) - 1.0).max() < 1e-6
                    error = math.sqrt((expected.var() + reflected.var()) / len(out))
                    z.append((expected.mean() - reflected.mean()) / error)
                    ray += 2
    judge_z(z, "rough grain")


@njit
def _sample_pore(state, scene):
    return float(sample_pore(rng.uniform(state), scene))


def test_pore_medium_follows_saturation():
    z = []
    for saturation in (0.0, 0.05, 0.3, 1.0):
        pore = draw_samples(
            _sample_pore,
            N_SAMPLES,
            make_scene(splits.Snow().make_grain_population(), saturation=saturation),
        )
        assert set(np.unique(pore)) <= {float(DRY_PORE), float(WET_PORE)}
        z += compute_binomial_z(pore == WET_PORE, saturation)
    judge_z(z, "pore")


@njit
def _sample_source_direction(state, light):
    return sample_source_direction(light, rng.uniform(state))


@pytest.mark.parametrize("diffuse_fraction", [0.0, 0.3, 1.0])
def test_source_mixes_beam_and_lambertian_light(diffuse_fraction):
    beam = 0.8
    d = draw_samples(_sample_source_direction, N_SAMPLES, Source(beam, diffuse_fraction), width=3)
    assert np.abs((d * d).sum(axis=1) - 1.0).max() < 1e-14
    assert d[:, 2].max() < 0.0 and d[:, 0].min() >= 0.0 and (d[:, 1] == 0.0).all()
    from_beam = d[:, 2] == -beam
    z = compute_binomial_z(from_beam, 1.0 - diffuse_fraction)
    if z:
        judge_z(z, "beam")
    if diffuse_fraction > 0.0:
        # For isotropic radiance, the flux through a horizontal plane has density 2μ.
        judge_p({diffuse_fraction: compute_p_of_values(-d[~from_beam, 2], lambda mu: mu * mu, 101)})


PREVIOUS_SEGMENTS = {
    # Directly from the end of the previous segment, and displaced through a grain from there.
    "reversal": (Vector(0.0, 0.0, 0.0), Vector(0.0, 0.0, -1.0), 2e-3),
    "through a grain": (Vector(1e-4, -5e-5, 2e-4), Vector(-0.28, 0.0, -0.96), 3e-3),
}


@pytest.mark.parametrize("name", PREVIOUS_SEGMENTS)
def test_grains_do_not_overlap_the_previous_segment_unless_kept(name):
    previous_segment = PREVIOUS_SEGMENTS[name]
    displacement, back, length = (
        np.array(previous_segment[0]),
        np.array(previous_segment[1]),
        previous_segment[2],
    )
    d = np.array([0.1, 0.0, math.sqrt(0.99)])
    closest = {}
    for rule in ("reject", "keep", "skip"):
        snow = splits.Snow(depth_m=1e4, interpretation={"overlap_with_previous_segment": rule})
        distance, minor, flattening, q, w, _ = sample_next_grains(
            scale_sample_size(20_000), -5e3, d, snow, previous_segment=previous_segment
        )
        # Both ends of the previous segment, relative to the centre of the grain.
        end = to_real_space(q, w, minor, flattening) - distance[:, None] * d - displacement
        closest[rule] = find_closest_approach(end - length * back, end, w, minor, flattening)
    assert min(closest["reject"].min(), closest["skip"].min()) >= 1.0
    assert (closest["keep"] < 1.0).mean() > {"reversal": 0.5, "through a grain": 0.3}[name]


@pytest.mark.parametrize("z", [-1e-4, -9e-4])
def test_grains_do_not_cross_a_boundary_unless_kept(z):
    slab = {"depth": 1e-3, "saturation": 0.0}
    d = np.array([0.8, 0.0, 0.6])
    fraction = {}
    for rule in ("reject", "keep", "skip"):
        snow = splits.Snow(depth_m=1e-3, interpretation={"overlap_with_boundary": rule})
        # Close below the boundary, one ray in 75 hits a grain that fits before it reaches it.
        distance, minor, flattening, q, w, _ = sample_next_grains(
            scale_sample_size(400_000), z, d, snow, slab
        )
        assert distance.size > 50 and distance.max() <= -z / d[2]
        centre = z + distance * d[2] - to_real_space(q, w, minor, flattening)[:, 2]
        # The surface normal is vertical where the half height squared is c² + (b² − c²) w_z².
        major = minor / (1.0 - flattening)
        half = np.sqrt(minor**2 + (major**2 - minor**2) * w[:, 2] ** 2)
        fraction[rule] = ((centre + half > 1e-15) | (centre - half < -1e-3 - 1e-15)).mean()
    assert fraction["reject"] == fraction["skip"] == 0.0
    assert fraction["keep"] > 0.2


def test_skipped_grains_thin_the_poisson_process():
    """Free paths below a boundary where spheres that cross it are skipped.

    Spheres of radius a have their poles a (1 − n_z) above their entry points.  With n_z uniform, or
    its square for projected entry, they fit at depth s < a with probability s/a, or 1 − (1 − s/a)²;
    the integral of that is the optical thickness down to s.
    """
    a, depth = 2e-4, 1e4
    p = {}
    for entry in ("uniform", "projected"):
        snow = splits.Snow(
            depth_m=depth, grain_size_um=(400, 400), sphericity=(1.0, 1.0, 1.0, 0.0),
            density_kg_m3=450,
            interpretation={"overlap_with_boundary": "skip", "entry_point": entry},
        )  # fmt: skip
        distance = sample_next_grains(N_SAMPLES, 0.0, np.array([0.0, 0.0, -1.0]), snow)[0]

        def cdf(s, entry=entry, per_metre=1.0 / snow.mean_grain_distance_m):
            x = np.minimum(s / a, 1.0)
            within = x**2 / 2.0 if entry == "uniform" else x**2 - x**3 / 3.0
            below = np.maximum(s - a, 0.0)
            return -np.expm1(-per_metre * (a * within + below))

        p[entry] = compute_p_of_values(distance, cdf)
    judge_p(p)
