"""Functions that the vectorized and the scalar kernel share agree in single and double precision.

Inputs are random numbers that single precision represents exactly, so that only the arithmetic
differs.  Directions lose half of their digits next to the critical angle and at grazing incidence,
and a decision may differ next to its threshold.  Errors are therefore judged by their median,
their 99.9 % quantile and their maximum, and decisions by the fraction that differs.
"""

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from numba import njit

from splits.kernels.arithmetic import Angle
from splits.kernels.grains import spheroid, surface
from splits.kernels.grains.spheroid import (
    EntryPoint,
    EntryVariates,
    GrainSize,
    LayerGeometry,
    RejectionRules,
    Spheroid,
)
from splits.kernels.grains.surface import InteractionVariates, InterfaceState
from splits.kernels.interface import ComplexIndex
from splits.kernels.scene import (
    ALL_FEATURES,
    ANY_FACETS,
    PROJECTED_ENTRY,
    PROJECTED_FACETS,
    UNIFORM_ENTRY,
    UNWEIGHTED_FACETS,
    Features,
    Ray,
    Segment,
    Vector,
)

pytestmark = NEEDS_JIT

N_SAMPLES = 200_000
MEDIAN_ERROR, TAIL_ERROR, MAX_ERROR = 1e-7, 2e-6, 1e-4
MAX_DIFFERENT_FRACTION = 2e-5
"""Largest fraction of decisions that may differ between the precisions."""
NO_FEATURES = Features(*[None] * len(Features._fields))
FEATURES = {
    "smooth": NO_FEATURES,
    "rough": NO_FEATURES._replace(faceted=True),
    "rough, absorbing": NO_FEATURES._replace(faceted=True, absorbing=True),
    "rough, mixed": NO_FEATURES._replace(faceted=True, absorbing=True, mixed=True),
    "everything": ALL_FEATURES,
}
GRAIN_SIZE = 1e-4
"""Typical size of the grains (m)."""


@pytest.fixture
def random():
    return np.random.default_rng(20_250_101)


def draw_directions(random, n=N_SAMPLES):
    """Return random directions."""
    v = random.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def draw_circle(random, n=N_SAMPLES):
    angle = random.uniform(0.0, 2.0 * np.pi, n)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def draw_sizes(random):
    """Return semi-major axis and flattening."""
    return np.column_stack(
        [GRAIN_SIZE * random.uniform(0.5, 2.0, N_SAMPLES), random.uniform(0, 0.9, N_SAMPLES)]
    )


def run_both_precisions(loop, columns, width, *args):
    """Return the results of a loop for the same input in single and in double precision."""
    single = np.ascontiguousarray(np.column_stack(columns), dtype=np.float32)
    results = []
    for x in (single, single.astype(np.float64)):
        out = np.full((len(x), width), np.nan, dtype=x.dtype)
        loop(x, *args, out)
        results.append(out.astype(float))
    return results


def check_agreement(single, double, label, scale=1.0, max_error=MAX_ERROR):
    """Assert that results agree to single precision."""
    assert np.isfinite(single).all() and np.isfinite(double).all()
    error = np.abs(single - double).max(axis=1) / scale
    errors = np.median(error), np.quantile(error, 0.999), error.max()
    print(f"{label}: median {errors[0]:.1e}, 99.9 % {errors[1]:.1e}, worst {errors[2]:.1e}")
    assert errors[0] <= MEDIAN_ERROR and errors[1] <= TAIL_ERROR and errors[2] <= max_error, label


def check_decisions(single, double, label):
    """Assert that nearly all decisions agree; return a mask of the rows where all do."""
    assert np.isin(single, (0.0, 1.0)).all() and np.isin(double, (0.0, 1.0)).all()
    same = (single == double).all(axis=1)
    print(f"{label}: {np.count_nonzero(~same)} decisions of {same.size} differ")
    assert np.mean(~same) <= MAX_DIFFERENT_FRACTION, label
    return same


# --- interfaces -------------------------------------------------------------------------------


@njit
def _sample_interactions(x, lobe, through, features, rule, flip, out):
    for i in range(len(x)):
        row = x[i]
        d, n = Vector(row[0], row[1], row[2]), Vector(row[3], row[4], row[5])
        zero, one = row[6], row[7]
        facet = surface.make_smooth_facet(d, Spheroid(n, n, zero, one), one)
        variates = InteractionVariates(
            row[8], row[9], row[9], row[10], Angle(abs(row[11]), row[12])
        )
        if features.faceted is not None:
            facet = surface.sample_microfacet(d, facet, row[13], variates, lobe, rule)
        media = surface.relative_index(
            ComplexIndex(row[14], row[15]), ComplexIndex(row[16], row[17])
        )
        state = InterfaceState(zero, one, lobe, through)
        after = surface.reflect_or_refract(d, state, facet, media, row[9], flip, features)
        next_region = surface.find_next_region(state, after, one, features.mixed)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = (
            after.direction.x,
            after.direction.y,
            after.direction.z,
            after.cos_out,
        )
        out[i, 4], out[i, 5], out[i, 6] = (
            facet.cos_facet,
            next_region.interface.shell,
            next_region.interface.side,
        )
        out[i, 7], out[i, 8], out[i, 9] = after.transmitted, after.accepted, after.needs_lobe
        out[i, 10], out[i, 11], out[i, 12] = (
            next_region.in_pore,
            next_region.in_coating,
            next_region.in_core,
        )


def draw_interfaces(random, indices, extinction):
    """Return random rays at random interfaces."""
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


@pytest.mark.long
@pytest.mark.parametrize("lobe", [False, True])
@pytest.mark.parametrize("name", FEATURES)
def test_interactions_at_an_interface(random, name, lobe):
    features = FEATURES[name]
    if lobe and features.faceted is None:
        pytest.skip("smooth interfaces have no lobes")
    absorbs = features.absorbing is not None
    # Equal media on both sides occur in mixed scenes only.
    indices = [1.0, 1.33, 1.31, 2.5]
    columns = draw_interfaces(random, indices, 0.5 if absorbs else 0.0)
    if features.mixed is None:
        columns[8] = np.where(columns[8] == columns[10], 1.55, columns[8])
    for rule in (PROJECTED_FACETS, UNWEIGHTED_FACETS, ANY_FACETS):
        for flip in (False, True):
            for through in (False, True) if lobe else (False,):
                label = f"{name}, lobe {lobe}, through {through}, rule {rule}, flip {flip}"
                single, double = run_both_precisions(
                    _sample_interactions, columns, 13, lobe, through, features, rule, flip
                )
                same = check_decisions(single[:, 7:], double[:, 7:], label)
                check_agreement(single[same, :4], double[same, :4], label)
                assert (single[same, 5:7] == double[same, 5:7]).all()
                assert np.abs((single[:, :3] ** 2).sum(axis=1) - 1.0).max() < 1e-6
                assert np.abs((double[:, :3] ** 2).sum(axis=1) - 1.0).max() < 1e-13


@pytest.mark.long
@pytest.mark.parametrize("name", list(FEATURES)[1:])
def test_unused_features_change_nothing(random, name):
    """Without absorption and with the default interpretation more features change nothing."""
    columns = draw_interfaces(random, [1.0, 1.33, 1.31, 2.5], 0.0)
    columns[8] = np.where(columns[8] == columns[10], 1.55, columns[8])
    base_results, extended_results = (
        run_both_precisions(
            _sample_interactions,
            columns,
            13,
            False,
            False,
            features,
            PROJECTED_FACETS,
            False,
        )
        for features in (FEATURES["rough"], FEATURES[name])
    )
    for base, extended, allowed in zip(base_results, extended_results, (1e-4, 1e-10), strict=True):
        same = (base[:, 7:10] == extended[:, 7:10]).all(axis=1)
        assert np.mean(~same) <= MAX_DIFFERENT_FRACTION
        # Results of a rejected facet are not used.
        same &= base[:, 8] == 1.0
        assert np.abs(base[same, :5] - extended[same, :5]).max() < allowed


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


def test_normals_and_chords_of_grains(random):
    columns = [
        draw_directions(random),
        draw_directions(random),
        draw_sizes(random),
        draw_directions(random),
    ]
    columns.append(random.uniform(-1.0, 1.0, N_SAMPLES))
    single, double = run_both_precisions(_compute_chords, columns, 11)
    check_agreement(single[:, :3], double[:, :3], "normal")
    check_agreement(single[:, 3:6], double[:, 3:6], "scaled")
    check_agreement(single[:, 6:9], double[:, 6:9], "exit point")
    check_agreement(single[:, 9:10], double[:, 9:10], "squared normal length")
    check_agreement(
        single[:, 10:], double[:, 10:], "chord", columns[2][:, 0] / (1.0 - columns[2][:, 1])
    )


@njit
def _compute_entries(x, entry, out):
    for i in range(len(x)):
        row = x[i]
        d, size = Vector(row[0], row[1], row[2]), GrainSize(row[3], row[4])
        variates = EntryVariates(
            row[5], Angle(row[6], row[7]), Angle(row[8], row[9]), row[10], row[11]
        )
        hit = spheroid.sample_entry_point(d, size, variates, entry)
        q, w, n = hit.grain.q, hit.grain.w, hit.normal
        out[i, 0], out[i, 1], out[i, 2] = q.x, q.y, q.z
        out[i, 3], out[i, 4], out[i, 5] = w.x, w.y, w.z
        out[i, 6], out[i, 7], out[i, 8] = n.x, n.y, n.z
        out[i, 9], out[i, 10] = hit.axial_position, hit.grain.semi_minor
        out[i, 11] = spheroid.accept_axial_position(variates, size.flattening)


def draw_entry_variates(random):
    """Return the random variates of an entry point."""
    return [
        random.uniform(size=N_SAMPLES), draw_circle(random), draw_circle(random),
        random.uniform(size=(N_SAMPLES, 2))
    ]  # fmt: skip


@pytest.mark.parametrize("entry", [UNIFORM_ENTRY, PROJECTED_ENTRY])
def test_entry_points_of_grains(random, entry):
    columns = [draw_directions(random), draw_sizes(random), *draw_entry_variates(random)]
    single, double = run_both_precisions(_compute_entries, columns, 12, entry)
    check_decisions(single[:, 11:], double[:, 11:], "accepted")
    check_agreement(single[:, :9], double[:, :9], "entry point")
    check_agreement(single[:, 9:10], double[:, 9:10], "axial")
    check_agreement(single[:, 10:11], double[:, 10:11], "semi-minor axis", GRAIN_SIZE)


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


def test_overlaps_with_boundaries_and_segments(random):
    ones = np.ones(N_SAMPLES)
    q, w = draw_directions(random), draw_directions(random)
    columns = [
        q, w, draw_sizes(random), (q * w).sum(axis=1), ones,
        -GRAIN_SIZE * random.uniform(0.0, 20.0, N_SAMPLES),
        -20.0 * GRAIN_SIZE * ones, 0.0 * ones,
        3.0 * GRAIN_SIZE * random.normal(size=(N_SAMPLES, 3)),
        draw_directions(random), GRAIN_SIZE * random.exponential(5.0, N_SAMPLES),
    ]  # fmt: skip
    single, double = run_both_precisions(_check_overlaps, columns, 2)
    assert double.mean(axis=0).min() > 0.05 and double.mean(axis=0).max() < 0.9
    for column, label in enumerate(("boundary", "segment")):
        check_decisions(single[:, [column]], double[:, [column]], label)


# --- free paths -------------------------------------------------------------------------------


@njit
def _sample_collisions(x, rules, out):
    for i in range(len(x)):
        row = x[i]
        d, size = Vector(row[0], row[1], row[2]), GrainSize(row[3], row[4])
        variates = EntryVariates(
            row[5], Angle(row[6], row[7]), Angle(row[8], row[9]), row[10], row[11]
        )
        zero = row[12]
        position, exit_offset = Vector(zero, zero, row[13]), Vector(row[14], row[15], row[16])
        previous_segment = Segment(exit_offset, Vector(row[17], row[18], row[19]), row[20])
        ray = Ray(
            None, position, exit_offset, d, previous_segment, row[21], None, None, None, None, None,
            None, None, None, None,
        )  # fmt: skip
        layer = LayerGeometry(row[22], row[23], row[25], row[26], zero, zero)
        collision = spheroid.sample_collision(ray, size, variates, row[24], layer, rules)
        boundary = spheroid.compute_boundary_hit(ray, layer)
        n = collision.entry.normal
        out[i, 0], out[i, 1], out[i, 2] = collision.distance, collision.height, boundary.distance
        out[i, 3], out[i, 4], out[i, 5] = (
            boundary.position.x,
            boundary.position.y,
            boundary.position.z,
        )
        out[i, 6], out[i, 7], out[i, 8] = n.x, n.y, n.z
        out[i, 9], out[i, 10], out[i, 11] = (
            collision.leaves_layer,
            collision.accepted,
            collision.start_distance > zero,
        )


DEPTH = 30.0 * GRAIN_SIZE
OVERLAP_RULES = {
    "redrawn": RejectionRules(UNIFORM_ENTRY, True, True, False, False),
    "kept": RejectionRules(PROJECTED_ENTRY, False, False, False, False),
    "skipped": RejectionRules(UNIFORM_ENTRY, True, True, True, True),
}


@pytest.mark.parametrize("name", OVERLAP_RULES)
def test_collisions_and_boundary_hits(random, name):
    ones = np.ones(N_SAMPLES)
    d = draw_directions(random)
    start_distance = (
        GRAIN_SIZE * random.uniform(0.0, 3.0, N_SAMPLES) * random.integers(0, 2, N_SAMPLES)
    )
    columns = [
        d, draw_sizes(random), *draw_entry_variates(random), 0.0 * ones,
        -DEPTH * random.uniform(0.15, 0.85, N_SAMPLES),
        0.5 * GRAIN_SIZE * random.normal(size=(N_SAMPLES, 3)), draw_directions(random),
        np.where(random.uniform(size=N_SAMPLES) < 0.1, -1.0,
                 GRAIN_SIZE * random.exponential(5.0, N_SAMPLES)),
        start_distance, 5.0 * GRAIN_SIZE * ones, -0.9 * DEPTH * ones,
        random.uniform(1e-6, 1.0, N_SAMPLES),
        -0.1 * DEPTH * ones, -DEPTH * ones,
    ]  # fmt: skip
    single, double = run_both_precisions(_sample_collisions, columns, 12, OVERLAP_RULES[name])
    same = check_decisions(single[:, 9:], double[:, 9:], name)
    check_agreement(single[:, :2], double[:, :2], "distance and height", DEPTH)
    # Distances to a boundary grow as 1/|cos θ| of the direction.
    scale = DEPTH / np.abs(d[:, 2])
    check_agreement(single[:, 2:6], double[:, 2:6], "boundary hit", scale)
    check_agreement(single[:, 6:9], double[:, 6:9], "normal")
    assert 0.02 < double[same, 10].mean() < 0.98


@njit
def _play_roulettes(x, out):
    for i in range(len(x)):
        row = x[i]
        ray = Ray(
            None, None, None, None, None, None, None, None, row[2], row[0], row[1], None, None,
            None, None,
        )  # fmt: skip
        result = spheroid.russian_roulette(ray, row[3], row[4] > row[5])
        out[i, 0], out[i, 1] = result.next_roulette, result.weight
        out[i, 2] = result.terminated


def test_roulette(random):
    columns = [
        random.exponential(3.0, N_SAMPLES), random.uniform(2.0, 6.0, N_SAMPLES),
        random.uniform(1.0, 30.0, N_SAMPLES), random.uniform(size=(N_SAMPLES, 3)),
    ]  # fmt: skip
    single, double = run_both_precisions(_play_roulettes, columns, 3)
    check_decisions(single[:, 2:], double[:, 2:], "terminated")
    check_agreement(single[:, :2], double[:, :2], "next roulette and weight", 30.0)
