"""What rays strike in sand: sizes (SPLITS Eq 25), roundness, and types by volume (Eqs 18-22)."""

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
from scenes import find_next_event, make_medium_scene, make_new_ray, make_optics
from scipy import stats

import splits
from splits.kernels.math import rng
from splits.kernels.math.vectors import Vector

N_SAMPLES = scale_sample_size(200_000)
# Cells of equal probability that do not fall on the table's own knots, and both tails.
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
def sample_struck_grain(state, z, scene, optics):
    """Return distance, type and size of the next grain, far from all boundaries."""
    found = find_next_event(state, make_new_ray(z, Vector(0.6, 0.0, 0.8)), scene, optics)
    kind, size, _ = found.grain_sample
    leg = math.nan if found.collision.leaves_layer else found.collision.distance
    return leg, float(kind), 2.0 * size.semi_major, math.sqrt(1.0 - size.flattening)


def make_pieces(texture):
    """Return (mass, low, high, a_g, b_g) of every separate in ln s, from texture alone."""
    bounds = np.clip([TAIL, *np.cumsum(texture)], TAIL, 1.0 - TAIL)
    score = stats.norm.ppf(bounds)
    for i, mass in enumerate(texture):
        if mass > 0.0:
            low, high = LIMITS[i : i + 2]
            spread = (high - low) / (score[i + 1] - score[i])
            yield mass, low, high, low - spread * score[i], spread


def compute_struck_cdf(texture):
    """Return the cumulative of sizes of density ∝ s⁻² f_g(s), in closed form.

    In ln s, e^(−x) turns a normal with mean a and deviation b into one with mean a − b², whose
    integral over a separate is in proportion to e^(−a + b²/2); upper tails keep the digits.
    """
    parts = []
    for mass, low, high, a, b in make_pieces(texture):
        moved = stats.norm(a - b * b, b)
        own = stats.norm(a, b)
        factor = mass / (own.cdf(high) - own.cdf(low)) * math.exp(0.5 * b * b - a)
        parts.append((factor, low, high, moved))

    def cumulative(s):
        x = np.log(np.asarray(s, dtype=float))
        total = sum(f * (m.sf(low) - m.sf(high)) for f, low, high, m in parts)
        below = sum(f * (m.sf(low) - m.sf(np.clip(x, low, high))) for f, low, high, m in parts)
        return np.clip(below / total, 0.0, 1.0)

    return cumulative


def test_struck_sizes():
    p = {}
    for name, texture in TEXTURES.items():
        curvature = splits.Sand(texture=texture).make_grain_population().types.curvature
        sizes = 2.0 / draw_samples(evaluate_quantile, N_SAMPLES, curvature)
        cumulative = compute_struck_cdf(texture)
        p[name, "cells"] = compute_p_of_values(sizes, cumulative, EDGES)
        p[name, "largest gap"] = float(stats.kstest(sizes, cumulative).pvalue)
    judge_p(p)


def test_shares_of_the_separates():
    """Cut at the limits of the separates, where the density jumps."""
    p = {}
    for name, texture in TEXTURES.items():
        sizes = 2.0 / draw_samples(
            evaluate_quantile,
            N_SAMPLES,
            splits.Sand(texture=texture).make_grain_population().types.curvature,
            ray=1,
        )
        counts, _ = np.histogram(np.log(sizes), [-np.inf, *LIMITS[1:3], np.inf])
        shares = np.diff([0.0, *compute_struck_cdf(texture)(np.exp(LIMITS[1:3])), 1.0])
        if np.count_nonzero(shares) > 1:
            p[name] = compute_p_of_counts(counts, shares)
    judge_p(p)


def test_mean_of_struck_sizes_belongs_to_the_attenuation():
    # ∫ s s⁻² f_g over ∫ s⁻² f_g is 1/K1 of Eq 23; heavy tails, so on the table, not on samples.
    for texture in TEXTURES.values():
        sizes = splits.Sand(texture=texture).size_distribution
        table = sizes.tabulate_struck_inverse_sizes()
        cells = np.diff(rng.make_table_probabilities(table.size))
        cells *= np.diff(np.log(table)) / np.diff(table)
        assert cells.sum() * sizes.size_attenuation_per_m == pytest.approx(1.0, rel=1e-4)


def test_sizes_that_no_separate_has_are_hardly_drawn():
    """Without silt nothing lies between 2 and 50 µm but what one cell of the table joins."""
    curvature = splits.Sand(texture=(0.1, 0.0, 0.9)).make_grain_population().types.curvature
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


def test_next_grains_are_of_every_type_by_volume_and_alike_in_size():
    sand = splits.Sand(**MANY_TYPES, interpretation={"overlap_with_boundary": "keep"})
    shares = np.array(sand.composition.volume_fractions)
    assert shares.size == 8
    scene, empty = make_medium_scene(sand, depth=1.0), make_optics(np.ones(12))
    leg, kind, size, sphericity = draw_samples(
        sample_struck_grain, N_SAMPLES, -0.5, scene, empty, width=4
    ).T
    assert np.isfinite(leg).all()
    u = compute_struck_cdf(sand.texture)(size)
    p = {
        "types": compute_p_of_counts(np.bincount(kind.astype(int), minlength=8), shares),
        "distance": compute_p_of_values(leg, stats.expon(scale=sand.mean_grain_distance_m).cdf),
        "sizes": compute_p_of_values(size, compute_struck_cdf(sand.texture), EDGES),
        "types and sizes": compute_p_of_counts(
            np.histogram2d(kind, u, bins=[np.arange(9) - 0.5, np.linspace(0, 1, 6)])[0],
            np.outer(shares, np.full(5, 0.2)),
        ),
    }
    judge_p(p)
    # Sizes and shapes are independent of one another (4.2.6).
    correlation = stats.spearmanr(size, sphericity).statistic
    judge_z([correlation * math.sqrt(N_SAMPLES - 1)], "size and shape")


def test_picking_by_cumulative_shares():
    shares = np.array([0.25, 0.0, 0.5, 0.25])
    cumulative = np.cumsum(shares)
    for u, kind in ((0.0, 0), (0.2499, 0), (0.25, 2), (0.7499, 2), (0.75, 3), (1.0, 3)):
        assert rng.sample_discrete(cumulative, u) == kind
    # Rounding may leave the last sum a little below 1.
    assert rng.sample_discrete(np.array([0.5, 1.0 - 1e-16]), 1.0 - 1e-17) == 1


def test_each_type_by_itself_is_met_at_its_own_distance():
    """Eq 21 draws a distance per type and takes the least: rates K_j = v_j (1 − P) K add up."""
    sand = splits.Sand(**MANY_TYPES)
    k = [
        v * (1.0 - sand.porosity) * sand.attenuation_per_m
        for v in sand.composition.volume_fractions
    ]
    generator = np.random.default_rng(7)
    distance = generator.exponential(1.0 / np.array(k), (20_000, 8))
    nearest = np.bincount(distance.argmin(axis=1), minlength=8)
    cells = np.diff([0.0, *sand.make_grain_population().type_cdf])
    judge_p(
        {
            "types": compute_p_of_counts(nearest, cells),
            "distance": compute_p_of_values(
                distance.min(axis=1),
                stats.expon(scale=1.0 / sand.make_grain_population().attenuation).cdf,
            ),
        }
    )
