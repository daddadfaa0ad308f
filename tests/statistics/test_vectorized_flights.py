"""Grains sampled by the flight pass of the vectorized kernel against their distributions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from chi2 import (
    BIN_EDGES,
    NEEDS_JIT,
    compute_p_of_counts,
    compute_p_of_values,
    judge_p,
    judge_z,
    uniform_cdf,
)
from events import make_lanes
from numba import njit
from scenes import keep_all_grains, make_medium_scene
from scipy import stats

import splits
from splits.kernels.arithmetic import Vector, to_single
from splits.kernels.grains.grain_path import get_layer_geometry
from splits.kernels.scene import Features
from splits.kernels.vectorized import lanes as lane_module
from splits.kernels.vectorized import passes
from splits.kernels.vectorized.lanes import Lane
from splits.media import grain_statistics

pytestmark = NEEDS_JIT

N_SAMPLES = 400_000
single = np.float32


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
    counts = np.histogram2d(
        compute_area_below(np.clip(z, -1, 1), psi), compute_facing_cdf(facing, entry), bins=10,
        range=((0, 1), (0, 1)),
    )[0]  # fmt: skip
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
            "joint": compute_p_of_counts(counts, np.full(100, 0.01)),
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
