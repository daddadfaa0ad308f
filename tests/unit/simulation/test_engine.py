"""The adaptive loop: rounds of rays, jobs, stopping, rare light, strata, and progress."""

from types import SimpleNamespace

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from scipy import stats
from stub_tracing import SEGMENTS, StubTally

import splits
from splits.core.validation import InvalidValue
from splits.kernels.records import (
    CROSSING_LENGTH,
    CROSSING_RAY,
    EXIT_LENGTH,
    TraceResult,
)
from splits.kernels.scene import ALL_FEATURES
from splits.kernels.transport import history
from splits.simulation import engine
from splits.simulation.engine import (
    MAX_JOB_BYTES,
    MAX_ROUND_GROWTH,
    MAX_SEGMENTS_PER_JOB,
    ProgressReport,
    estimate_cost,
    limit_round,
    make_jobs,
    simulate,
)
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import build_scene
from splits.simulation.shared_paths import SpectralRows
from splits.simulation.spectral_nodes import IndexNodes, make_separate_nodes
from splits.simulation.spectral_tally import SpectralTally
from splits.simulation.strata import Evaluation, StoppingRule, Stratum, VarianceTerms, allocate_rays
from splits.simulation.tally import (
    RAYS_PER_CHUNK,
    SUFFICIENT_RAYS,
    UNSEEN_RAYS,
    ExitTally,
    allow_for_unseen_rays,
    find_required_rays,
)

MANY_RAYS = 10**8
WAVELENGTHS = [500.0, 1000.0, 1500.0]
SNOW = splits.Snow(depth_m=0.02)
SCENE = build_scene(SNOW, 0.0, False)


def run(tally, stop, scene=None, **settings):
    options = RunOptions.start(**{"seed": 1, "threads": 2, **settings})
    return simulate(scene, tally, stop, options)


def test_a_run_stops_when_converged():
    tally = StubTally([1.0, 4.0, 0.01])
    evaluation = run(tally, StoppingRule(0.01, MANY_RAYS))
    assert evaluation.stop_reason == "converged"
    assert evaluation.error == np.sqrt(tally.variances / tally.stratum_rays).max() <= 0.01
    assert tally.n_rays == tally.rounds[-1].sum()
    # Each stratum has what it needs and at most one chunk more; the last stays with its first rays.
    needed = np.maximum(tally.variances / 0.01**2, RAYS_PER_CHUNK)
    assert (needed <= tally.stratum_rays).all()
    assert (tally.stratum_rays < needed + RAYS_PER_CHUNK).all()
    segments = [stratum.n_segments for stratum in tally.strata]
    assert segments == (tally.stratum_rays * SEGMENTS).tolist()


def test_a_run_that_converges_in_the_first_round_has_no_other():
    tally = StubTally([0.01, 0.01])
    assert run(tally, StoppingRule(0.1, 1)).stop_reason == "converged"
    assert len(tally.rounds) == 1


@pytest.mark.parametrize("max_rays", [1, 3 * RAYS_PER_CHUNK, 1000, 54_321])
def test_a_run_stops_at_the_maximum_number_of_rays(max_rays):
    tally = StubTally([1.0, 4.0, 2.0])
    evaluation = run(tally, StoppingRule(1e-4, max_rays))
    assert evaluation.stop_reason == "max_rays"
    assert evaluation.error > 1e-4
    # Strata trace whole chunks.
    assert max_rays <= tally.n_rays < max_rays + 3 * RAYS_PER_CHUNK
    assert (tally.stratum_rays >= RAYS_PER_CHUNK).all()


def test_reasons_of_a_tally_end_a_run():
    tally = StubTally([1.0])
    tally.evaluate = lambda stop: Evaluation(0.5, stop_reason="max_degree")
    evaluation = run(tally, StoppingRule(0.01, MANY_RAYS))
    assert evaluation == (0.5, None, "max_degree")
    assert tally.n_rays == RAYS_PER_CHUNK


@pytest.mark.parametrize("max_rays", [1, 6 * RAYS_PER_CHUNK, 5000])
def test_a_fixed_number_of_rays_is_traced_in_one_round(max_rays):
    tally = StubTally([1.0, 1.0])
    evaluation = run(tally, StoppingRule(10.0, max_rays, fixed=True))
    rays = -(-max_rays // (2 * RAYS_PER_CHUNK)) * RAYS_PER_CHUNK
    assert [one.tolist() for one in tally.rounds] == [[rays, rays]]
    assert tally.n_rays == 2 * rays and evaluation.stop_reason == "fixed_rays"


def test_a_round_grows_at_most_eightfold():
    tally = StubTally([1.0, 100.0])
    run(tally, StoppingRule(0.01, MANY_RAYS))
    rounds = np.array(tally.rounds)
    growth = rounds[1:] / rounds[:-1]
    assert MAX_ROUND_GROWTH == 8.0
    assert growth.max() == 8.0
    # The first stratum needs 10 000 rays, the second 1 000 000: it has 8⁵ chunks of them at last.
    assert rounds[:, 1].tolist()[:-1] == [RAYS_PER_CHUNK * 8**i for i in range(5)]
    assert len(rounds) == 6


@pytest.mark.parametrize("rays_per_round", [RAYS_PER_CHUNK, 4 * RAYS_PER_CHUNK])
def test_rounds_are_multiples_of_the_rays_per_round(rays_per_round):
    tally = StubTally([1.0, 30.0, 7.0], rays_per_round)
    run(tally, StoppingRule(0.005, MANY_RAYS))
    rounds = np.array(tally.rounds)
    assert len(rounds) > 2
    assert (rounds[0] == rays_per_round).all()
    assert (np.diff(rounds, axis=0) % rays_per_round == 0).all()


def test_scores_are_merged_in_order_on_any_number_of_threads(monkeypatch):
    def run_on(threads, seed=3):
        # `StubTally.merge` checks the order of the chunks of each stratum.
        tally = StubTally([1.0, 30.0, 7.0], delay_s=0.001)
        evaluation = run(tally, StoppingRule(0.03, MANY_RAYS), threads=threads, seed=seed)
        return tally.sums.tolist(), evaluation

    expected = run_on(1)
    assert run_on(1, seed=4)[0] != expected[0]
    for max_segments in (engine.MAX_SEGMENTS_PER_JOB, 1e5):
        monkeypatch.setattr(engine, "MAX_SEGMENTS_PER_JOB", max_segments)
        for threads in (1, 2, 5, 16):
            assert run_on(threads) == expected


def test_a_run_uses_the_requested_threads(monkeypatch):
    pools = []

    class RecordedPool(engine.DaemonThreadPool):
        def __init__(self, n_threads):
            pools.append(n_threads)
            super().__init__(n_threads)

    monkeypatch.setattr(engine, "DaemonThreadPool", RecordedPool)
    run(StubTally([1.0, 100.0]), StoppingRule(0.01, MANY_RAYS), threads=3)
    assert pools == [3]


@pytest.mark.parametrize("lost_ray", [0, 5000])
def test_a_lost_ray_ends_the_run(lost_ray):
    tally = StubTally([1.0, 1.0, 1.0], lost_ray=lost_ray)
    with pytest.raises(RuntimeError, match="a ray was lost"):
        run(tally, StoppingRule(0.01, MANY_RAYS))
    assert len(tally.rounds) == (0 if lost_ray == 0 else 2)


class NumberedExits(ExitTally):
    """Tally of exits that are the numbers of the rays; each odd ray crosses a boundary twice."""

    def __init__(self, monkeypatch, n_rows, lost=False):
        super().__init__(make_separate_nodes(np.ones((n_rows, 1)) + 0j), np.zeros((n_rows, 1)))
        self.strata = [
            Stratum(row, None, self.select_node(row), np.zeros((1, 1))) for row in range(n_rows)
        ]

        def trace_rays(seed, work, scene, optics, exits, surface_buffer):
            stream, first, count, _ = work
            exits[:, EXIT_LENGTH] = stream * 1e6 + np.arange(first, first + count)
            rays = np.repeat(np.arange(1, count, 2), 2)
            crossings = np.zeros((len(rays), CROSSING_LENGTH + 1))
            crossings[:, CROSSING_RAY], crossings[:, CROSSING_LENGTH] = rays, first + rays
            return TraceResult(np.array([count]), lost, crossings)

        monkeypatch.setattr(history, "trace_rays", trace_rays)

    def score(self, stratum, exits, crossings):
        return exits, crossings

    def merge(self, stratum, score):
        raise AssertionError


def test_exits_and_crossings_are_scored_by_chunk(monkeypatch):
    tally = NumberedExits(monkeypatch, 2)
    items = [(0, 256, 384), (1, 0, 128)]
    job = [(tally.strata[row], range(first, first + count)) for row, first, count in items]
    results = tally.trace_job(1, SCENE, job)
    assert [n_segments for _, n_segments in results] == [384, 128]
    for (row, first_ray, count), (scores, _) in zip(items, results, strict=True):
        assert len(scores) == count // RAYS_PER_CHUNK
        for number, (exits, crossings) in enumerate(scores):
            first = first_ray + number * RAYS_PER_CHUNK
            rays = np.arange(first, first + RAYS_PER_CHUNK)
            np.testing.assert_array_equal(exits[:, EXIT_LENGTH], row * 1e6 + rays)
            np.testing.assert_array_equal(
                crossings[:, CROSSING_RAY], np.repeat(np.arange(1, RAYS_PER_CHUNK, 2), 2)
            )
            np.testing.assert_array_equal(
                crossings[:, CROSSING_LENGTH], first + crossings[:, CROSSING_RAY]
            )


def test_a_lost_ray_is_explained(monkeypatch):
    tally = NumberedExits(monkeypatch, 1, lost=True)
    with pytest.raises(RuntimeError, match="no grain fits between the boundaries"):
        run(tally, StoppingRule(1.0, 1), SCENE, kernel="scalar")


def test_kernels_are_named():
    tally = StubTally([1.0, 1.0])
    assert tally.kernel == "scalar"
    tally.strata[0].features = ALL_FEATURES
    assert tally.kernel == "scalar, vectorized"
    tally.strata[1].features = ALL_FEATURES
    assert tally.kernel == "vectorized"
    with pytest.raises(InvalidValue, match="kernel = 'vectorized': must be 'auto' or 'scalar'"):
        run(tally, StoppingRule(1.0, 1), kernel="vectorized")


def test_progress_of_every_job_is_reported(monkeypatch):
    monkeypatch.setattr(engine, "MIN_REPORT_INTERVAL_S", -1.0)
    # The error after the first round exceeds 1, as relative errors may.
    tally, reports = StubTally([1.0, 1000.0]), []
    run(tally, StoppingRule(0.1, MANY_RAYS), progress=reports.append)
    rounds = np.array(tally.rounds)
    rays = np.diff(rounds.sum(axis=1), prepend=0)
    assert list(dict.fromkeys(one.rays for one in reports)) == rays.tolist()
    # Errors are those of the round before, and infinite at first.
    errors = np.sqrt((tally.variances / rounds).max(axis=1))
    assert errors[0] > 1.0
    expected = [np.inf, *errors[:-1]]
    assert list(dict.fromkeys(one.stderr for one in reports)) == expected
    assert {one.target for one in reports} == {0.1}
    seconds = [one.seconds for one in reports]
    assert seconds == sorted(seconds) and min(seconds) >= 0.0
    assert all(one.seconds_left >= 0.0 for one in reports)
    assert reports[-1].seconds_left == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("variances", "max_error", "scale", "expected"),
    [
        # The error is reached first, or the largest number of rays.
        ([1.0, 100.0], 0.01, 1.0, 1_010_000),
        ([1.0, 100.0], 1e-5, 1.0, 2_000_000),
        # The variances predict fewer rays than the error needs, or it is never reached.
        ([0.01, 0.01], 0.02, 4.0, None),
        ([0.01, 0.01], 0.02, 1e3, 2_000_000),
        ([0.01, 0.01], 0.02, np.inf, 2_000_000),
    ],
)
def test_the_remaining_time_is_that_of_what_ends_the_run(
    monkeypatch, variances, max_error, scale, expected
):
    tally, rounds = StubTally(variances), []
    evaluate, begin_round = tally.evaluate, ProgressReport.begin_round

    def record(report, n_rays, cost, remaining_rays):
        rounds.append((tally.n_rays, n_rays, remaining_rays))
        begin_round(report, n_rays, cost, remaining_rays)

    def enlarge_error(stop):
        state = evaluate(stop)
        return state._replace(error=scale * state.error)

    monkeypatch.setattr(tally, "evaluate", enlarge_error)
    monkeypatch.setattr(ProgressReport, "begin_round", record)
    stop = StoppingRule(max_error, 2_000_000)
    evaluation = run(tally, stop)
    assert evaluation.stop_reason == ("max_rays" if expected == stop.max_rays else "converged")
    end = tally.n_rays
    for done, n_rays, remaining in rounds[1:]:
        assert remaining >= 0.0
        predicted = done + n_rays + remaining
        assert predicted == pytest.approx(end, rel=0.05 if expected else 0.3)
    assert end == pytest.approx(expected or end, rel=0.01)


def test_remaining_time_and_interval_of_reports(monkeypatch):
    clock, reports = SimpleNamespace(now=100.0), []
    monkeypatch.setattr(engine, "time", SimpleNamespace(perf_counter=lambda: clock.now))
    report = ProgressReport(reports.append, 0.01)
    clock.now += 2.0
    # Half of the rays of this round and those after it.
    report.begin_round(1000, 50.0, 1000.0)
    clock.now += 1.0
    report.advance(20.0)
    assert (reports[-1].rays, reports[-1].stderr, reports[-1].target) == (1000, np.inf, 0.01)
    assert (reports[-1].seconds, reports[-1].seconds_left) == pytest.approx((3.0, 4.0))
    clock.now += 0.4
    report.advance(20.0)
    assert len(reports) == 1
    clock.now += 0.2
    report.advance(10.0)
    assert len(reports) == 2
    assert (reports[-1].seconds, reports[-1].seconds_left) == pytest.approx((3.6, 1.6))
    # With `progress=True`, a progress bar takes the place of the argument.
    for none in (None, True):
        silent = ProgressReport(none, 0.01)
        silent.begin_round(1, 1.0, 0.0)
        silent.advance(1.0)


def make_traced_tally(n_rays, rays_per_round=RAYS_PER_CHUNK):
    tally = StubTally(np.ones(len(n_rays)), rays_per_round)
    for stratum, count in zip(tally.strata, n_rays, strict=True):
        stratum.n_rays = count
    return tally


def test_rounds_are_limited():
    tally = make_traced_tally([1280, 1280, 1280])
    # Strata that have enough get no more, and the others at most seven times what they have.
    rays = limit_round(tally, np.array([100.0, 2000.0, 1e6]), MANY_RAYS)
    assert rays.tolist() == [0, 768, 7 * 1280]
    # Within the largest number of all rays, all get less in proportion.
    rays = limit_round(tally, np.array([1280.0, 1280.0 + 2560.0, 1280.0 + 5120.0]), 3 * 1280 + 3840)
    assert rays.tolist() == [0, 1280, 2560]
    tally = make_traced_tally([1024, 1024], 512)
    assert limit_round(tally, np.array([1025.0, 1600.0]), MANY_RAYS).tolist() == [512, 1024]
    # Where the rays should suffice but do not, all strata grow by a quarter.
    assert limit_round(tally, np.array([1024.0, 100.0]), MANY_RAYS).tolist() == [512, 512]


def test_rays_beyond_the_limit_are_less_than_one_round():
    tally = make_traced_tally([128] * 300)
    for n_left in (1, 1000, 128 * 250 + 1):
        rays = limit_round(tally, np.full(300, 1000.0), 300 * 128 + n_left)
        assert n_left <= rays.sum() < n_left + 128


@pytest.mark.parametrize("n_left", [1, 2, 3])
def test_the_last_rays_are_those_of_the_neediest_stratum(n_left):
    tally = make_traced_tally([128, 128, 128])
    rays = limit_round(tally, np.array([200.0, 800.0, 300.0]), 3 * 128 + n_left)
    assert rays.tolist() == [0, 128, 0]


def find_least_cost(terms, cost):
    """Return the least cost at which all variances are at most 1, from grids that are refined."""
    mask = terms.contributes.astype(float)
    columns = np.unique(terms.columns)
    largest = 4.0 * terms.variances.sum()
    centre, width = np.full(len(cost), np.sqrt(1e-3 * largest)), np.sqrt(1e3 * largest)
    for _ in range(12):
        axes = [value * np.geomspace(1.0 / width, width, 41) for value in centre]
        n_rays = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(cost))
        per_term = terms.variances[:, np.newaxis] / np.maximum(n_rays @ mask, 1e-300)
        ratio = np.stack([per_term[..., terms.columns == c].sum(axis=-1) for c in columns])
        # More rays in proportion satisfy all limits.
        n_rays *= ratio.max(axis=(0, 1))[:, np.newaxis]
        costs = n_rays @ cost
        centre = n_rays[costs.argmin()]
        width **= 0.6
    return costs.min()


def make_terms(contributes, columns, rng, n_quantities=2):
    variances = rng.uniform(100.0, 10_000.0, (n_quantities, len(columns)))
    return VarianceTerms(variances, np.array(columns), np.array(contributes, dtype=bool))


ALLOCATIONS = {
    "one stratum": ([[1, 1]], [0, 1]),
    "separate strata": ([[1, 0], [0, 1]], [0, 1]),
    "two nodes of a row": ([[1, 0], [0, 1]], [0, 0]),
    "nested strata": ([[1, 1], [0, 1]], [0, 1]),
    "nested strata of two nodes": (
        [[1, 1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1]],
        [0, 1, 1, 2],
    ),
    "three nested strata": ([[1, 1, 1], [0, 1, 1], [0, 0, 1]], [0, 1, 2]),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ALLOCATIONS)
def test_allocation_has_the_least_cost(name, seed):
    rng = np.random.default_rng(seed)
    contributes, columns = ALLOCATIONS[name]
    terms = make_terms(contributes, columns, rng)
    # Later strata are more absorbed and cheaper.
    segments = (300.0 / 4.0 ** np.arange(len(contributes)) * rng.uniform(0.5, 2.0)).astype(int)
    strata = [
        Stratum(i, None, slice(0), None, n_rays=1, n_segments=int(n))
        for i, n in enumerate(segments)
    ]
    n_rays = allocate_rays(terms, strata)
    ratio = terms.sum_columns(terms.variances / (n_rays @ terms.contributes))
    # The margin is 3 %.
    assert ratio.max() <= 1.0 / 1.029
    cost = 1.0 + segments
    least = find_least_cost(terms, cost)
    assert 1.02 < n_rays @ cost / least < 1.05


def test_traced_rays_count_in_the_allocation():
    terms = VarianceTerms(
        np.array([[1000.0, 1000.0]]), np.array([0, 1]), np.array([[1, 1], [0, 1]], dtype=bool)
    )
    strata = [
        Stratum(i, None, slice(0), None, n_rays=n, n_segments=n) for i, n in enumerate((4000, 100))
    ]
    # The first stratum has enough rays for both.
    assert allocate_rays(terms, strata).tolist() == [4000, 100]
    strata[0].n_rays = strata[0].n_segments = 900
    n_rays = allocate_rays(terms, strata)
    assert 1000 < n_rays[0] <= 1040 and n_rays[1] == 100


@NEEDS_JIT
@pytest.mark.parametrize("extra_rays", [1, 2 * RAYS_PER_CHUNK, 11 * RAYS_PER_CHUNK])
def test_a_spectrum_stops_at_the_maximum_number_of_rays(extra_rays):
    first_round = splits.spectrophotometer(SNOW, WAVELENGTHS, max_rays=1).attrs["rays"]
    max_rays = first_round + extra_rays
    spectrum = splits.spectrophotometer(SNOW, WAVELENGTHS, max_stderr=1e-5, max_rays=max_rays)
    assert spectrum.attrs["stop_reason"] == "max_rays"
    # Strata trace whole chunks: at most one chunk more than requested in each of them.
    assert max_rays <= spectrum.attrs["rays"] < max_rays + first_round
    assert np.isfinite(spectrum.reflectance).all()


@NEEDS_JIT
def test_rays_are_allocated_to_strata_that_need_them():
    # Close to the end, a converged stratum must not grow while another one lacks a few rays.
    rays = [
        splits.spectrophotometer(SNOW, [450.0, 1030.0, 1600.0], max_stderr=0.01, seed=seed).attrs[
            "rays"
        ]
        for seed in range(60)
    ]
    assert max(rays) < 3.0 * np.median(rays)


THIN_SCENE = build_scene(splits.Snow(depth_m=0.02), 0.0, False)


def make_tally(segments_per_ray):
    """Return a tally of three strata with given mean numbers of segments."""
    absorption = np.repeat([[0.0], [9.0], [99.0]], 3, axis=1)
    index = np.ones((3, 3)) + 0j
    rows = SpectralRows(index, absorption, absorption, np.zeros((0, 3, 3)), ())
    nodes = IndexNodes(index[:1], np.ones((1, 3)), np.zeros(3))
    tally = SpectralTally(rows, nodes, THIN_SCENE)
    assert len(tally.strata) == 3
    for stratum, n_segments in zip(tally.strata, segments_per_ray, strict=True):
        stratum.n_rays, stratum.n_segments = RAYS_PER_CHUNK, RAYS_PER_CHUNK * n_segments
    return tally


def divide(tally, chunks, threads):
    """Return the jobs for given numbers of chunks of the strata."""
    return make_jobs(THIN_SCENE, tally, RAYS_PER_CHUNK * np.array(chunks), threads)


@pytest.mark.parametrize("threads", [1, 2, 3, 7])
@pytest.mark.parametrize("chunks", [(1, 1, 1), (40, 30, 1000), (5, 30_000, 0)])
def test_jobs_contain_every_chunk_once_and_in_order(threads, chunks):
    tally = make_tally((1000, 100, 10))
    jobs = divide(tally, chunks, threads)
    for stratum, count in zip(tally.strata, chunks, strict=True):
        firsts = [
            first
            for job in jobs
            for item_stratum, rays in job
            for first in rays[::RAYS_PER_CHUNK]
            if item_stratum is stratum
        ]
        n_rays = count * RAYS_PER_CHUNK
        assert firsts == list(range(stratum.n_rays, stratum.n_rays + n_rays, RAYS_PER_CHUNK))
    assert all(rays and len(rays) % RAYS_PER_CHUNK == 0 for job in jobs for _, rays in job)
    bytes_per_chunk = 8 * (
        RAYS_PER_CHUNK * tally.count_ray_values(THIN_SCENE) + tally.count_score_values()
    )
    n_chunks = [sum(len(rays) for _, rays in job) // RAYS_PER_CHUNK for job in jobs]
    assert max(n_chunks) * bytes_per_chunk <= MAX_JOB_BYTES


def test_rays_are_rounded_up_to_whole_chunks():
    tally = make_tally((10, 10, 10))
    items = [item for job in make_jobs(THIN_SCENE, tally, np.array([1, 0, 129]), 1) for item in job]
    assert [(tally.strata.index(one), len(rays)) for one, rays in items] == [(0, 128), (2, 256)]


@pytest.mark.parametrize("features", [None, ALL_FEATURES])
def test_jobs_have_similar_cost(features):
    tally = make_tally((1000, 100, 10))
    for stratum in tally.strata:
        stratum.features = features
    jobs = divide(tally, (100, 500, 2000), 4)
    costs = [sum(len(rays) * estimate_cost(one) for one, rays in job) for job in jobs]
    max_segments = MAX_SEGMENTS_PER_JOB if features else MAX_SEGMENTS_PER_JOB / 8
    assert max(costs) <= 1.2 * np.mean(costs) and max(costs) <= 1.1 * max_segments
    assert len(jobs) % 4 == 0


def test_jobs_use_one_kernel():
    tally = make_tally((1000, 100, 10))
    tally.strata[1].features = ALL_FEATURES
    jobs = divide(tally, (100, 500, 2000), 4)
    kernels = [{stratum.features for stratum, _ in job} for job in jobs]
    assert all(len(one) == 1 for one in kernels)
    assert {ALL_FEATURES} in kernels and {None} in kernels


@pytest.mark.parametrize("threads, chunks", [(2, 3), (8, 11), (16, 38), (64, 80), (64, 95)])
def test_chunks_are_divided_evenly_over_jobs(threads, chunks):
    jobs = divide(make_tally((10, 10, 10)), (chunks, 0, 0), threads)
    sizes = [sum(len(rays) for _, rays in job) // RAYS_PER_CHUNK for job in jobs]
    assert sum(sizes) == chunks and max(sizes) <= -(-chunks // threads) + 1


EXPECTED_COUNTS = np.geomspace(0.01, 100.0, 400)


def compute_coverage(stderr, sigma):
    """Return the probability that a Poisson count is within a multiple of its error."""
    counts = np.arange(len(stderr))
    inside = np.abs(counts - EXPECTED_COUNTS[:, np.newaxis]) <= sigma * stderr
    return (stats.poisson.pmf(counts, EXPECTED_COUNTS[:, np.newaxis]) * inside).sum(axis=1)


def test_two_errors_contain_rare_rays():
    counts = np.arange(300.0)
    allowed = np.sqrt(allow_for_unseen_rays(counts, np.ones_like(counts)))
    assert compute_coverage(np.sqrt(counts), 2.0).min() < 0.1
    # Rays of small weight give a scatter that hardly exceeds 0 if the others are missing.
    assert compute_coverage(allowed, 2.0).min() > 0.92
    assert compute_coverage(allowed, 3.0).min() > 0.98


def test_sufficient_rays_are_not_changed():
    variance = np.linspace(0.0, 20.0, 201)
    allowed = allow_for_unseen_rays(variance, 1.0)
    sufficient = variance >= SUFFICIENT_RAYS
    np.testing.assert_array_equal(allowed[sufficient], variance[sufficient])
    assert allowed[0] == UNSEEN_RAYS and (np.diff(allowed) > 0.0).all()
    assert (allowed[~sufficient] > variance[~sufficient]).all()


@pytest.mark.parametrize("variance", [0.0, 1e-6, 1e-3, 0.1, 1.0])
@pytest.mark.parametrize("max_error", [1e-4, 0.003, 0.05])
def test_required_rays_reach_the_error(variance, max_error):
    rays = find_required_rays(np.array(variance), np.array(0.9), np.array(max_error**2))
    reached = allow_for_unseen_rays(variance / rays, 0.9 / rays**2)
    assert reached == pytest.approx(max_error**2, rel=1e-12)
