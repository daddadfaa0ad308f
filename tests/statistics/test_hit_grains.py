"""Grains that rays hit: sizes, shapes, entry points; sand grains by size, roundness and type."""

import math

import numpy as np
import pytest
from chi2 import (
    compute_p_of_counts,
    compute_p_of_unit_square,
    compute_p_of_values,
    draw_samples,
    judge_p,
    judge_z,
    scale_sample_size,
    tabulate_cdf,
)
from events import sample_entry
from numba import njit
from scenes import find_next_event, make_medium_scene, make_optics, make_ray_at
from scipy import stats
from spheroids import compute_normal, dot_product, evaluate_quadratic, to_real_space

import splits
from splits.kernels import rng
from splits.kernels.grains.grain_path import sample_entry_variates
from splits.kernels.grains.spheroid import GrainSize
from splits.kernels.scene import PROJECTED_ENTRY, UNIFORM_ENTRY, Vector, make_table_probabilities
from splits.kernels.transport.flight import BOUNDARY
from splits.media import grain_statistics

N_SAMPLES = scale_sample_size(200_000)
SPHERICITIES = (0.3, 0.6, 0.798, 0.95, 1.0)
# Bins of equal probability whose edges are no nodes of the table, and both tails.
TAILS = np.array([1e-4, 5e-4, 2e-3])
EDGES = np.concatenate([TAILS, np.arange(1, 53) / 53, 1.0 - TAILS[::-1]])
LIMITED_NORMALS = {
    "Table 1 sphericity": (0.6, 0.95, 0.798, 0.064),
    "Table 1 facetness": (0.2, 0.4, 0.3, 0.072),
    "one-sided": (0.3, 1.0, 0.3, 0.2),
    "nearly uniform": (0.1, 0.9, 0.5, 1.0),
    "far limits": (0.1, 1.0, 0.55, 0.05),
}


@njit
def evaluate_quantile(state, table):
    return rng.interpolate_quantile(table, 0, rng.uniform(state))


def sample_table(values, count=N_SAMPLES):
    return draw_samples(evaluate_quantile, count, np.ascontiguousarray(values)[np.newaxis])


def compute_area_per_volume(sphericity):
    """Return surface over volume of a prolate spheroid of major axis 1, from textbook formulas."""
    b, c = 0.5, 0.5 * sphericity**2
    e = np.sqrt(1.0 - (c / b) ** 2)
    area = 2.0 * np.pi * c * (c + b * np.arcsin(e) / e)
    return area / (4.0 / 3.0 * np.pi * b * c * c)


@pytest.mark.parametrize("limits", [(3e-4, 7.5e-4), (5e-5, 2e-3)], ids=str)
def test_sizes_of_hit_grains_follow_their_distribution(limits):
    low, high = limits
    attenuation = 1 / sample_table(
        grain_statistics.tabulate_hit_inverse_sizes(low, high, "cross_section")
    )
    uniform = 1 / sample_table(grain_statistics.tabulate_hit_inverse_sizes(low, high, "uniform"))
    judge_p(
        {
            "s^-2": compute_p_of_values(
                attenuation, lambda s: (1 / low - 1 / s) / (1 / low - 1 / high), EDGES
            ),
            "uniform": compute_p_of_values(uniform, lambda s: (s - low) / (high - low), EDGES),
        }
    )


@pytest.mark.parametrize("limits", [(300.0, 750.0), (50.0, 2000.0), (10.0, 1e4)], ids=str)
def test_mean_size_of_hit_grains_is_consistent_with_attenuation(limits):
    # The mean over the density s^-2 P(s) is 1/K1; 1/s is linear in each interval of the table, so
    # the mean of s over an interval is the logarithmic mean of its ends.
    table = grain_statistics.tabulate_hit_inverse_sizes(*limits, "cross_section")
    means = np.diff(make_table_probabilities(table.size)) * np.diff(np.log(table)) / np.diff(table)
    attenuation = grain_statistics.compute_size_attenuation(*limits)
    assert means.sum() * attenuation == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("sd", [0.05, 1e-3, 3e-4, 1e-5, 1e-9])
def test_narrow_sphericities_attenuate_as_their_mean(sd):
    value = grain_statistics.compute_shape_attenuation(0.6, 0.95, 0.798, sd)
    limit = grain_statistics.surface_to_volume_ratio(0.798) / 4.0
    # Second-order Taylor expansion: the curvature of A is below 40.
    assert value == pytest.approx(limit, abs=10.0 * sd**2 + 1e-12)
    table = grain_statistics.tabulate_hit_sphericities(0.6, 0.95, 0.798, sd)
    assert np.isfinite(table).all()
    assert abs(table[table.size // 2] - 0.798) <= sd


def test_sphericities_of_hit_grains_follow_their_distribution():
    p = {}
    for name, (low, high, mean, sd) in LIMITED_NORMALS.items():
        values = sample_table(grain_statistics.tabulate_hit_sphericities(low, high, mean, sd))

        def density(psi, mean=mean, sd=sd):
            return compute_area_per_volume(np.minimum(psi, 1.0 - 1e-9)) * stats.norm.pdf(
                psi, mean, sd
            )

        p[name] = compute_p_of_values(values, tabulate_cdf(density, low, high), EDGES)
    judge_p(p)


def test_truncated_normal_table_follows_its_distribution():
    p = {}
    for name, (low, high, mean, sd) in LIMITED_NORMALS.items():
        exact = stats.truncnorm((low - mean) / sd, (high - mean) / sd, loc=mean, scale=sd)
        table = grain_statistics.tabulate_truncated_normal(low, high, mean, sd)
        p[name] = compute_p_of_values(sample_table(table), exact.cdf, EDGES)
    judge_p(p)


def compute_area_below(z, sphericity):
    """Return the fraction of a prolate spheroid's area below z (unit semi-major axis)."""
    e = np.sqrt(1.0 - sphericity**4)
    if e == 0.0:
        return 0.5 * (1.0 + z)
    top = e * np.sqrt(1.0 - e * e) + np.arcsin(e)
    return 0.5 * (1.0 + (e * z * np.sqrt(1.0 - (e * z) ** 2) + np.arcsin(e * z)) / top)


@njit
def _sample_axial(state, flattening):
    return 2.0 * sample_entry_variates(state, GrainSize(1.0, flattening)).u_axial - 1.0


def test_axial_positions_follow_the_surface_area():
    p = {}
    for psi in SPHERICITIES:
        z = draw_samples(_sample_axial, N_SAMPLES, 1.0 - psi * psi, ray=1)
        p[psi] = compute_p_of_values(z, lambda z, psi=psi: compute_area_below(z, psi))
    judge_p(p)


RAY = np.array([0.48, -0.64, -0.6])
SEMI_AXIS_M = 2.5
ENTRIES = {"uniform": UNIFORM_ENTRY, "projected": PROJECTED_ENTRY}


@njit
def _sample_entry(state, x, y, z, size, rule):
    entry = sample_entry(state, Vector(x, y, z), size, rule)
    q, w, n = entry.grain.q, entry.grain.w, entry.normal
    return (
        q.x,
        q.y,
        q.z,
        w.x,
        w.y,
        w.z,
        n.x,
        n.y,
        n.z,
        entry.axial_position,
        entry.semi_major,
        entry.grain.semi_minor,
    )


def sample_entries(psi, entry):
    """Return entry points from the centre, major axes and normals of grains of semi-axis B."""
    flattening = 1.0 - psi * psi
    out = draw_samples(
        _sample_entry,
        N_SAMPLES,
        *RAY,
        GrainSize(SEMI_AXIS_M, flattening),
        ENTRIES[entry],
        width=12,
        ray=1,
    )
    q, axis, normal = out[:, :3], out[:, 3:6], out[:, 6:9]
    # Quantities that the kernel uses in its overlap tests.
    assert np.abs((q * axis).sum(axis=1) - out[:, 9]).max() < 1e-13
    assert (out[:, 10] == SEMI_AXIS_M).all() and np.abs(
        out[:, 11] - SEMI_AXIS_M * psi * psi
    ).max() < 1e-15 * SEMI_AXIS_M
    assert np.abs((q * q).sum(axis=1) - 1.0).max() < 1e-13
    return to_real_space(q, axis, SEMI_AXIS_M * psi * psi, flattening), axis, normal


def compute_facing_cdf(x, entry):
    """Return the cumulative distribution of −d·n.

    A random orientation of the grain makes the normal at any of its points isotropic, so −d·n is
    uniform on (0, 1) on the half that faces the ray; projected area adds a weight of x.
    """
    return x if entry == "uniform" else x * x


def compute_axis_cdf(psi, entry):
    """Return the cumulative distribution of |d·w|: uniform, or weighted by projected area."""
    if entry == "uniform":
        return lambda x: x
    c2 = psi**4
    return tabulate_cdf(lambda x: np.sqrt(c2 * x * x + 1.0 - x * x), 0.0, 1.0)


def compute_axial_cdf(psi, entry):
    """Return the cumulative distribution of the axial coordinate of entry points, by quadrature.

    At axial coordinate z the normal has the cosine q to the axis; the weight is the mean of |d·n|
    (projected) or 1 (uniform) over all directions d of the ray.
    """
    c = psi * psi

    def weight(z):
        if entry == "uniform":
            return 1.0
        q = z / np.sqrt(z * z + (1.0 - z * z) / (c * c))
        mu, w = np.polynomial.legendre.leggauss(120)
        phi = (np.arange(120) + 0.5) * np.pi / 120
        root = np.sqrt((1 - mu**2) * (1 - q * q))[:, None]
        return 0.5 * w @ np.abs(mu[:, None] * q + root * np.cos(phi)).mean(axis=1)

    z = np.linspace(-1.0, 1.0, 41)
    weights = np.array([weight(v) for v in z])

    def density(v):
        return np.sqrt(1.0 - (1.0 - c * c) * v * v) * np.interp(v, z, weights)

    return tabulate_cdf(density, -1.0, 1.0)


@pytest.mark.parametrize("entry", ENTRIES)
def test_entry_points_follow_their_distributions(entry):
    p = {}
    for psi in SPHERICITIES:
        point, axis, normal = sample_entries(psi, entry)
        c, flattening = SEMI_AXIS_M * psi * psi, 1.0 - psi * psi
        assert np.abs((axis * axis).sum(axis=1) - 1.0).max() < 1e-14
        assert np.abs(evaluate_quadratic(point, axis, c, flattening) - 1.0).max() < 1e-12
        assert np.abs(compute_normal(point, axis, c, flattening) - normal).max() < 1e-12
        facing = -normal @ RAY
        assert facing.min() > 0.0
        p[psi, "facing"] = compute_p_of_values(facing, lambda x: compute_facing_cdf(x, entry))
        p[psi, "axis"] = compute_p_of_values(np.abs(axis @ RAY), compute_axis_cdf(psi, entry))
        n_forward = int((axis @ RAY > 0.0).sum())
        p[psi, "axis side"] = compute_p_of_counts([n_forward, N_SAMPLES - n_forward], [0.5, 0.5])
        z = (point * axis).sum(axis=1) / SEMI_AXIS_M
        p[psi, "axial"] = compute_p_of_values(z, compute_axial_cdf(psi, entry))
        # Axial coordinate and angle to the ray are independent under both rules.
        p[psi, "joint"] = compute_p_of_unit_square(
            compute_area_below(z, psi), compute_facing_cdf(facing, entry), bins=10
        )
        # The azimuth around the ray is uniform.
        u = np.cross(RAY, [1.0, 0.0, 0.0])
        u /= np.linalg.norm(u)
        azimuth = np.arctan2(point @ np.cross(RAY, u), point @ u) / (2 * np.pi) % 1.0
        p[psi, "azimuth"] = compute_p_of_values(azimuth, lambda x: x)
        # The azimuth of the axis around the normal is uniform: grains are randomly oriented.
        v = np.cross(normal, RAY)
        azimuth = np.arctan2(
            dot_product(axis, v)[:, 0], dot_product(axis, np.cross(normal, v))[:, 0]
        )
        azimuth = azimuth / (2 * np.pi) % 1.0
        p[psi, "turn"] = compute_p_of_values(azimuth, lambda x: x)
    judge_p(p)


# Bins of equal probability whose edges are no nodes of the table, and both tails.
LIMITS = np.log([5e-8, 2e-6, 5e-5, 2e-3])
TAIL = 1e-4
TEXTURES = {
    "Table 5": (0.0, 0.15, 0.85),
    "sand alone": (0.0, 0.0, 1.0),
    "all three": (0.01, 0.135, 0.855),
}
MANY_TYPES = {
    "iron_oxide": 0.04,
    "hematite_ratio": 0.4,
    "magnetite": 0.1,
    "partition": (0.4, 0.35, 0.25),
}


@njit
def sample_hit_grain(state, z, scene, optics):
    """Return distance, type and size of the next grain, far from all boundaries."""
    event = find_next_event(state, make_ray_at(z, Vector(0.6, 0.0, 0.8)), scene, optics)
    grain_type, size, _ = event.grain_sample
    distance = math.nan if event.kind == BOUNDARY else event.distance
    return distance, float(grain_type), 2.0 * size.semi_major, math.sqrt(1.0 - size.flattening)


def iterate_separates(texture):
    """Yield (mass, low, high, a_g, b_g) of every separate in ln s, from texture only."""
    bounds = np.clip([TAIL, *np.cumsum(texture)], TAIL, 1.0 - TAIL)
    score = stats.norm.ppf(bounds)
    for i, mass in enumerate(texture):
        if mass > 0.0:
            low, high = LIMITS[i : i + 2]
            spread = (high - low) / (score[i + 1] - score[i])
            yield mass, low, high, low - spread * score[i], spread


def compute_struck_cdf(texture):
    """Return the cumulative distribution of sizes of density ∝ s⁻² f_g(s), in closed form.

    In ln s, the factor e^(−x) changes a normal density with mean a and deviation b into one with
    mean a − b², whose integral over a separate is proportional to e^(−a + b²/2).  Upper tails are
    used to keep the digits.
    """
    separates = []
    for mass, low, high, a, b in iterate_separates(texture):
        shifted = stats.norm(a - b * b, b)
        original = stats.norm(a, b)
        factor = mass / (original.cdf(high) - original.cdf(low)) * math.exp(0.5 * b * b - a)
        separates.append((factor, low, high, shifted))

    def cumulative(s):
        x = np.log(np.asarray(s, dtype=float))
        total = sum(
            factor * (shifted.sf(low) - shifted.sf(high))
            for factor, low, high, shifted in separates
        )
        below = sum(
            factor * (shifted.sf(low) - shifted.sf(np.clip(x, low, high)))
            for factor, low, high, shifted in separates
        )
        return np.clip(below / total, 0.0, 1.0)

    return cumulative


def test_sizes_of_hit_sand_grains_follow_their_distribution():
    p = {}
    for name, texture in TEXTURES.items():
        curvature = splits.Sand(texture=texture).make_grain_population().types.inverse_semi_major
        sizes = 2.0 / draw_samples(evaluate_quantile, N_SAMPLES, curvature)
        cumulative = compute_struck_cdf(texture)
        p[name, "bins"] = compute_p_of_values(sizes, cumulative, EDGES)
        p[name, "largest gap"] = float(stats.kstest(sizes, cumulative).pvalue)
    judge_p(p)


def test_mean_size_of_hit_sand_grains_is_consistent_with_attenuation():
    # ∫ s s⁻² f_g / ∫ s⁻² f_g = 1/K1 (Eq 23), from the table: samples have heavy tails.
    for texture in TEXTURES.values():
        sizes = splits.Sand(texture=texture).size_distribution
        table = sizes.tabulate_hit_inverse_sizes()
        probabilities = np.diff(make_table_probabilities(table.size))
        probabilities *= np.diff(np.log(table)) / np.diff(table)
        assert probabilities.sum() * sizes.size_attenuation_per_m == pytest.approx(1.0, rel=1e-4)


def test_sizes_between_separates_are_rare():
    """Without silt, only one interval of the table interpolates between 2 and 50 µm."""
    curvature = (
        splits.Sand(texture=(0.1, 0.0, 0.9)).make_grain_population().types.inverse_semi_major
    )
    x = np.log(2.0 / draw_samples(evaluate_quantile, N_SAMPLES, curvature, ray=2))
    inside = (x > LIMITS[1] + 1e-9) & (x < LIMITS[2] - 1e-9)
    assert inside.mean() < 2.0 / curvature.shape[1]


def test_facetness_is_one_less_roundness():
    p = {}
    for mean, sd in ((0.482, 0.072), (0.05, 0.3), (1.0, 0.1), (0.5, 1.0)):
        facetness = splits.Sand(roundness=(mean, sd)).make_grain_population().types.facetness
        roundness = stats.truncnorm((0.0 - mean) / sd, (1.0 - mean) / sd, loc=mean, scale=sd)
        p[mean, sd] = compute_p_of_values(
            draw_samples(evaluate_quantile, N_SAMPLES, facetness),
            lambda f, r=roundness: r.sf(1.0 - f),
            EDGES,
        )
    judge_p(p)


def test_next_grains_follow_volume_fractions_and_size_distribution():
    sand = splits.Sand(**MANY_TYPES, interpretation={"overlap_with_boundary": "keep"})
    fractions = np.array(sand.composition.volume_fractions)
    assert fractions.size == 8
    scene, empty = make_medium_scene(sand, depth=1.0), make_optics(np.ones(12))
    distance, grain_type, size, sphericity = draw_samples(
        sample_hit_grain, N_SAMPLES, -0.5, scene, empty, width=4
    ).T
    assert np.isfinite(distance).all()
    u = compute_struck_cdf(sand.texture)(size)
    p = {
        "types": compute_p_of_counts(np.bincount(grain_type.astype(int), minlength=8), fractions),
        "distance": compute_p_of_values(
            distance, stats.expon(scale=sand.mean_grain_distance_m).cdf
        ),
        "sizes": compute_p_of_values(size, compute_struck_cdf(sand.texture), EDGES),
        "types and sizes": compute_p_of_counts(
            np.histogram2d(grain_type, u, bins=[np.arange(9) - 0.5, np.linspace(0, 1, 6)])[0],
            np.outer(fractions, np.full(5, 0.2)),
        ),
    }
    judge_p(p)
    # Sizes and shapes are independent of one another (4.2.6).
    correlation = stats.spearmanr(size, sphericity).statistic
    judge_z([correlation * math.sqrt(N_SAMPLES - 1)], "size and shape")


def test_sample_discrete_inverts_the_cumulative_distribution():
    fractions = np.array([0.25, 0.0, 0.5, 0.25])
    cumulative = np.cumsum(fractions)
    for u, index in ((0.0, 0), (0.2499, 0), (0.25, 2), (0.7499, 2), (0.75, 3), (1.0, 3)):
        assert rng.sample_discrete(cumulative, u) == index
    # Rounding may leave the last cumulative value slightly below 1.
    assert rng.sample_discrete(np.array([0.5, 1.0 - 1e-16]), 1.0 - 1e-17) == 1


def test_nearest_of_independent_types_has_the_total_rate():
    """The smallest distance of all types (Eq 21) has the rate Σ K_j with K_j = v_j (1 − P) K."""
    sand = splits.Sand(**MANY_TYPES)
    rates = [
        v * (1.0 - sand.porosity) * sand.attenuation_per_m
        for v in sand.composition.volume_fractions
    ]
    population = sand.make_grain_population()
    assert population.collision_coefficient == pytest.approx(sum(rates), rel=1e-9)
    probabilities = np.diff([0.0, *population.type_cdf])
    np.testing.assert_allclose(probabilities, np.array(rates) / sum(rates), rtol=1e-9)
