"""Samplers of the vectorized kernel, in single precision, against their distributions."""

import math
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest
from chi2 import (
    BIN_EDGES,
    BIN_PROBABILITIES,
    NEEDS_JIT,
    TAIL_PROBABILITIES,
    compute_p_of_counts,
    compute_p_of_unit_square,
    compute_p_of_values,
    draw_samples,
    judge_p,
    judge_z,
    start_random_stream,
    uniform_cdf,
)
from events import make_lanes, sample_facet_by_lane, start_lane, to_single_precision
from numba import njit
from scenes import keep_all_grains, make_medium_scene
from scipy import stats

import splits
from splits.kernels import rng
from splits.kernels.arithmetic import log, to_single
from splits.kernels.grains.grain_path import get_layer_geometry
from splits.kernels.scene import UP, Features, Vector
from splits.kernels.vectorized import lanes as lane_module
from splits.kernels.vectorized import passes
from splits.kernels.vectorized.lanes import Lane, gather_interpolate
from splits.kernels.vectorized.passes import draw_interaction_variates
from splits.media import grain_statistics

pytestmark = NEEDS_JIT

N_SAMPLES = 400_000
single = np.float32


@njit
def draw_bits(state):
    """Return the stream's next 64 random bits."""
    state[0] += rng.GOLDEN_GAMMA
    return rng.mix64(state[0])


# --- streams ----------------------------------------------------------------------------------


@njit
def _draw_words(lanes, i, first, out):
    lane = Lane(lanes, i)
    for offset in range(out.size):
        lane.n_drawn = np.uint32(first)
        out[offset] = lane_module.compute_random_bits(lane, offset)


@njit
def _to_unit_interval(bits):
    return lane_module.to_uniform_31(np.uint64(bits))


def test_uniform_numbers_are_below_one():
    """Numbers rounded to 1 would select a grain type after the last."""
    assert max(_to_unit_interval(2**31 - 1 - i) for i in range(200)) == 1.0 - 2.0**-24
    assert _to_unit_interval(0) == 2.0**-32
    assert _to_unit_interval(2**30) == 0.5


@njit
def _draw_stream_words(state, out):
    for i in range(out.size):
        out[i] = draw_bits(state)


@njit
def _draw_doubles(words, out):
    for i in range(out.size):
        out[i] = lane_module.to_uniform_52(words[i])


@pytest.mark.parametrize("lane", [0, 1, lane_module.N_LANES - 1])
def test_lanes_use_the_random_stream_of_their_ray(lane):
    lanes = np.full(lane_module.STATE_SIZE, 0xDEADBEEF, dtype=np.uint32)
    for ray in (0, 1, 12_345, 2**40):
        state = start_random_stream(ray)
        start_lane(lanes, lane, state[0])
        expected, actual = (np.empty(1000, dtype=np.uint64) for _ in range(2))
        _draw_stream_words(state, expected)
        # A new ray has drawn no numbers: its count starts at 1.
        _draw_words(lanes, lane, 1, actual)
        np.testing.assert_array_equal(actual, expected)
        _draw_words(lanes, lane, 101, actual[:900])
        np.testing.assert_array_equal(actual[:900], expected[100:])
        doubles = np.empty(1000)
        _draw_doubles(expected, doubles)
        np.testing.assert_array_equal(doubles, draw_samples(rng.uniform, 1000, ray=ray))


def test_streams_continue_after_2_to_the_31_numbers():
    lanes = np.zeros(lane_module.STATE_SIZE, dtype=np.uint32)
    start = start_random_stream(5)
    start_lane(lanes, 3, start[0])
    actual, expected = np.empty(64, dtype=np.uint64), np.empty(64, dtype=np.uint64)
    for first in (2**31 - 32, 2**32 - 64):
        _draw_words(lanes, 3, first, actual)
        ahead = (int(start[0]) + (first - 1) * int(rng.GOLDEN_GAMMA)) % 2**64
        _draw_stream_words(np.array([ahead], dtype=np.uint64), expected)
        np.testing.assert_array_equal(actual, expected)


# --- uniform numbers --------------------------------------------------------------------------


@njit
def _draw_three(state):
    a, b, c = lane_module.to_three_uniforms(draw_bits(state))
    return float(a), float(b), float(c)


@njit
def _to_uniform(word):
    a, b, c = lane_module.to_three_uniforms(word)
    return (
        float(a),
        float(b),
        float(c),
        float(lane_module.to_uniform_46(word)),
        lane_module.to_uniform_52(word),
    )


def test_three_numbers_are_uniform_and_independent():
    out = draw_samples(_draw_three, N_SAMPLES, width=3)
    assert out.min() > 0.0 and out.max() < 1.0
    p = {i: compute_p_of_values(out[:, i], uniform_cdf, BIN_EDGES) for i in range(3)}
    for i, j in ((0, 1), (0, 2), (1, 2)):
        p[i, j] = compute_p_of_unit_square(out[:, i], out[:, j])
    cube_counts = np.histogramdd(out, bins=6, range=[(0, 1)] * 3)[0]
    p["all"] = compute_p_of_counts(cube_counts, np.full(216, 1 / 216))
    # Independence of successive numbers, and uniformity of the lowest of the 21 bits.
    p["successive"] = compute_p_of_unit_square(out[:-1, 2], out[1:, 0])
    for i in range(3):
        p["low bits", i] = compute_p_of_values(np.modf(out[:, i] * 2.0**15)[0], uniform_cdf, 16)
    judge_p(p)


def test_extreme_random_words_give_valid_numbers():
    ends = [np.array(_to_uniform(np.uint64(word))) for word in (0, 2**64 - 1)]
    assert ends[0] == pytest.approx([2.0**-22] * 3 + [2.0**-47, 2.0**-53], rel=1e-7)
    assert ends[1][:3] == pytest.approx([1.0 - 2.0**-22] * 3, abs=1e-9)
    assert (ends[1][:3] < 1.0).all() and ends[1][4] < 1.0
    # Rounded to single precision, the largest is 1: its logarithm is 0, and finite.
    assert ends[1][3] <= 1.0


@njit
def _draw_fine_uniform(state, zeros):
    """Return a number sampled with `zeros` leading zero bits, times 2^zeros."""
    word = draw_bits(state) >> np.uint64(zeros)
    return float(lane_module.to_uniform_46(word)) * 2.0**zeros


@njit
def _draw_path_remainder(state, zeros):
    """Return −ln u of a number with `zeros` leading zero bits, less zeros · ln 2."""
    word = draw_bits(state) >> np.uint64(zeros)
    return -float(log(lane_module.to_uniform_46(word))) - zeros * math.log(2.0)


def test_fine_numbers_are_uniform_in_the_lower_tail():
    """Numbers below 2^-k, which are rare, have the same distribution after scaling."""
    p = {}
    for zeros in (0, 1, 10, 22, 23, 24, 30, 36):
        u = draw_samples(_draw_fine_uniform, N_SAMPLES, zeros, ray=zeros)
        assert u.min() > 0.0 and u.max() <= 1.0
        # The resolution of 2^-46 suffices below 2^-36 for 64 bins of equal probability.
        p["uniform", zeros] = compute_p_of_values(np.minimum(u, 1.0 - 1e-12), uniform_cdf, 64)
        if zeros <= 30:
            tail = np.concatenate([BIN_PROBABILITIES, 1.0 - TAIL_PROBABILITIES[::-1]])
            # The logarithm is not resolved below 6e-8, the width of the smallest number.
            remainder = draw_samples(_draw_path_remainder, N_SAMPLES, zeros, ray=100 + zeros)
            p["exponential", zeros] = compute_p_of_values(
                np.maximum(remainder, 0.0), stats.expon.cdf, tail
            )
    judge_p(p)


# --- tilted facets ----------------------------------------------------------------------------


@njit
def _sample_half_normal(state, lanes):
    return float(draw_interaction_variates(Lane(lanes, 0), True, True).half_normal)


@njit
def _sample_half_circle(state, lanes):
    azimuth = draw_interaction_variates(Lane(lanes, 0), True, True).azimuth
    return float(azimuth.cos), float(azimuth.sin)


def test_variates_of_an_interaction_follow_their_distributions():
    far = np.concatenate([np.arange(1, 50) / 50, 1.0 - np.array([1e-2, 3e-3, 1e-3, 3e-4])])
    normal = draw_samples(_sample_half_normal, N_SAMPLES, make_lanes())
    cos, sin = draw_samples(_sample_half_circle, N_SAMPLES, make_lanes(), width=2).T
    assert np.abs(cos * cos + sin * sin - 1.0).max() < 1e-6 and cos.min() > -1e-6
    azimuth = np.arctan2(sin, cos) / np.pi + 0.5
    judge_p(
        {
            "normal": compute_p_of_values(normal, stats.halfnorm.cdf, far),
            "azimuth": compute_p_of_values(azimuth, uniform_cdf, 101),
            "both": compute_p_of_unit_square(stats.halfnorm.cdf(normal), azimuth),
        }
    )


MIN_SINE = single(1e-4)
"""Smallest sine of incidence for which facets are rotated exactly (`arithmetic.Precision`)."""


@njit
def _sample_facet(state, lanes, sigma, cos_i, sin_i, rule):
    """Return tilt and azimuth of a sampled facet, and the cosine of incidence on it."""
    zero = single(0.0)
    d = Vector(sin_i, zero, -cos_i)
    facet = sample_facet_by_lane(lanes, d, to_single_precision(UP), sigma, rule)
    cos_facet = -facet.cos_facet if facet.back_side else facet.cos_facet
    tilt = single(1.0) - facet.tilt.cos
    sine = facet.tilt.sin * max(sin_i, MIN_SINE)
    return float(tilt), float(sine), float(facet.azimuth.sin), float(facet.azimuth.cos), cos_facet


@pytest.mark.parametrize("rule", ["projected", "unweighted", "any"])
def test_facets_follow_their_density(rule):
    from test_surface_statistics import (
        N_AZIMUTH_BINS,
        N_TILT_BINS,
        RULES,
        compute_bin_probabilities,
        make_tilt_distribution,
    )

    p = {}
    for number, (facetness, cos_i) in enumerate(product((0.3, 1.0), (0.05, 0.5, 1.0))):
        sin_i = math.sqrt(1.0 - cos_i**2)
        out = draw_samples(
            _sample_facet, N_SAMPLES, make_lanes(100 * number), single(0.5 * facetness),
            single(cos_i), single(sin_i), RULES[rule], width=5,
        )  # fmt: skip
        x, tilt_sine, sine, cosine, cos_facet = out.T
        # 1 − cos of the tilt has lost its last digits.
        assert np.abs(tilt_sine**2 - x * (2.0 - x)).max() < 1e-6
        expected = (1.0 - x) * cos_i + tilt_sine * max(sin_i, MIN_SINE) * cosine
        assert np.abs(cos_facet - expected).max() < 1e-6
        assert rule == "any" or cos_facet.min() >= 0.0
        azimuth = np.arctan2(sine, cosine) / (2.0 * np.pi) % 1.0
        counts = np.histogram2d(
            make_tilt_distribution(facetness).cdf(x), azimuth, bins=(N_TILT_BINS, N_AZIMUTH_BINS),
            range=((0, 1), (0, 1)),
        )[0]  # fmt: skip
        assert counts.sum() == N_SAMPLES
        p[facetness, cos_i] = compute_p_of_counts(
            counts, compute_bin_probabilities(facetness, cos_i, rule)
        )
    judge_p(p)


# --- tables -----------------------------------------------------------------------------------


NEW_ROUGHNESS = lane_module.N_LANES * Lane.fields["new_roughness"].row


@njit
def _look_up(table, row, x):
    """Return the value that a lane interpolates in a table."""
    lanes = np.zeros(lane_module.STATE_SIZE, dtype=single)
    lane = Lane(lanes, 0)
    lane.new_type, lane.quantile_roughness = row, x
    gather_interpolate(table, lane, "new_type", "quantile_roughness", "new_roughness")
    return lanes[NEW_ROUGHNESS]


@njit
def _sample_quantile(state, table):
    """Return a quantile from 31 bits, interpolated at a single-precision position."""
    u = (single(np.int32(draw_bits(state) >> np.uint64(33))) + single(0.5)) * single(2.0**-31)
    return float(
        _look_up(table, 0, passes.compute_quantile_position(u, single(table.shape[1] - 1)))
    )


@njit
def _look_up_exact(table, exact, u, out):
    for i in range(u.size):
        x = passes.compute_quantile_position(u[i], single(table.shape[1] - 1))
        out[i, 0] = _look_up(table, 0, x)
        out[i, 1] = rng.interpolate_quantile(exact, 0, float(u[i]))


TABLES = {
    "sizes": (
        grain_statistics.tabulate_hit_inverse_sizes(3e-4, 7.5e-4, "cross_section"),
        lambda x: (x - 1 / 7.5e-4) / (1 / 3e-4 - 1 / 7.5e-4),
    ),
    "sizes 1000 : 1": (
        grain_statistics.tabulate_hit_inverse_sizes(1e-5, 1e-2, "cross_section"),
        lambda x: (x - 1e2) / (1e5 - 1e2),
    ),
    "facetness": (
        grain_statistics.tabulate_truncated_normal(0.2, 0.4, 0.3, 0.072),
        stats.truncnorm(-0.1 / 0.072, 0.1 / 0.072, loc=0.3, scale=0.072).cdf,
    ),
    "far limits": (
        grain_statistics.tabulate_truncated_normal(0.1, 1.0, 0.55, 0.05),
        stats.truncnorm(-9.0, 9.0, loc=0.55, scale=0.05).cdf,
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_sample_their_quantile_function(name):
    values, cdf = TABLES[name]
    table = np.ascontiguousarray(values, dtype=single)[np.newaxis]
    sample = draw_samples(_sample_quantile, N_SAMPLES, table)
    far = 10.0 ** np.arange(-4.0, -1.0, 0.5)
    judge_p(
        {
            "bins": compute_p_of_values(sample, lambda x: np.clip(cdf(x), 0.0, 1.0), BIN_EDGES),
            "low": compute_p_of_values(sample, lambda x: np.clip(cdf(x), 0.0, 1.0), far),
            "high": compute_p_of_values(
                sample, lambda x: np.clip(cdf(x), 0.0, 1.0), 1.0 - far[::-1]
            ),
        }
    )


@pytest.mark.parametrize("name", TABLES)
def test_table_lookup_agrees_with_double_precision(name):
    exact = np.ascontiguousarray(TABLES[name][0])[np.newaxis]
    near = np.logspace(-9.3, -0.4, 200_000)
    u = np.concatenate([near, 1.0 - near, np.linspace(0.0, 1.0, 200_001)]).astype(single)
    actual = np.empty((u.size, 2))
    _look_up_exact(exact.astype(single), exact, u, actual)
    # Positions have rounding errors, near the upper end 1e-4 of an interval.
    steps = np.abs(np.diff(exact[0])).max()
    error = np.abs(actual[:, 0] - actual[:, 1])
    assert (error <= 3e-7 * np.abs(actual[:, 1]) + 4e-4 * steps).all()
    assert actual.min() >= exact.min() * (1 - 1e-7) and actual.max() <= exact.max() * (1 + 1e-7)


def test_types_use_their_own_row_of_a_table():
    table = np.array([[0.0, 1.0, 2.0], [10.0, 12.0, 16.0]], dtype=single)
    assert [_look_up(table, row, 1.5) for row in (0, 1)] == [1.5, 14.0]
    assert [_look_up(table[:1].copy(), row, 1.5) for row in (0, 1, 7)] == [1.5] * 3


N_LANES = lane_module.N_LANES
DEPTH_M = 1e4


def make_deep_scene(medium):
    """Return a scene with distant boundaries, features and tables."""
    scene = keep_all_grains(make_medium_scene(medium, depth=DEPTH_M, saturation=0.0))
    types = scene.types
    tables = (
        types.inverse_semi_major.astype(single),
        (1.0 - types.sphericity**2).astype(single),
        (0.5 * types.facetness).astype(single),
    )
    features = Features(*[None] * len(Features._fields))._replace(
        faceted=True, mixed=True if types.n_shells.size > 1 else None
    )
    return scene, features, tables


class HitGrains(NamedTuple):
    """Grains that rays have hit, as in `lanes.Lane`, and the distances to them (m)."""

    q: np.ndarray
    w: np.ndarray
    flattening: np.ndarray
    semi_minor: np.ndarray
    roughness: np.ndarray
    grain_type: np.ndarray
    distance: np.ndarray


@njit
def _start_lanes(lanes, layer_geometry):
    """Start the rays of all lanes in flight at half of the depth."""
    for i in range(N_LANES):
        lane = Lane(lanes, i)
        lane.position = Vector(single(0.0), single(0.0), single(-0.5 * DEPTH_M))
        lane.direction = Vector(single(0.48), single(-0.64), single(0.6))
        lane.previous_length, lane.next_roulette, lane.weight = -1.0, np.inf, 1.0
        lane.layer_geometry, lane.status = layer_geometry, lane_module.IN_FLIGHT


@njit
def _sample_flights(lanes, features, rules, tables, type_cdf, hit):
    """Fill `hit` with the grains that the rays of all lanes hit successively."""
    filled = 0
    while filled < hit.distance.size:
        passes.draw_grain_properties(lanes, N_LANES, features, tables, type_cdf)
        passes.run_flight_pass(lanes, N_LANES, features, rules)
        for i in range(N_LANES):
            lane = Lane(lanes, i)
            if lane.status == lane_module.AT_SURFACE:
                if filled < hit.distance.size:
                    q, w = lane.grain.q, lane.grain.w
                    hit.q[filled, 0], hit.q[filled, 1], hit.q[filled, 2] = q.x, q.y, q.z
                    hit.w[filled, 0], hit.w[filled, 1], hit.w[filled, 2] = w.x, w.y, w.z
                    hit.flattening[filled] = lane.grain.flattening
                    hit.semi_minor[filled] = lane.grain.semi_minor
                    hit.roughness[filled], hit.grain_type[filled] = lane.roughness, lane.grain_type
                    hit.distance[filled] = lane.previous_length
                    filled += 1
                lane.status = lane_module.IN_FLIGHT
                lane.position = Vector(single(0.0), single(0.0), single(-0.5 * DEPTH_M))


def sample_collisions(medium, count=N_SAMPLES):
    """Return the grains that rays hit in a medium."""
    scene, features, tables = make_deep_scene(medium)
    lanes = make_lanes()
    _start_lanes(lanes, to_single(get_layer_geometry(scene.layers, 0)))
    hit = HitGrains(*np.empty((2, count, 3)), *np.empty((5, count)))
    _sample_flights(lanes, features, scene.rules, tables, scene.layers.type_cdf, hit)
    return hit


RAY = np.array([0.48, -0.64, 0.6])


@pytest.mark.parametrize("entry", ["uniform", "projected"])
@pytest.mark.parametrize("psi", [0.3, 0.6, 0.95, 1.0])
def test_flight_pass_follows_the_entry_distributions(psi, entry):
    from spheroids import dot_product
    from test_hit_grains import (
        compute_area_below,
        compute_axial_cdf,
        compute_axis_cdf,
        compute_facing_cdf,
    )

    medium = splits.Snow(
        sphericity=(psi, psi, psi, 0.0),
        saturation=0.0,
        depth_m=1.0,
        interpretation={"entry_point": entry},
    )
    hit = sample_collisions(medium)
    q, w, flattening = hit.q, hit.w, hit.flattening
    assert np.abs(flattening - (1.0 - psi * psi)).max() < 1e-6
    assert np.abs((q * q).sum(axis=1) - 1.0).max() < 2e-6
    assert np.abs((w * w).sum(axis=1) - 1.0).max() < 1e-6
    z = dot_product(q, w)[:, 0]
    n = q - (flattening * z)[:, np.newaxis] * w
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    facing = np.clip(-n @ RAY, 0.0, 1.0)
    v = np.cross(n, RAY)
    axis_azimuth = (
        np.arctan2(dot_product(w, v)[:, 0], dot_product(w, np.cross(n, v))[:, 0])
        / (2 * np.pi)
        % 1.0
    )
    u = np.cross(RAY, [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    azimuth = np.arctan2(n @ np.cross(RAY, u), n @ u) / (2 * np.pi) % 1.0
    n_forward = int((w @ RAY > 0.0).sum())
    curvature = (1.0 - flattening) / hit.semi_minor
    scale = medium.mean_grain_distance_m
    judge_p(
        {
            "axial": compute_p_of_values(np.clip(z, -1, 1), compute_axial_cdf(psi, entry)),
            "axis": compute_p_of_values(
                np.clip(np.abs(w @ RAY), 0, 1), compute_axis_cdf(psi, entry)
            ),
            "axis side": compute_p_of_counts([n_forward, N_SAMPLES - n_forward], [0.5, 0.5]),
            "facing": compute_p_of_values(facing, lambda x: compute_facing_cdf(x, entry)),
            "joint": compute_p_of_unit_square(
                compute_area_below(np.clip(z, -1, 1), psi), compute_facing_cdf(facing, entry), 10
            ),
            "turn": compute_p_of_values(axis_azimuth, uniform_cdf),
            "azimuth": compute_p_of_values(azimuth, uniform_cdf),
            "distance": compute_p_of_values(hit.distance, stats.expon(scale=scale).cdf, BIN_EDGES),
            "size": compute_p_of_values(
                curvature,
                lambda x: np.clip((x - 1 / 3.75e-4) / (1 / 1.5e-4 - 1 / 3.75e-4), 0.0, 1.0),
            ),
        }
    )


def test_rejection_preserves_the_shape_distribution():
    """Rejection of an axial position keeps the shape, so that its distribution is unchanged."""
    from chi2 import tabulate_cdf

    limits = (0.3, 1.0, 0.5, 0.3)
    medium = splits.Snow(sphericity=limits, saturation=0.0, depth_m=1.0)
    hit = sample_collisions(medium)
    flattening = hit.flattening

    def density(x):
        bell = np.exp(-0.5 * ((x - limits[2]) / limits[3]) ** 2)
        return grain_statistics.surface_to_volume_ratio(x) * bell

    psi = np.sqrt(1.0 - flattening)
    curvature = (1.0 - flattening) / hit.semi_minor
    facetness = 2.0 * hit.roughness
    distribution = stats.truncnorm(-0.1 / 0.072, 0.1 / 0.072, loc=0.3, scale=0.072)
    p = {
        "shape": compute_p_of_values(psi, tabulate_cdf(density, *limits[:2])),
        "size": compute_p_of_values(
            curvature, lambda x: np.clip((x - 1 / 3.75e-4) / (1 / 1.5e-4 - 1 / 3.75e-4), 0, 1)
        ),
        "roughness": compute_p_of_values(
            facetness, lambda x: np.clip(distribution.cdf(x), 0, 1), BIN_EDGES
        ),
    }
    judge_p(p)
    pairs = (
        (psi, curvature),
        (psi, hit.distance),
        (curvature, facetness),
        (psi, facetness),
    )
    z = [stats.spearmanr(a, b).statistic * math.sqrt(N_SAMPLES - 1) for a, b in pairs]
    judge_z(z, "shape, size, distance, roughness")


def test_sand_types_are_hit_by_their_fractions():
    sand = splits.Sand(
        iron_oxide=0.04, hematite_ratio=0.4, magnetite=0.1, partition=(0.4, 0.35, 0.25)
    )
    fractions = np.diff([0.0, *sand.make_grain_population().type_cdf])
    hit = sample_collisions(sand)
    grain_type = hit.grain_type
    psi = np.sqrt(1.0 - hit.flattening)
    counts = np.histogram2d(
        grain_type,
        psi > np.median(psi),
        bins=[np.arange(fractions.size + 1) - 0.5, [-0.5, 0.5, 1.5]],
    )[0]
    p = {
        "types": compute_p_of_counts(
            np.bincount(grain_type.astype(int), minlength=fractions.size), fractions
        )
    }
    # All types have the same shape distribution: a rejection keeps type and shape together.
    p["types and shapes"] = stats.chi2_contingency(counts).pvalue
    judge_p(p)
