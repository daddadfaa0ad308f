"""Lanes and scalar kernel take the same functions: in single precision they do as in double.

Inputs are random numbers that single precision holds exactly, so that nothing but the arithmetic
differs.  Directions lose half of their digits next to the critical angle and at grazing incidence,
and a decision may fall the other way next to where it changes: so errors are judged by their
median, by what 99.9 % keep to and by the largest, and decisions by the share that differs.
"""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from numba import njit

from splits.transport.compiling.features import EVERYTHING, Features
from splits.transport.grains import facets, flight, spheroid, surface
from splits.transport.grains.flight import Fates, Flier, Space
from splits.transport.grains.spheroid import Aim, Entry, Segment, Size, Spheroid
from splits.transport.grains.surface import Numbers, Stand
from splits.transport.numerics.elementary import Angle
from splits.transport.numerics.vectors import Vector
from splits.transport.optics.faces import Index

pytestmark = NEEDS_JIT

COUNT = 200_000
MEDIAN, MOST, WORST = 1e-7, 2e-6, 1e-4
OTHERWISE = 2e-5
"""Share of decisions that may fall the other way."""
BARE = Features(*[None] * len(Features._fields))
FEATURES = {
    "smooth": BARE,
    "rough": BARE._replace(faceted=True),
    "rough, absorbing": BARE._replace(faceted=True, absorbing=True),
    "rough, mixed": BARE._replace(faceted=True, absorbing=True, mixed=True),
    "everything": EVERYTHING,
}
SCALE = 1e-4
"""Size of grains (m)."""


@pytest.fixture
def random():
    return np.random.default_rng(20_250_101)


def units(random, count=COUNT):
    """Return random directions."""
    v = random.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def circle(random, count=COUNT):
    angle = random.uniform(0.0, 2.0 * np.pi, count)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def sizes(random):
    """Return semi-major axis and flattening."""
    return np.column_stack([SCALE * random.uniform(0.5, 2.0, COUNT), random.uniform(0, 0.9, COUNT)])


def both(loop, columns, width, *args):
    """Return what a loop makes of the same numbers in single and in double precision."""
    single = np.ascontiguousarray(np.column_stack(columns), dtype=np.float32)
    results = []
    for x in (single, single.astype(np.float64)):
        out = np.full((len(x), width), np.nan, dtype=x.dtype)
        loop(x, *args, out)
        results.append(out.astype(float))
    return results


def judge(single, double, label, scale=1.0, worst=WORST):
    """Fail unless numbers agree to single precision."""
    assert np.isfinite(single).all() and np.isfinite(double).all()
    error = np.abs(single - double).max(axis=1) / scale
    found = np.median(error), np.quantile(error, 0.999), error.max()
    print(f"{label}: median {found[0]:.1e}, 99.9 % {found[1]:.1e}, worst {found[2]:.1e}")
    assert found[0] <= MEDIAN and found[1] <= MOST and found[2] <= worst, label


def judge_decisions(single, double, label):
    """Fail unless decisions agree; return where they all do."""
    assert np.isin(single, (0.0, 1.0)).all() and np.isin(double, (0.0, 1.0)).all()
    same = (single == double).all(axis=1)
    print(f"{label}: {np.count_nonzero(~same)} decisions of {same.size} fall the other way")
    assert np.mean(~same) <= OTHERWISE, label
    return same


# --- surfaces ---------------------------------------------------------------------------------


@njit
def _outcomes(x, lobe, through, features, rule, turn, out):
    for i in range(len(x)):
        row = x[i]
        d, n = Vector(row[0], row[1], row[2]), Vector(row[3], row[4], row[5])
        zero, one = row[6], row[7]
        facet = facets.facing(d, Spheroid(n, n, zero, one), one)
        numbers = Numbers(row[8], row[9], row[9], row[10], Angle(abs(row[11]), row[12]))
        if features.faceted is not None:
            facet = facets.rough(d, facet, row[13], numbers, lobe, rule)
        media = surface.contrast(Index(row[14], row[15]), Index(row[16], row[17]))
        stand = Stand(zero, one, lobe, through)
        after = surface.outcome(d, stand, facet, media, row[9], turn, features)
        goes = surface.goings(stand, after, one, features.mixed)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = after.direction.x, after.direction.y, after.direction.z, after.cos_out
        out[i, 4], out[i, 5], out[i, 6] = facet.cos_facet, goes.interface.shell, goes.interface.side
        out[i, 7], out[i, 8], out[i, 9] = after.transmitted, after.accepted, after.needs_lobe
        out[i, 10], out[i, 11], out[i, 12] = goes.in_pore, goes.in_coating, goes.in_core


def surfaces(random, indices, extinction):
    """Return random rays at random surfaces."""
    d, n = units(random), units(random)
    d[(d * n).sum(axis=1) > 0.0] *= -1.0
    ones = np.ones(COUNT)
    near, far = (random.choice(indices, COUNT) for _ in range(2))
    k = extinction * random.uniform(size=COUNT)
    return [
        d, n, 0.0 * ones, ones, random.uniform(0.001, 0.999, (COUNT, 2)),
        np.abs(random.normal(size=COUNT)), circle(random), random.uniform(0.05, 0.5, COUNT),
        near, 0.0 * ones, far, k * (near != far),
    ]  # fmt: skip


@pytest.mark.parametrize("lobe", [False, True])
@pytest.mark.parametrize("name", FEATURES)
def test_trials_at_a_surface(random, name, lobe):
    features = FEATURES[name]
    if lobe and features.faceted is None:
        pytest.skip("smooth surfaces have no lobes")
    shows = features.absorbing is not None
    # Media that are one and the same are for scenes that are mixed.
    indices = [1.0, 1.33, 1.31, 2.5]
    columns = surfaces(random, indices, 0.5 if shows else 0.0)
    if features.mixed is None:
        columns[8] = np.where(columns[8] == columns[10], 1.55, columns[8])
    for rule in (facets.PROJECTED, facets.UNWEIGHTED, facets.ANY):
        for turn in (False, True):
            for through in (False, True) if lobe else (False,):
                label = f"{name}, lobe {lobe}, through {through}, rule {rule}, turn {turn}"
                one, other = both(_outcomes, columns, 13, lobe, through, features, rule, turn)
                same = judge_decisions(one[:, 7:], other[:, 7:], label)
                judge(one[same, :4], other[same, :4], label)
                assert (one[same, 5:7] == other[same, 5:7]).all()
                assert np.abs((one[:, :3] ** 2).sum(axis=1) - 1.0).max() < 1e-6
                assert np.abs((other[:, :3] ** 2).sum(axis=1) - 1.0).max() < 1e-13


@pytest.mark.parametrize("name", list(FEATURES)[1:])
def test_features_leave_out_only_what_is_not_there(random, name):
    """Where nothing absorbs and readings are the default, more features change nothing."""
    columns = surfaces(random, [1.0, 1.33, 1.31, 2.5], 0.0)
    columns[8] = np.where(columns[8] == columns[10], 1.55, columns[8])
    plain, more = (
        both(_outcomes, columns, 13, False, False, features, facets.PROJECTED, False)
        for features in (FEATURES["rough"], FEATURES[name])
    )
    for one, other, allowed in zip(plain, more, (1e-4, 1e-10), strict=True):
        same = (one[:, 7:10] == other[:, 7:10]).all(axis=1)
        assert np.mean(~same) <= OTHERWISE
        # What comes of a facet that is refused does not matter.
        same &= one[:, 8] == 1.0
        assert np.abs(one[same, :5] - other[same, :5]).max() < allowed


# --- spheroids --------------------------------------------------------------------------------


@njit
def _grain(row):
    return Spheroid(Vector(row[0], row[1], row[2]), Vector(row[3], row[4], row[5]), row[7], row[6])


@njit
def _ways(x, out):
    for i in range(len(x)):
        row = x[i]
        grain, d = _grain(row), Vector(row[8], row[9], row[10])
        n = spheroid.normal_at(grain)
        s = spheroid.squeezed(d, grain.w, grain.flattening)
        chord = spheroid.across(grain, d)
        q = chord.grain.q
        out[i, 0], out[i, 1], out[i, 2] = n.x, n.y, n.z
        out[i, 3], out[i, 4], out[i, 5] = s.x, s.y, s.z
        out[i, 6], out[i, 7], out[i, 8] = q.x, q.y, q.z
        out[i, 9] = spheroid.slope_squared(row[11], grain.flattening)
        out[i, 10] = chord.length


def test_normals_and_ways_through_grains(random):
    columns = [units(random), units(random), sizes(random), units(random)]
    columns.append(random.uniform(-1.0, 1.0, COUNT))
    one, other = both(_ways, columns, 11)
    judge(one[:, :3], other[:, :3], "normal")
    judge(one[:, 3:6], other[:, 3:6], "squeezed")
    judge(one[:, 6:9], other[:, 6:9], "other end")
    judge(one[:, 9:10], other[:, 9:10], "slope")
    judge(one[:, 10:], other[:, 10:], "chord", columns[2][:, 0] / (1.0 - columns[2][:, 1]))


@njit
def _strikes(x, entry, out):
    for i in range(len(x)):
        row = x[i]
        d, size = Vector(row[0], row[1], row[2]), Size(row[3], row[4])
        aim = Aim(row[5], Angle(row[6], row[7]), Angle(row[8], row[9]), row[10], row[11])
        hit = spheroid.strike(d, size, aim, entry)
        q, w, n = hit.grain.q, hit.grain.w, hit.normal
        out[i, 0], out[i, 1], out[i, 2] = q.x, q.y, q.z
        out[i, 3], out[i, 4], out[i, 5] = w.x, w.y, w.z
        out[i, 6], out[i, 7], out[i, 8] = n.x, n.y, n.z
        out[i, 9], out[i, 10] = hit.axial_position, hit.grain.semi_minor
        out[i, 11] = spheroid.placed(aim, size.flattening)


def aims(random):
    """Return random numbers that say how a ray strikes a grain."""
    return [
        random.uniform(size=COUNT), circle(random), circle(random), random.uniform(size=(COUNT, 2))
    ]  # fmt: skip


@pytest.mark.parametrize("entry", [spheroid.UNIFORM, spheroid.PROJECTED])
def test_points_at_which_grains_are_struck(random, entry):
    columns = [units(random), sizes(random), *aims(random)]
    one, other = both(_strikes, columns, 12, entry)
    judge_decisions(one[:, 11:], other[:, 11:], "placed")
    judge(one[:, :9], other[:, :9], "struck")
    judge(one[:, 9:10], other[:, 9:10], "axial")
    judge(one[:, 10:11], other[:, 10:11], "semi-minor axis", SCALE)


@njit
def _overlaps(x, out):
    for i in range(len(x)):
        row = x[i]
        grain = _grain(row)
        entry = Entry(grain, grain.q, row[8], row[6] / (row[9] - row[7]))
        out[i, 0] = spheroid.crosses(entry, row[10], row[11], row[12])
        segment = Segment(
            Vector(row[13], row[14], row[15]), Vector(row[16], row[17], row[18]), row[19]
        )
        out[i, 1] = spheroid.cuts(grain, segment)


def test_overlaps_with_boundaries_and_legs(random):
    ones = np.ones(COUNT)
    q, w = units(random), units(random)
    columns = [
        q, w, sizes(random), (q * w).sum(axis=1), ones, -SCALE * random.uniform(0.0, 20.0, COUNT),
        -20.0 * SCALE * ones, 0.0 * ones, 3.0 * SCALE * random.normal(size=(COUNT, 3)),
        units(random), SCALE * random.exponential(5.0, COUNT),
    ]  # fmt: skip
    one, other = both(_overlaps, columns, 2)
    assert other.mean(axis=0).min() > 0.05 and other.mean(axis=0).max() < 0.9
    for column, label in enumerate(("crosses", "cuts")):
        judge_decisions(one[:, [column]], other[:, [column]], label)


# --- flights ----------------------------------------------------------------------------------


@njit
def _next(x, fates, out):
    for i in range(len(x)):
        row = x[i]
        d, size = Vector(row[0], row[1], row[2]), Size(row[3], row[4])
        aim = Aim(row[5], Angle(row[6], row[7]), Angle(row[8], row[9]), row[10], row[11])
        zero = row[12]
        place, way = Vector(zero, zero, row[13]), Vector(row[14], row[15], row[16])
        last = Segment(way, Vector(row[17], row[18], row[19]), row[20])
        ray = Flier(place, way, d, last, row[21])
        space = Space(row[22], row[23], row[25], row[26], zero, zero)
        met = flight.next_grain(ray, size, aim, row[24], space, fates)
        there = flight.to_boundary(ray, space)
        n = met.entry.normal
        out[i, 0], out[i, 1], out[i, 2] = met.distance, met.height, there.distance
        out[i, 3], out[i, 4], out[i, 5] = there.position.x, there.position.y, there.position.z
        out[i, 6], out[i, 7], out[i, 8] = n.x, n.y, n.z
        out[i, 9], out[i, 10], out[i, 11] = met.leaves_layer, met.accepted, met.start_distance > zero


DEPTH = 30.0 * SCALE
FATES = {
    "redrawn": Fates(spheroid.UNIFORM, True, True, False, False),
    "kept": Fates(spheroid.PROJECTED, False, False, False, False),
    "skipped": Fates(spheroid.UNIFORM, True, True, True, True),
}


@pytest.mark.parametrize("name", FATES)
def test_next_grains(random, name):
    ones = np.ones(COUNT)
    d = units(random)
    skipped = SCALE * random.uniform(0.0, 3.0, COUNT) * random.integers(0, 2, COUNT)
    columns = [
        d, sizes(random), *aims(random), 0.0 * ones, -DEPTH * random.uniform(0.15, 0.85, COUNT),
        0.5 * SCALE * random.normal(size=(COUNT, 3)), units(random),
        np.where(random.uniform(size=COUNT) < 0.1, -1.0, SCALE * random.exponential(5.0, COUNT)),
        skipped, 5.0 * SCALE * ones, -0.9 * DEPTH * ones, random.uniform(1e-6, 1.0, COUNT),
        -0.1 * DEPTH * ones, -DEPTH * ones,
    ]  # fmt: skip
    one, other = both(_next, columns, 12, FATES[name])
    same = judge_decisions(one[:, 9:], other[:, 9:], name)
    judge(one[:, :2], other[:, :2], "leg and height", DEPTH)
    # Ways to a boundary are as long as rays are level.
    along = DEPTH / np.abs(d[:, 2])
    judge(one[:, 2:6], other[:, 2:6], "to the boundary", along)
    judge(one[:, 6:9], other[:, 6:9], "normal")
    assert 0.02 < other[same, 10].mean() < 0.98


@njit
def _roulettes(x, out):
    for i in range(len(x)):
        row = x[i]
        played = flight.roulette(flight.Purse(row[0], row[1], row[2]), row[3], row[4] > row[5])
        out[i, 0], out[i, 1] = played.roulette.next_roulette, played.roulette.weight
        out[i, 2] = played.terminated


def test_roulette(random):
    columns = [
        random.exponential(3.0, COUNT), random.uniform(2.0, 6.0, COUNT),
        random.uniform(1.0, 30.0, COUNT), random.uniform(size=(COUNT, 3)),
    ]  # fmt: skip
    one, other = both(_roulettes, columns, 3)
    judge_decisions(one[:, 2:], other[:, 2:], "ended")
    judge(one[:, :2], other[:, :2], "limit and weight", 30.0)
