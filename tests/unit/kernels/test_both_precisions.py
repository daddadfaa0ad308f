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

from splits.kernels.compiler.features import ALL_FEATURES, Features
from splits.kernels.grains import free_path, interaction, microfacet, spheroid
from splits.kernels.grains.free_path import LayerGeometry, RayGeometry, RejectionRules
from splits.kernels.grains.interaction import InteractionVariates, InterfaceState
from splits.kernels.grains.spheroid import EntryPoint, EntryVariates, GrainSize, Segment, Spheroid
from splits.kernels.math.elementary import Angle
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.interface import ComplexIndex

pytestmark = NEEDS_JIT

N_SAMPLES = 200_000
MEDIAN_ERROR, TAIL_ERROR, MAX_ERROR = 1e-7, 2e-6, 1e-4
MAX_DIFFERENT_DECISIONS = 2e-5
"""Share of decisions that may fall the other way."""
NO_FEATURES = Features(*[None] * len(Features._fields))
FEATURES = {
    "smooth": NO_FEATURES,
    "rough": NO_FEATURES._replace(faceted=True),
    "rough, absorbing": NO_FEATURES._replace(faceted=True, absorbing=True),
    "rough, mixed": NO_FEATURES._replace(faceted=True, absorbing=True, mixed=True),
    "everything": ALL_FEATURES,
}
RELATIVE_SCALE = 1e-4
"""Size of grains (m)."""


@pytest.fixture
def random():
    return np.random.default_rng(20_250_101)


def draw_directions(random, count=N_SAMPLES):
    """Return random directions."""
    v = random.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def draw_circle(random, count=N_SAMPLES):
    angle = random.uniform(0.0, 2.0 * np.pi, count)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def draw_sizes(random):
    """Return semi-major axis and flattening."""
    return np.column_stack(
        [RELATIVE_SCALE * random.uniform(0.5, 2.0, N_SAMPLES), random.uniform(0, 0.9, N_SAMPLES)]
    )


def run_both_precisions(loop, columns, width, *args):
    """Return what a loop makes of the same numbers in single and in double precision."""
    single = np.ascontiguousarray(np.column_stack(columns), dtype=np.float32)
    results = []
    for x in (single, single.astype(np.float64)):
        out = np.full((len(x), width), np.nan, dtype=x.dtype)
        loop(x, *args, out)
        results.append(out.astype(float))
    return results


def check_agreement(single, double, label, scale=1.0, worst=MAX_ERROR):
    """Fail unless numbers agree to single precision."""
    assert np.isfinite(single).all() and np.isfinite(double).all()
    error = np.abs(single - double).max(axis=1) / scale
    found = np.median(error), np.quantile(error, 0.999), error.max()
    print(f"{label}: median {found[0]:.1e}, 99.9 % {found[1]:.1e}, worst {found[2]:.1e}")
    assert found[0] <= MEDIAN_ERROR and found[1] <= TAIL_ERROR and found[2] <= worst, label


def check_decisions(single, double, label):
    """Fail unless decisions agree; return where they all do."""
    assert np.isin(single, (0.0, 1.0)).all() and np.isin(double, (0.0, 1.0)).all()
    same = (single == double).all(axis=1)
    print(f"{label}: {np.count_nonzero(~same)} decisions of {same.size} fall the other way")
    assert np.mean(~same) <= MAX_DIFFERENT_DECISIONS, label
    return same


# --- surfaces ---------------------------------------------------------------------------------


@njit
def _compute_outcomes(x, lobe, through, features, rule, turn, out):
    for i in range(len(x)):
        row = x[i]
        d, n = Vector(row[0], row[1], row[2]), Vector(row[3], row[4], row[5])
        zero, one = row[6], row[7]
        facet = microfacet.make_smooth_facet(d, Spheroid(n, n, zero, one), one)
        numbers = InteractionVariates(row[8], row[9], row[9], row[10], Angle(abs(row[11]), row[12]))
        if features.faceted is not None:
            facet = microfacet.sample_microfacet(d, facet, row[13], numbers, lobe, rule)
        media = interaction.relative_index(
            ComplexIndex(row[14], row[15]), ComplexIndex(row[16], row[17])
        )
        stand = InterfaceState(zero, one, lobe, through)
        after = interaction.reflect_or_refract(d, stand, facet, media, row[9], turn, features)
        goes = interaction.find_next_region(stand, after, one, features.mixed)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = (
            after.direction.x,
            after.direction.y,
            after.direction.z,
            after.cos_out,
        )
        out[i, 4], out[i, 5], out[i, 6] = facet.cos_facet, goes.interface.shell, goes.interface.side
        out[i, 7], out[i, 8], out[i, 9] = after.transmitted, after.accepted, after.needs_lobe
        out[i, 10], out[i, 11], out[i, 12] = goes.in_pore, goes.in_coating, goes.in_core


def draw_surfaces(random, indices, extinction):
    """Return random rays at random surfaces."""
    d, n = draw_directions(random), draw_directions(random)
    d[(d * n).sum(axis=1) > 0.0] *= -1.0
    ones = np.ones(N_SAMPLES)
    near, far = (random.choice(indices, N_SAMPLES) for _ in range(2))
    k = extinction * random.uniform(size=N_SAMPLES)
    return [
        d, n, 0.0 * ones, ones, random.uniform(0.001, 0.999, (N_SAMPLES, 2)),
        np.abs(random.normal(size=N_SAMPLES)), draw_circle(random),
        random.uniform(0.05, 0.5, N_SAMPLES),
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
    columns = draw_surfaces(random, indices, 0.5 if shows else 0.0)
    if features.mixed is None:
        columns[8] = np.where(columns[8] == columns[10], 1.55, columns[8])
    for rule in (microfacet.PROJECTED_FACETS, microfacet.UNWEIGHTED_FACETS, microfacet.ANY_FACETS):
        for turn in (False, True):
            for through in (False, True) if lobe else (False,):
                label = f"{name}, lobe {lobe}, through {through}, rule {rule}, turn {turn}"
                one, other = run_both_precisions(
                    _compute_outcomes, columns, 13, lobe, through, features, rule, turn
                )
                same = check_decisions(one[:, 7:], other[:, 7:], label)
                check_agreement(one[same, :4], other[same, :4], label)
                assert (one[same, 5:7] == other[same, 5:7]).all()
                assert np.abs((one[:, :3] ** 2).sum(axis=1) - 1.0).max() < 1e-6
                assert np.abs((other[:, :3] ** 2).sum(axis=1) - 1.0).max() < 1e-13


@pytest.mark.parametrize("name", list(FEATURES)[1:])
def test_features_leave_out_only_what_is_not_there(random, name):
    """Where nothing absorbs and readings are the default, more features change nothing."""
    columns = draw_surfaces(random, [1.0, 1.33, 1.31, 2.5], 0.0)
    columns[8] = np.where(columns[8] == columns[10], 1.55, columns[8])
    plain, more = (
        run_both_precisions(
            _compute_outcomes,
            columns,
            13,
            False,
            False,
            features,
            microfacet.PROJECTED_FACETS,
            False,
        )
        for features in (FEATURES["rough"], FEATURES[name])
    )
    for one, other, allowed in zip(plain, more, (1e-4, 1e-10), strict=True):
        same = (one[:, 7:10] == other[:, 7:10]).all(axis=1)
        assert np.mean(~same) <= MAX_DIFFERENT_DECISIONS
        # What comes of a facet that is refused does not matter.
        same &= one[:, 8] == 1.0
        assert np.abs(one[same, :5] - other[same, :5]).max() < allowed


# --- spheroids --------------------------------------------------------------------------------


@njit
def _make_grain(row):
    return Spheroid(Vector(row[0], row[1], row[2]), Vector(row[3], row[4], row[5]), row[7], row[6])


@njit
def _compute_chords(x, out):
    for i in range(len(x)):
        row = x[i]
        grain, d = _make_grain(row), Vector(row[8], row[9], row[10])
        n = spheroid.compute_outward_normal(grain)
        s = spheroid.scale_along_axis(d, grain.w, grain.flattening)
        chord = spheroid.compute_chord(grain, d)
        q = chord.grain.q
        out[i, 0], out[i, 1], out[i, 2] = n.x, n.y, n.z
        out[i, 3], out[i, 4], out[i, 5] = s.x, s.y, s.z
        out[i, 6], out[i, 7], out[i, 8] = q.x, q.y, q.z
        out[i, 9] = spheroid.normal_length_squared(row[11], grain.flattening)
        out[i, 10] = chord.length


def test_normals_and_ways_through_grains(random):
    columns = [
        draw_directions(random),
        draw_directions(random),
        draw_sizes(random),
        draw_directions(random),
    ]
    columns.append(random.uniform(-1.0, 1.0, N_SAMPLES))
    one, other = run_both_precisions(_compute_chords, columns, 11)
    check_agreement(one[:, :3], other[:, :3], "normal")
    check_agreement(one[:, 3:6], other[:, 3:6], "squeezed")
    check_agreement(one[:, 6:9], other[:, 6:9], "other end")
    check_agreement(one[:, 9:10], other[:, 9:10], "slope")
    check_agreement(
        one[:, 10:], other[:, 10:], "chord", columns[2][:, 0] / (1.0 - columns[2][:, 1])
    )


@njit
def _compute_entries(x, entry, out):
    for i in range(len(x)):
        row = x[i]
        d, size = Vector(row[0], row[1], row[2]), GrainSize(row[3], row[4])
        aim = EntryVariates(row[5], Angle(row[6], row[7]), Angle(row[8], row[9]), row[10], row[11])
        hit = spheroid.sample_entry_point(d, size, aim, entry)
        q, w, n = hit.grain.q, hit.grain.w, hit.normal
        out[i, 0], out[i, 1], out[i, 2] = q.x, q.y, q.z
        out[i, 3], out[i, 4], out[i, 5] = w.x, w.y, w.z
        out[i, 6], out[i, 7], out[i, 8] = n.x, n.y, n.z
        out[i, 9], out[i, 10] = hit.axial_position, hit.grain.semi_minor
        out[i, 11] = spheroid.accept_axial_position(aim, size.flattening)


def draw_entry_variates(random):
    """Return random numbers that say how a ray strikes a grain."""
    return [
        random.uniform(size=N_SAMPLES), draw_circle(random), draw_circle(random),
        random.uniform(size=(N_SAMPLES, 2))
    ]  # fmt: skip


@pytest.mark.parametrize("entry", [spheroid.UNIFORM_ENTRY, spheroid.PROJECTED_ENTRY])
def test_points_at_which_grains_are_struck(random, entry):
    columns = [draw_directions(random), draw_sizes(random), *draw_entry_variates(random)]
    one, other = run_both_precisions(_compute_entries, columns, 12, entry)
    check_decisions(one[:, 11:], other[:, 11:], "placed")
    check_agreement(one[:, :9], other[:, :9], "struck")
    check_agreement(one[:, 9:10], other[:, 9:10], "axial")
    check_agreement(one[:, 10:11], other[:, 10:11], "semi-minor axis", RELATIVE_SCALE)


@njit
def _check_overlaps(x, out):
    for i in range(len(x)):
        row = x[i]
        grain = _make_grain(row)
        entry = EntryPoint(grain, grain.q, row[8], row[6] / (row[9] - row[7]))
        out[i, 0] = spheroid.overlaps_boundary(entry, row[10], row[11], row[12])
        segment = Segment(
            Vector(row[13], row[14], row[15]), Vector(row[16], row[17], row[18]), row[19]
        )
        out[i, 1] = spheroid.overlaps_segment(grain, segment)


def test_overlaps_with_boundaries_and_legs(random):
    ones = np.ones(N_SAMPLES)
    q, w = draw_directions(random), draw_directions(random)
    columns = [
        q, w, draw_sizes(random), (q * w).sum(axis=1), ones,
        -RELATIVE_SCALE * random.uniform(0.0, 20.0, N_SAMPLES),
        -20.0 * RELATIVE_SCALE * ones, 0.0 * ones,
        3.0 * RELATIVE_SCALE * random.normal(size=(N_SAMPLES, 3)),
        draw_directions(random), RELATIVE_SCALE * random.exponential(5.0, N_SAMPLES),
    ]  # fmt: skip
    one, other = run_both_precisions(_check_overlaps, columns, 2)
    assert other.mean(axis=0).min() > 0.05 and other.mean(axis=0).max() < 0.9
    for column, label in enumerate(("crosses", "cuts")):
        check_decisions(one[:, [column]], other[:, [column]], label)


# --- flights ----------------------------------------------------------------------------------


@njit
def _find_next_grains(x, fates, out):
    for i in range(len(x)):
        row = x[i]
        d, size = Vector(row[0], row[1], row[2]), GrainSize(row[3], row[4])
        aim = EntryVariates(row[5], Angle(row[6], row[7]), Angle(row[8], row[9]), row[10], row[11])
        zero = row[12]
        place, way = Vector(zero, zero, row[13]), Vector(row[14], row[15], row[16])
        last = Segment(way, Vector(row[17], row[18], row[19]), row[20])
        ray = RayGeometry(place, way, d, last, row[21])
        space = LayerGeometry(row[22], row[23], row[25], row[26], zero, zero)
        met = free_path.sample_collision(ray, size, aim, row[24], space, fates)
        there = free_path.compute_boundary_hit(ray, space)
        n = met.entry.normal
        out[i, 0], out[i, 1], out[i, 2] = met.distance, met.height, there.distance
        out[i, 3], out[i, 4], out[i, 5] = there.position.x, there.position.y, there.position.z
        out[i, 6], out[i, 7], out[i, 8] = n.x, n.y, n.z
        out[i, 9], out[i, 10], out[i, 11] = (
            met.leaves_layer,
            met.accepted,
            met.start_distance > zero,
        )


DEPTH = 30.0 * RELATIVE_SCALE
OVERLAP_RULES = {
    "redrawn": RejectionRules(spheroid.UNIFORM_ENTRY, True, True, False, False),
    "kept": RejectionRules(spheroid.PROJECTED_ENTRY, False, False, False, False),
    "skipped": RejectionRules(spheroid.UNIFORM_ENTRY, True, True, True, True),
}


@pytest.mark.parametrize("name", OVERLAP_RULES)
def test_next_grains(random, name):
    ones = np.ones(N_SAMPLES)
    d = draw_directions(random)
    skipped = (
        RELATIVE_SCALE * random.uniform(0.0, 3.0, N_SAMPLES) * random.integers(0, 2, N_SAMPLES)
    )
    columns = [
        d, draw_sizes(random), *draw_entry_variates(random), 0.0 * ones,
        -DEPTH * random.uniform(0.15, 0.85, N_SAMPLES),
        0.5 * RELATIVE_SCALE * random.normal(size=(N_SAMPLES, 3)), draw_directions(random),
        np.where(random.uniform(size=N_SAMPLES) < 0.1, -1.0,
                 RELATIVE_SCALE * random.exponential(5.0, N_SAMPLES)),
        skipped, 5.0 * RELATIVE_SCALE * ones, -0.9 * DEPTH * ones,
        random.uniform(1e-6, 1.0, N_SAMPLES),
        -0.1 * DEPTH * ones, -DEPTH * ones,
    ]  # fmt: skip
    one, other = run_both_precisions(_find_next_grains, columns, 12, OVERLAP_RULES[name])
    same = check_decisions(one[:, 9:], other[:, 9:], name)
    check_agreement(one[:, :2], other[:, :2], "leg and height", DEPTH)
    # Ways to a boundary are as long as rays are level.
    along = DEPTH / np.abs(d[:, 2])
    check_agreement(one[:, 2:6], other[:, 2:6], "to the boundary", along)
    check_agreement(one[:, 6:9], other[:, 6:9], "normal")
    assert 0.02 < other[same, 10].mean() < 0.98


@njit
def _play_roulettes(x, out):
    for i in range(len(x)):
        row = x[i]
        played = free_path.russian_roulette(
            free_path.RouletteState(row[0], row[1], row[2]), row[3], row[4] > row[5]
        )
        out[i, 0], out[i, 1] = played.roulette.next_roulette, played.roulette.weight
        out[i, 2] = played.terminated


def test_roulette(random):
    columns = [
        random.exponential(3.0, N_SAMPLES), random.uniform(2.0, 6.0, N_SAMPLES),
        random.uniform(1.0, 30.0, N_SAMPLES), random.uniform(size=(N_SAMPLES, 3)),
    ]  # fmt: skip
    one, other = run_both_precisions(_play_roulettes, columns, 3)
    check_decisions(one[:, 2:], other[:, 2:], "ended")
    check_agreement(one[:, :2], other[:, :2], "limit and weight", 30.0)
