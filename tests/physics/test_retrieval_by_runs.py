"""Retrieval from a medium itself, without a table."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.core.progress import Progress
from splits.core.validation import InvalidValue
from splits.retrieval.linearization import Linearization, LinearizedModel, estimate_nonlinearity
from splits.retrieval.measurement import Measurement
from splits.retrieval.media import make_medium_state_vector
from splits.retrieval.simulation_model import select_simulation_wavelengths
from splits.retrieval.simulation_progress import ProgressTracker

W = np.arange(500.0, 1400.0, 100.0)
SIZE, DIRT = "optical_radius_um", "impurities_ng_g.black_carbon"


def snow(radius, soot=0.0):
    """Return deep natural snow."""
    return splits.Snow.natural(optical_radius_um=radius, impurities_ng_g={"black_carbon": soot})


def measured(medium, seed, w=W, noise=0.02):
    """Return a noisy spectrum of a medium, and its noise."""
    random = np.random.default_rng(seed)
    truth = splits.spectrophotometer(medium, w, 0.0, 0.003, seed + 100).reflectance.values
    return (w, truth + noise * random.standard_normal(w.size)), np.full(w.size, noise)


@NEEDS_JIT
def test_snow_is_found_within_its_errors():
    z = []
    for seed, (radius, soot) in enumerate([(120.0, 40.0), (600.0, 300.0)]):
        spectrum, noise = measured(snow(radius, soot), seed)
        free = {SIZE: (50.0, 1500.0), DIRT: (0.0, 1000.0)}
        found = splits.retrieve(spectrum, snow(200.0), free, noise, max_stderr=0.006)
        places = found.dataset.draws.values
        for i, (name, truth) in enumerate(((SIZE, radius), (DIRT, soot))):
            own = np.log(places[:, i]) if name == SIZE else np.sqrt(places[:, i])
            there = np.log(truth) if name == SIZE else np.sqrt(truth)
            z.append((own.mean() - there) / own.std())
        assert found.constrained[SIZE]
    judge_z(np.array(z), bound_added=True)


@NEEDS_JIT
def test_runs_and_a_table_say_the_same():
    spectrum, noise = measured(snow(200.0), 5)
    table = splits.build_table(snow, {"radius": np.geomspace(50, 1000, 7)}, W, max_stderr=0.003)
    of_table = splits.retrieve(spectrum, splits.Table(table), {"radius": (50.0, 1000.0)}, noise)
    # By default half the noise of the measurement is added by runs; here a fifth is.
    of_runs = splits.retrieve(
        spectrum, snow(100.0), {SIZE: (50.0, 1000.0)}, noise, max_stderr=0.004
    )
    both = np.hypot(0.006 * 200.0, 0.3 * of_table.stderr["radius"])
    assert abs(of_runs.values[SIZE] - of_table.values["radius"]) < 4.0 * both
    assert of_runs.stderr[SIZE] == pytest.approx(of_table.stderr["radius"], rel=0.25)


@NEEDS_JIT
def test_runs_tell_errors_where_noise_is_not_known():
    spectrum, noise = measured(snow(200.0), 5)
    told = []
    found = splits.retrieve(spectrum, snow(100.0), {SIZE: (50.0, 1000.0)}, progress=told.append)
    known = splits.retrieve(spectrum, snow(100.0), {SIZE: (50.0, 1000.0)}, noise)
    assert abs(found.values[SIZE] - 200.0) < 4.0 * found.stderr[SIZE]
    # Nine values know their noise to 25 %; how alike they are, not so well.
    assert 0.4 < found.stderr[SIZE] / known.stderr[SIZE] < 3.0
    assert told[-1].target == pytest.approx(0.002)


def test_time_left_is_foretold_from_what_runs_took(monkeypatch):
    """On a clock that every rough run moves by a second."""
    clock, told = [0.0], []
    monkeypatch.setattr("splits.retrieval.simulation_model.time.perf_counter", lambda: clock[0])
    way = ProgressTracker(told.append, 0.005, 2)
    for _ in range(4):
        show = way.track_run(0.01, 1)
        for half in (0.5, 1.0):
            clock[0] += 0.5
            show(Progress(100, 0.01, 0.01, half, 1.0 - half))
    assert [one.seconds + one.seconds_left for one in told] == pytest.approx([way.total_cost] * 8)
    assert told[-1].seconds == 4.0 and told[-1].target == 0.005
    # Beyond what was foretold, a run tells its own.
    way.track_run(0.001, 10)
    way.track_run(0.01, 1)(Progress(100, 0.01, 0.01, 0.5, 0.25))
    assert told[-1].seconds_left == 0.25


@NEEDS_JIT
def test_layers_of_a_stack_can_be_free():
    def stack(depth):
        top = splits.Snow.natural(optical_radius_um=80, depth_m=depth)
        return splits.Stack([top, snow(600.0)])

    spectrum, noise = measured(stack(0.01), 7, np.array([900.0, 1050.0, 1250.0]), 0.01)
    free = {"layers.0.depth_m": (0.002, 0.05)}
    found = splits.retrieve(spectrum, stack(0.004), free, noise, max_stderr=0.006)
    own = np.log(found.dataset.draws.values[:, 0])
    assert abs(own.mean() - np.log(0.01)) < 4.0 * own.std()
    assert found.dataset.parameter_unit.values.tolist() == ["m"]


def test_a_straight_line_is_read_as_one():
    free = make_medium_state_vector(snow(100.0), {SIZE: (50, 200), "scale": (0.5, 2.0)}, None, 0.0)
    seen = Linearization(np.array([0.3, 0.6]), np.ones(3), np.arange(6.0).reshape(3, 2), np.eye(3))
    line = LinearizedModel(free, seen)
    place = np.array([0.4, 0.5])
    value, slopes = line.evaluate_with_jacobian(place)
    np.testing.assert_allclose(value, 1.0 + seen.jacobian @ [0.1, -0.1])
    np.testing.assert_array_equal(slopes, seen.jacobian)
    np.testing.assert_array_equal(line.evaluate(place[np.newaxis])[0], value)
    assert free.transforms == ("logarithm", "itself")


def test_how_far_light_is_off_a_straight_line_is_told_in_its_noise():
    """By the square of a standard deviation along any way, over the noise."""
    free = make_medium_state_vector(snow(100.0), {SIZE: (50, 200), "scale": (0.5, 2.0)}, None, 0.0)
    place, spread, noise = np.array([0.4, 0.5]), np.array([0.1, 0.25]), np.array([0.02, 0.02, 0.01])
    line = LinearizedModel(
        free, Linearization(place, np.zeros(3), np.ones((3, 2)), np.zeros((3, 3)))
    )

    def curved(x):
        return (x - place).sum() + np.array([0.0, 0.0, 3.0]) * (x[0] - place[0]) ** 2

    covariance = np.diag(spread**2), np.diag(noise**2)
    assert estimate_nonlinearity(curved, line, place, *covariance) == pytest.approx(
        3.0 * spread[0] ** 2 / noise[2]
    )
    assert (
        estimate_nonlinearity(lambda x: line.evaluate(x[np.newaxis])[0], line, place, *covariance)
        < 1e-12
    )


WRONG = {
    "names alone": ({"free": [SIZE]}, r"free = .*\(low, high\) by name"),
    "no such parameter": ({"free": {"depth": (1, 2)}}, "depth"),
    "no such medium": ({"free": {SIZE: (-5, 100)}}, rf"free\.{SIZE} = -5"),
    "contradictory": ({"free": {SIZE: (100, 50)}}, "low < high"),
    "one number": ({"free": {SIZE: 100}}, r"\(low, high\)"),
    "other axes": ({"fixed": {"depth_m": 1}}, "incidence_deg"),
    "an angle that is free": (
        {"free": {"incidence_deg": (0, 60)}, "fixed": {"sza": "diffuse"}},
        "fixed.sza.*left out, as it is free",
    ),
    "two angles": ({"fixed": {"sza": 10, "incidence_deg": 20}}, "left out beside"),
    "no medium": ({"model": 3}, "a Table, or a medium"),
    "error": ({"max_stderr": 0.9}, "max_stderr"),
    "per cent": ({"measured": (W, np.full(W.size, 50.0))}, "not per cent"),
    "transmittance": ({"quantity": "transmittance"}, "reflectance"),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_input_is_refused(name):
    other, message = WRONG[name]
    given = {"measured": (W, np.full(W.size, 0.5)), "model": snow(100.0),
             "free": {SIZE: (50, 200)}, "noise": 0.01}  # fmt: skip
    with pytest.raises(InvalidValue, match=message):
        splits.retrieve(**(given | other))


def test_wavelengths_of_bands_cover_them():
    bands = {"a": (500.0, 540.0), "b": (800.0, 1003.0)}
    w = select_simulation_wavelengths(Measurement.from_input([0.5, 0.5], 0.01, bands))
    assert w[0] == 500.0 and w[-1] == 1003.0 and np.diff(w).max() <= 10.0
