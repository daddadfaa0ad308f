"""Difficult retrievals: local minima, bounds, priors, noisy Jacobians."""

import numpy as np
import pytest
from formula_tables import W, evaluate_spectrum, make_snowlike_table, make_table
from scipy.stats import binom, f

import splits
from splits.retrieval.linearization import (
    is_jacobian_noisy,
    minimize_gauss_newton,
    remove_jacobian_noise,
)
from splits.retrieval.optimal_estimation import Objective
from splits.retrieval.state_vector import ParameterRange, StateVector

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0}
STEEP_SLOPE = np.linspace(0.5, 1.5, W.size)


@pytest.fixture(scope="module")
def table():
    return make_snowlike_table()


def make_unit_state(*names):
    """Return a state vector whose coordinates equal the physical values."""
    return StateVector.from_ranges(
        list(names), None, {name: ParameterRange(0.0, 1.0, "identity") for name in names}
    )


def test_larger_table_errors_do_not_attract_the_solution():
    """Of two minima the wrong one has table errors 100 times larger."""
    nodes = np.linspace(0.0, 1.0, 21)
    # The wrong minimum misfits by a slope that the table errors there could explain.
    error = 0.02 * np.linspace(-1.0, 1.0, W.size)
    plain = make_table(lambda a: 0.5 + (a - 0.5) ** 2 + error * (a < 0.5), {"a": nodes}, 0.001)
    stderr = np.where(nodes < 0.5, 0.1, 0.001)[:, np.newaxis] + np.zeros(W.size)
    dataset = plain.dataset.assign(
        reflectance_stderr=(("a", "wavelength"), stderr.astype(np.float32))
    )
    random = np.random.default_rng(8)
    for _ in range(10):
        measured = 0.5 + 0.3**2 + 0.003 * random.standard_normal(W.size)
        result = splits.retrieve((W, measured), splits.Table(dataset), ["a"], 0.003)
        assert result.dataset.value.values[0] == pytest.approx(0.8, abs=0.02)
        assert result.dataset.quantiles.values[1:4, 0] == pytest.approx([0.8] * 3, abs=0.02)


def test_spurious_information_of_noisy_jacobians_is_removed():
    """Of two coordinates one has no effect; the relative error of the derivatives is 0.3."""
    random = np.random.default_rng(3)
    slopes = np.stack([STEEP_SLOPE, np.zeros(W.size)], axis=1)
    noise = 0.01 * np.eye(W.size)
    information, spurious = [], []
    for _ in range(200):
        jacobians = [slopes + 0.3 * random.standard_normal(slopes.shape) for _ in range(4)]
        clean, plain = remove_jacobian_noise(jacobians, noise), np.mean(jacobians, axis=0)
        information.append(clean.T @ np.linalg.solve(noise, clean))
        spurious.append((plain.T @ np.linalg.solve(noise, plain))[1, 1])
    exact = float(STEEP_SLOPE @ STEEP_SLOPE) / 0.01
    cleaned = np.array(information)
    stderr = cleaned[:, 0, 0].std(ddof=1) / np.sqrt(len(cleaned))
    assert abs(cleaned[:, 0, 0].mean() - exact) < 4.0 * stderr
    # The range alone has an information of 12; the spurious one would reduce the spread to 0.6.
    relative_spreads = [
        np.sqrt(12.0 / (12.0 + information_of_second)).mean()
        for information_of_second in (np.array(spurious), cleaned[:, 1, 1])
    ]
    assert relative_spreads[0] < 0.65 and relative_spreads[1] > 0.9


def test_jacobian_noise_carries_no_information():
    """A coordinate without effect in six Jacobians much noisier than the values."""
    random = np.random.default_rng(9)
    noise = 1e-6 * np.eye(W.size)
    n_informative = 0
    for _ in range(200):
        # Correlated within three parts of the spectrum, as for runs that use the same rays.
        jacobians = np.repeat(random.standard_normal((6, 3, 1)), 4, axis=1)[:, : W.size]
        clean = remove_jacobian_noise(list(jacobians), noise)
        n_informative += bool((clean.T @ np.linalg.solve(noise, clean) > 36.0).any())
    # F(3, 15) is above 7 with a probability of 0.0036; binomial bound of 0.1 %.
    assert n_informative <= binom.isf(0.001, 200, f.sf(7.0, 3, 15))


def test_jacobian_is_noisy_only_if_noise_matters():
    noise, random = 1e-4 * np.eye(W.size), np.random.default_rng(4)
    strong, zero = STEEP_SLOPE[:, np.newaxis], np.zeros((W.size, 1))
    errors = random.standard_normal((2, W.size, 1))
    assert not is_jacobian_noisy([strong + 0.01 * error for error in errors], noise)
    assert not is_jacobian_noisy([zero + 1e-3 * error for error in errors], noise)
    assert is_jacobian_noisy([zero + 0.03 * error for error in errors], noise)


def test_noise_free_jacobians_are_unchanged():
    slopes = np.stack([STEEP_SLOPE, STEEP_SLOPE**2, np.zeros(W.size)], axis=1)
    clean = remove_jacobian_noise([slopes, slopes], np.diag(0.01 * STEEP_SLOPE))
    np.testing.assert_allclose(clean, slopes, atol=1e-9)


@pytest.mark.parametrize("wavelengths", [[1200.0], [1000.0, 1200.0]])
def test_large_misfit_is_reported_without_degrees_of_freedom(table, wavelengths):
    w = np.array(wavelengths)
    free = [SIZE, SOOT][: w.size]
    fixed = FIXED if w.size > 1 else {**FIXED, SOOT: 50.0}
    result = splits.retrieve((w, np.full(w.size, 1.5)), table, free, 0.01, fixed=fixed)
    assert any("does not fit" in line for line in result.warnings)


def test_prior_of_an_unconstrained_parameter_is_no_contradiction():
    """Only the wrong prior is reported, not the one of the weakly constrained parameter."""
    rows = np.stack([np.ones(W.size), 0.02 * np.linspace(-1.0, 1.0, W.size)])
    nodes = np.linspace(-1.0, 1.0, 6)
    linear = make_table(lambda a, b: 0.5 + 0.1 * (a * rows[0] + b * rows[1]),
                      {"a": nodes, "b": nodes}, 1e-8)  # fmt: skip
    random = np.random.default_rng(5)
    for _ in range(6):
        measured = 0.5 + 0.1 * 0.5 * rows[0] + 0.01 * random.standard_normal(W.size)
        result = splits.retrieve((W, measured), linear, ["a", "b"], 0.01,
                                prior={"a": (-0.5, 0.05), "b": (0.0, 0.05)})  # fmt: skip
        warnings = [line for line in result.warnings if "standard deviations apart" in line]
        assert len(warnings) == 1 and warnings[0].startswith("a:")


def test_least_squares_account_for_active_bounds(table):
    """A range that excludes the truth leaves a misfit that enters the errors."""
    measured = evaluate_spectrum(400.0, 50.0) + 0.002 * np.random.default_rng(6).standard_normal(
        W.size
    )
    free, fixed = {SIZE: (50.0, 150.0)}, {**FIXED, SOOT: 50.0}
    result = splits.retrieve((W, measured), table, free, fixed=fixed)
    attributes = result.dataset.attrs
    assert attributes["chi2"] < 3.0 * attributes["chi2_expected"]
    assert attributes["chi2_expected"] == W.size
    assert any("lies at the high end" in line for line in result.warnings)


def test_parameters_without_effect_give_no_alternative(table):
    result = splits.retrieve((W, evaluate_spectrum(200.0, 50.0)), table, [SIZE, "incidence_deg"],
                            fixed={SOOT: 50.0})  # fmt: skip
    assert not any("another answer" in line for line in result.warnings)


class LinearModel:
    """A quadratic forward model without noise of its own."""

    def __init__(self, slopes):
        self.slopes_ = slopes

    def evaluate(self, state):
        return self.slopes_ @ state + 0.3 * (state**2).sum()

    def compute_jacobian(self, state):
        return self.slopes_ + 0.6 * state


def test_gauss_newton_converges_for_any_number_of_values():
    """The fit is within half a standard error of the optimum for 11 and for 1001 values."""
    random = np.random.default_rng(7)
    for n_values in (11, 1001):
        x = np.linspace(0.0, 1.0, n_values)
        model = LinearModel(np.stack([np.ones(n_values), x], axis=1))
        truth = np.array([0.4, 0.6])
        target = model.evaluate(truth) + 0.02 * random.standard_normal(n_values)
        objective = Objective(target, np.eye(n_values), make_unit_state("x0", "x1"))
        _, state = minimize_gauss_newton(
            model.evaluate, model.compute_jacobian, np.array([0.5, 0.4]), objective, 60, 0.3
        )
        exact = state.copy()
        for _ in range(20):
            exact += np.linalg.lstsq(model.compute_jacobian(exact), target - model.evaluate(exact))[
                0
            ]
        slopes = model.compute_jacobian(exact)
        difference = slopes @ (state - exact)
        assert np.sqrt(difference @ difference) < 0.5 * 0.02


def evaluate_smooth_spectrum(x):
    """Return a nonlinear spectrum of three coordinates, the last of which has no effect."""
    t = np.linspace(0.0, 1.0, 12)
    return np.exp(-(x[0] ** 2) * t) + 0.5 * x[1] * t**2


@pytest.mark.parametrize("truth", [(0.4, 0.7), (0.9, 0.0), (1.0, 1.0)])
def test_gauss_newton_finds_minima_at_bounds(truth):
    target = evaluate_smooth_spectrum(np.array([*truth, 0.0]))
    calls = []

    def evaluate(state):
        calls.append(state)
        assert (state >= 0.0).all() and (state <= 1.0).all()
        return evaluate_smooth_spectrum(state)

    def compute_jacobian(state):
        columns = []
        for shift in 0.1 * np.eye(3):
            low, high = np.clip(state - shift, 0.0, 1.0), np.clip(state + shift, 0.0, 1.0)
            columns.append((evaluate(high) - evaluate(low)) / (high - low).sum())
        return np.column_stack(columns)

    objective = Objective(target, np.eye(target.size), make_unit_state("a", "b", "c"))
    cost, state = minimize_gauss_newton(
        evaluate, compute_jacobian, np.full(3, 0.5), objective, 60, 0.3
    )
    assert np.sqrt(cost / len(target)) < 1e-3
    assert len(calls) < 100
    np.testing.assert_allclose(state[:2], truth, atol=0.02)
