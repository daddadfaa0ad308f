"""Sand grains that rays hit: sizes (SPLITS Eq 25), roundness, and types by volume (Eqs 18-22)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import (
    compute_p_of_counts,
    compute_p_of_values,
    draw_samples,
    judge_p,
    judge_z,
    scale_sample_size,
)
from numba import njit
from scenes import find_next_event, make_medium_scene, make_optics, make_ray_at
from scipy import stats

import splits
from splits.kernels import rng
from splits.kernels.arithmetic import Vector
from splits.kernels.transport.flight import BOUNDARY

N_SAMPLES = scale_sample_size(200_000)
# Bins of equal probability whose edges are no nodes of the table, and both tails.
TAILS = np.array([1e-4, 5e-4, 2e-3])
EDGES = np.concatenate([TAILS, np.arange(1, 53) / 53, 1.0 - TAILS[::-1]])
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
def evaluate_quantile(state, table):
    return rng.interpolate_quantile(table, 0, rng.uniform(state))


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


def test_sizes_of_hit_grains_follow_their_distribution():
    p = {}
    for name, texture in TEXTURES.items():
        curvature = splits.Sand(texture=texture).make_grain_population().types.inverse_semi_major
        sizes = 2.0 / draw_samples(evaluate_quantile, N_SAMPLES, curvature)
        cumulative = compute_struck_cdf(texture)
        p[name, "bins"] = compute_p_of_values(sizes, cumulative, EDGES)
        p[name, "largest gap"] = float(stats.kstest(sizes, cumulative).pvalue)
    judge_p(p)


def test_hit_fractions_of_the_separates():
    """Bin edges are the limits of the separates, where the density is discontinuous."""
    p = {}
    for name, texture in TEXTURES.items():
        sizes = 2.0 / draw_samples(
            evaluate_quantile,
            N_SAMPLES,
            splits.Sand(texture=texture).make_grain_population().types.inverse_semi_major,
            ray=1,
        )
        counts, _ = np.histogram(np.log(sizes), [-np.inf, *LIMITS[1:3], np.inf])
        fractions = np.diff([0.0, *compute_struck_cdf(texture)(np.exp(LIMITS[1:3])), 1.0])
        if np.count_nonzero(fractions) > 1:
            p[name] = compute_p_of_counts(counts, fractions)
    judge_p(p)


def test_mean_size_of_hit_grains_is_consistent_with_attenuation():
    # ∫ s s⁻² f_g / ∫ s⁻² f_g = 1/K1 (Eq 23), from the table: samples have heavy tails.
    for texture in TEXTURES.values():
        sizes = splits.Sand(texture=texture).size_distribution
        table = sizes.tabulate_hit_inverse_sizes()
        probabilities = np.diff(rng.make_table_probabilities(table.size))
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
    generator = np.random.default_rng(7)
    distance = generator.exponential(1.0 / np.array(rates), (20_000, 8))
    nearest = np.bincount(distance.argmin(axis=1), minlength=8)
    probabilities = np.diff([0.0, *sand.make_grain_population().type_cdf])
    judge_p(
        {
            "types": compute_p_of_counts(nearest, probabilities),
            "distance": compute_p_of_values(
                distance.min(axis=1),
                stats.expon(scale=1.0 / sand.make_grain_population().collision_coefficient).cdf,
            ),
        }
    )
