"""The grains that the pass `flight` gives to lanes, against the laws they must follow."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import EDGES, NEEDS_JIT, evenly, judge_p, judge_z, p_of_counts, p_of_values
from events import lane_words
from numba import njit
from scenes import boundless, medium_scene, passing
from scipy import stats

import splits
from splits.media import grain_statistics
from splits.transport.compiling.features import Features
from splits.transport.lanes import draws, flight, rows

pytestmark = NEEDS_JIT

COUNT = 400_000
single = np.float32


LANES = rows.LANES
COLUMNS = rows.KIND // LANES + 1
DEPTH = 1e4


def deep_scene(medium):
    """Return a scene without boundaries within reach, tables and shares, as `batch` makes them."""
    scene = boundless(medium_scene(medium, depth=DEPTH, saturation=0.0))
    types = scene.types
    tables = (
        types.curvature.astype(single),
        (1.0 - types.sphericity**2).astype(single),
        (0.5 * types.facetness).astype(single),
    )
    features = Features(*[None] * len(Features._fields))._replace(
        faceted=True, mixed=True if types.n_shells.size > 1 else None
    )
    return passing(scene), features, tables, scene.layers.type_cdf


@njit
def _fly(state, words, features, scene, tables, share, out):
    """Fill `out` with the grains that lanes get, one after the other in every lane."""
    filled = 0
    while filled < out.shape[0]:
        draws.draw_types(state, words, LANES, features, tables, share)
        flight.flight(state, words, LANES, features, scene)
        for lane in range(LANES):
            if state[rows.STATUS + lane] == rows.TRIAL:
                if filled < out.shape[0]:
                    for j in range(COLUMNS):
                        out[filled, j] = state[j * LANES + lane]
                    filled += 1
                state[rows.STATUS + lane] = rows.FLYING
                for row in (rows.X, rows.Y):
                    state[row + lane] = single(0.0)
                state[rows.Z + lane] = single(-0.5 * DEPTH)


def met(medium, count=COUNT):
    """Return the rows of the state of lanes that have just met a grain, by row."""
    scene, features, tables, share = deep_scene(medium)
    state = np.zeros(rows.STATE, dtype=single)
    words = lane_words()
    for lane in range(LANES):
        for row, value in (
            (rows.Z, -0.5 * DEPTH), (rows.DX, 0.48), (rows.DY, -0.64), (rows.DZ, 0.6),
            (rows.LAST, -1.0), (rows.LIMIT, np.inf), (rows.WEIGHT, 1.0),
            (rows.STATUS, rows.FLYING),
        ):  # fmt: skip
            state[row + lane] = value
    out = np.empty((count, COLUMNS), dtype=single)
    _fly(state, words, features, scene, tables, share, out)
    return lambda *which: out[:, [row // LANES for row in which]].astype(float).squeeze()


RAY = np.array([0.48, -0.64, 0.6])


@pytest.mark.parametrize("entry", ["uniform", "projected"])
@pytest.mark.parametrize("psi", [0.3, 0.6, 0.95, 1.0])
def test_flight_strikes_grains_as_the_laws_say(psi, entry):
    from spheroids import dot
    from test_struck_grains import area_below, axial_cdf, axis_cdf, facing_cdf

    medium = splits.Snow(
        sphericity=(psi, psi, psi, 0.0), saturation=0.0, depth_m=1.0, readings={"entry": entry}
    )
    rows_of = met(medium)
    q = rows_of(rows.QX, rows.QY, rows.QZ)
    w = rows_of(rows.WX, rows.WY, rows.WZ)
    flattening = rows_of(rows.FLATTENING)
    assert np.abs(flattening - (1.0 - psi * psi)).max() < 1e-6
    assert np.abs((q * q).sum(axis=1) - 1.0).max() < 2e-6
    assert np.abs((w * w).sum(axis=1) - 1.0).max() < 1e-6
    z = dot(q, w)[:, 0]
    n = q - (flattening * z)[:, np.newaxis] * w
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    facing = np.clip(-n @ RAY, 0.0, 1.0)
    v = np.cross(n, RAY)
    turn = np.arctan2(dot(w, v)[:, 0], dot(w, np.cross(n, v))[:, 0]) / (2 * np.pi) % 1.0
    u = np.cross(RAY, [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    azimuth = np.arctan2(n @ np.cross(RAY, u), n @ u) / (2 * np.pi) % 1.0
    cells = np.histogram2d(
        area_below(np.clip(z, -1, 1), psi), facing_cdf(facing, entry), bins=10,
        range=((0, 1), (0, 1)),
    )[0]  # fmt: skip
    side = int((w @ RAY > 0.0).sum())
    curvature = (1.0 - flattening) / rows_of(rows.MINOR)
    scale = medium.mean_grain_distance_m
    judge_p(
        {
            "axial": p_of_values(np.clip(z, -1, 1), axial_cdf(psi, entry)),
            "axis": p_of_values(np.clip(np.abs(w @ RAY), 0, 1), axis_cdf(psi, entry)),
            "axis side": p_of_counts([side, COUNT - side], [0.5, 0.5]),
            "facing": p_of_values(facing, lambda x: facing_cdf(x, entry)),
            "joint": p_of_counts(cells, np.full(100, 0.01)),
            "turn": p_of_values(turn, evenly),
            "azimuth": p_of_values(azimuth, evenly),
            "distance": p_of_values(rows_of(rows.LAST), stats.expon(scale=scale).cdf, EDGES),
            "size": p_of_values(
                curvature,
                lambda x: np.clip((x - 1 / 3.75e-4) / (1 / 1.5e-4 - 1 / 3.75e-4), 0.0, 1.0),
            ),
        }
    )


def test_shapes_that_are_drawn_again_keep_their_law():
    """A shape is kept until an axial position fits: as often as it is struck, not more often."""
    from chi2 import tabulated_cdf

    limits = (0.3, 1.0, 0.5, 0.3)
    medium = splits.Snow(sphericity=limits, saturation=0.0, depth_m=1.0)
    rows_of = met(medium)
    flattening = rows_of(rows.FLATTENING)

    def density(x):
        bell = np.exp(-0.5 * ((x - limits[2]) / limits[3]) ** 2)
        return grain_statistics.surface_to_volume(x) * bell

    psi = np.sqrt(1.0 - flattening)
    curvature = (1.0 - flattening) / rows_of(rows.MINOR)
    facetness = 2.0 * rows_of(rows.SIGMA)
    law = stats.truncnorm(-0.1 / 0.072, 0.1 / 0.072, loc=0.3, scale=0.072)
    p = {
        "shape": p_of_values(psi, tabulated_cdf(density, *limits[:2])),
        "size": p_of_values(
            curvature, lambda x: np.clip((x - 1 / 3.75e-4) / (1 / 1.5e-4 - 1 / 3.75e-4), 0, 1)
        ),
        "roughness": p_of_values(facetness, lambda x: np.clip(law.cdf(x), 0, 1), EDGES),
    }
    judge_p(p)
    pairs = ((psi, curvature), (psi, rows_of(rows.LAST)), (curvature, facetness), (psi, facetness))
    z = [stats.spearmanr(a, b).statistic * math.sqrt(COUNT - 1) for a, b in pairs]
    judge_z(z, "shape, size, distance, roughness")


def test_types_of_sand_are_met_by_their_shares():
    sand = splits.Sand(
        iron_oxide=0.04, hematite_ratio=0.4, magnetite=0.1, partition=(0.4, 0.35, 0.25)
    )
    shares = np.diff([0.0, *sand.make_grain_population().type_cdf])
    rows_of = met(sand)
    kind = rows_of(rows.KIND)
    psi = np.sqrt(1.0 - rows_of(rows.FLATTENING))
    halves = np.histogram2d(
        kind, psi > np.median(psi), bins=[np.arange(shares.size + 1) - 0.5, [-0.5, 0.5, 1.5]]
    )[0]
    p = {"types": p_of_counts(np.bincount(kind.astype(int), minlength=shares.size), shares)}
    # All types have one shape: it is kept together with the type.
    p["types and shapes"] = stats.chi2_contingency(halves).pvalue
    judge_p(p)
