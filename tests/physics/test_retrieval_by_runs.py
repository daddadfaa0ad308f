"""Retrieval by simulations of a medium, without a table."""

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.core.progress import Progress
from splits.core.validation import InvalidValue
from splits.retrieval.forward_model import LinearModel
from splits.retrieval.linearization import estimate_nonlinearity
from splits.retrieval.medium_model import (
    ProgressTracker,
    count_survey,
    make_medium_state_vector,
)

pytestmark = pytest.mark.long

W = np.arange(500.0, 1400.0, 100.0)
PATHS = "monte_carlo"
SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"


def make_snow(radius, soot=0.0):
    """Return deep natural snow."""
    return splits.Snow.natural(optical_radius_um=radius, impurities_ng_g={"black_carbon": soot})


def simulate_measurement(medium, seed, w=W, noise=0.02):
    """Return a noisy spectrum of a medium and the standard deviation of its noise."""
    random = np.random.default_rng(seed)
    truth = splits.spectrophotometer(
        medium, w, 0.0, max_stderr=0.003, seed=seed + 100
    ).reflectance.values
    return (w, truth + noise * random.standard_normal(w.size)), np.full(w.size, noise)


@NEEDS_JIT
def test_retrieved_snow_agrees_within_errors():
    z = []
    for seed, (radius, soot) in enumerate([(120.0, 40.0), (600.0, 300.0)]):
        spectrum, noise = simulate_measurement(make_snow(radius, soot), seed)
        free = {SIZE: (50.0, 1500.0), SOOT: (0.0, 1000.0)}
        result = splits.retrieve(
            spectrum, make_snow(200.0), free, noise, solver=PATHS, max_stderr=0.006
        )
        draws = result.dataset.draws.values
        for i, (name, truth) in enumerate(((SIZE, radius), (SOOT, soot))):
            samples = np.log(draws[:, i]) if name == SIZE else np.sqrt(draws[:, i])
            transformed_truth = np.log(truth) if name == SIZE else np.sqrt(truth)
            z.append((samples.mean() - transformed_truth) / samples.std())
        assert result.constrained[SIZE]
    judge_z(np.array(z), bound_added=True)


@NEEDS_JIT
def test_retrieved_sand_agrees_within_errors():
    """A sand of SPLITS Table 2, with the partition and the texture of the medium known."""
    truth = {"iron_oxide": 0.02, "hematite_ratio": 0.4, "magnetite": 0.03}
    grains = {"partition": (0.2, 0.5, 0.3), "texture": (0.0005, 0.08, 0.9195)}
    w = np.arange(400.0, 1001.0, 50.0)
    spectrum, noise = simulate_measurement(splits.Sand(**truth, **grains), 3, w, 0.004)
    free = {"iron_oxide": (0.005, 0.05), "hematite_ratio": (0.0, 1.0), "magnetite": (0.01, 0.1)}
    one_thread, result = (
        splits.retrieve(spectrum, splits.Sand(**grains), free, noise, threads=n) for n in (1, 2)
    )
    np.testing.assert_array_equal(one_thread.dataset.draws, result.dataset.draws)
    ends = result.dataset.quantiles.sel(quantile=[0.025, 0.975])
    for name, true in truth.items():
        low, high = ends.sel(parameter=name).values
        assert low < true < high, name
    assert result.constrained["iron_oxide"] and result.constrained["hematite_ratio"]


def test_one_part_of_a_whole_may_be_free():
    spectrum = W, np.full(W.size, 0.3)
    free = {"partition.pure": (0.1, 0.5), "iron_oxide": (0.001, 0.05), "partition.coated": (0, 0.5)}
    with pytest.raises(
        InvalidValue, match=r"^free\.partition\.coated = .*partition\.pure is given"
    ):
        splits.retrieve(spectrum, splits.Sand(), free)


def test_surveys_grow_with_the_number_of_parameters():
    assert [count_survey(n) for n in (1, 4, 5, 7, 20)] == [16, 16, 32, 128, 128]


@NEEDS_JIT
def test_simulation_and_table_give_the_same_retrieval():
    spectrum, noise = simulate_measurement(make_snow(200.0), 5)
    table = splits.build_table(
        make_snow, {"radius": np.geomspace(50, 1000, 7)}, W, max_stderr=0.003
    ).dataset
    from_table = splits.retrieve(spectrum, splits.Table(table), {"radius": (50.0, 1000.0)}, noise)
    # By default simulations add half the noise of the measurement; here they add a fifth.
    from_runs = splits.retrieve(
        spectrum, make_snow(100.0), {SIZE: (50.0, 1000.0)}, noise, solver=PATHS, max_stderr=0.004
    )
    tolerance = np.hypot(0.006 * 200.0, 0.3 * from_table.stderr["radius"])
    assert abs(from_runs.values[SIZE] - from_table.values["radius"]) < 4.0 * tolerance
    assert from_runs.stderr[SIZE] == pytest.approx(from_table.stderr["radius"], rel=0.25)


@NEEDS_JIT
def test_unknown_noise_is_estimated():
    spectrum, noise = simulate_measurement(make_snow(200.0), 5)
    reports = []
    estimated = splits.retrieve(
        spectrum, make_snow(100.0), {SIZE: (50.0, 1000.0)}, solver=PATHS, progress=reports.append
    )
    known = splits.retrieve(spectrum, make_snow(100.0), {SIZE: (50.0, 1000.0)}, noise, solver=PATHS)
    assert abs(estimated.values[SIZE] - 200.0) < 4.0 * estimated.stderr[SIZE]
    # Nine values determine their noise to 25 %, its correlation less accurately.
    assert 0.4 < estimated.stderr[SIZE] / known.stderr[SIZE] < 3.0
    assert reports[-1].target == pytest.approx(0.002)


def test_time_left_is_predicted_from_previous_runs(monkeypatch):
    """Predictions are proportional to costs on a clock that advances by one second per run."""
    clock, reports = [0.0], []
    monkeypatch.setattr("splits.retrieval.medium_model.time.perf_counter", lambda: clock[0])
    tracker = ProgressTracker(reports.append, 0.005, 2)
    for _ in range(4):
        report = tracker.track_run(0.01, 1)
        for completed in (0.5, 1.0):
            clock[0] += 0.5
            report(Progress(100, 0.01, 0.01, completed, 1.0 - completed))
    assert [progress.seconds + progress.seconds_left for progress in reports] == pytest.approx(
        [tracker.total_cost] * 8
    )
    assert reports[-1].seconds == 4.0 and reports[-1].target == 0.005
    # A run outside the plan reports its own time left.
    tracker.track_run(0.001, 10)
    tracker.track_run(0.01, 1)(Progress(100, 0.01, 0.01, 0.5, 0.25))
    assert reports[-1].seconds_left == 0.25


@NEEDS_JIT
def test_parameters_of_layers_can_be_free():
    def make_stack(depth):
        top = splits.Snow.natural(optical_radius_um=80, depth_m=depth)
        return splits.Stack([top, make_snow(600.0)])

    spectrum, noise = simulate_measurement(
        make_stack(0.01), 7, np.array([900.0, 1050.0, 1250.0]), 0.01
    )
    free = {"layers.0.depth_m": (0.002, 0.05)}
    result = splits.retrieve(
        spectrum, make_stack(0.004), free, noise, solver=PATHS, max_stderr=0.006
    )
    samples = np.log(result.dataset.draws.values[:, 0])
    assert abs(samples.mean() - np.log(0.01)) < 4.0 * samples.std()
    assert result.dataset.parameter_unit.values.tolist() == ["m"]


def test_linearized_model_is_linear():
    state_vector = make_medium_state_vector(
        make_snow(100.0), {SIZE: (50, 200), "scale": (0.5, 2.0)}, None, 0.0
    )
    model = LinearModel(
        state_vector, np.array([0.3, 0.6]), np.ones(3), np.arange(6.0).reshape(3, 2), np.eye(3)
    )
    state = np.array([0.4, 0.5])
    value, slopes = model.evaluate(state[np.newaxis])[0], np.arange(6.0).reshape(3, 2)
    np.testing.assert_allclose(value, 1.0 + slopes @ [0.1, -0.1])
    np.testing.assert_array_equal(model.jacobian(state), slopes)
    assert state_vector.transforms == ("logarithm", "identity")


def test_nonlinearity_is_measured_in_units_of_noise():
    """It is the quadratic term at one standard deviation in any direction, over the noise."""
    state_vector = make_medium_state_vector(
        make_snow(100.0), {SIZE: (50, 200), "scale": (0.5, 2.0)}, None, 0.0
    )
    state, spread, noise = np.array([0.4, 0.5]), np.array([0.1, 0.25]), np.array([0.02, 0.02, 0.01])
    model = LinearModel(state_vector, state, np.zeros(3), np.ones((3, 2)), np.zeros((3, 3)))

    def curved(states):
        x = states - state
        return x.sum(axis=1, keepdims=True) + np.array([0.0, 0.0, 3.0]) * x[:, :1] ** 2

    covariance = np.diag(spread**2), np.diag(noise**2)
    assert estimate_nonlinearity(curved, model, state, *covariance) == pytest.approx(
        3.0 * spread[0] ** 2 / noise[2]
    )
    assert estimate_nonlinearity(model.evaluate, model, state, *covariance) < 1e-12


INVALID = {
    "names alone": ({"free": [SIZE]}, r"free = .*a mapping of names to \(low, high\)"),
    "no such parameter": ({"free": {"depth": (1, 2)}}, "depth"),
    "no such medium": ({"free": {SIZE: (-5, 100)}}, rf"free\.{SIZE} = -5"),
    "contradictory": ({"free": {SIZE: (100, 50)}}, "low < high"),
    "one number": ({"free": {SIZE: 100}}, r"\(low, high\)"),
    "other axes": ({"fixed": {"depth_m": 1}}, "incidence_deg"),
    "an angle that is free": (
        {"free": {"incidence_deg": (0, 60)}, "fixed": {"sza": "diffuse"}},
        "fixed.sza.*left out, as it is free",
    ),
    "two angles": ({"fixed": {"sza": 10, "incidence_deg": 20}}, "left out, because"),
    "no medium": ({"model": 3}, "a Table, or a medium"),
    "error": ({"max_stderr": 0.9}, "max_stderr"),
    "per cent": ({"measured": (W, np.full(W.size, 50.0))}, "not per cent"),
    "transmittance": ({"quantity": "transmittance"}, "reflectance"),
}


@pytest.mark.parametrize("name", INVALID)
def test_invalid_input_is_rejected(name):
    changes, message = INVALID[name]
    arguments = {"measured": (W, np.full(W.size, 0.5)), "model": make_snow(100.0),
             "free": {SIZE: (50, 200)}, "noise": 0.01}  # fmt: skip
    with pytest.raises(InvalidValue, match=message):
        splits.retrieve(**(arguments | changes))
