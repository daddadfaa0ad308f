"""Difficult retrievals: local minima, bounds, priors, noisy Jacobians."""

from __future__ import annotations

import numpy as np
import pytest
from formula_tables import W, evaluate_spectrum, make_snowlike_table, make_table
from scipy.stats import binom, f

import splits
from splits.retrieval.gauss_newton import Objective, minimize_gauss_newton
from splits.retrieval.linearization import is_jacobian_noisy, remove_jacobian_noise
from splits.retrieval.state_vector import ParameterRange, StateVector

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0}
STEEP_SLOPE = np.linspace(0.5, 1.5, W.size)


@pytest.fixture(scope="module")
def table():
    return make_snowlike_table()


def make_unit_state(*names):
    """Return what is free where coordinates are the values themselves."""
    return StateVector.from_ranges(
        list(names), None, {name: ParameterRange(0.0, 1.0, "itself") for name in names}
    )


def test_a_minimum_of_larger_variance_is_no_better():
    """Two valleys, both 0.1 from the middle; in the wrong one cells are known 100 times worse."""
    nodes = np.linspace(0.0, 1.0, 21)
    # Wrong by a slope, so that noise of cells explains it there.
    off = 0.02 * np.linspace(-1.0, 1.0, W.size)
    plain = make_table(lambda a: 0.5 + (a - 0.5) ** 2 + off * (a < 0.5), {"a": nodes}, 0.001)
    stderr = np.where(nodes < 0.5, 0.1, 0.001)[:, np.newaxis] + np.zeros(W.size)
    worse = plain.dataset.assign(
        reflectance_stderr=(("a", "wavelength"), stderr.astype(np.float32))
    )
    random = np.random.default_rng(8)
    for _ in range(10):
        measured = 0.5 + 0.3**2 + 0.003 * random.standard_normal(W.size)
        found = splits.retrieve((W, measured), splits.Table(worse), ["a"], 0.003)
        assert found.dataset.value.values[0] == pytest.approx(0.8, abs=0.02)
        assert found.dataset.quantiles.values[1:4, 0] == pytest.approx([0.8] * 3, abs=0.02)


def test_spurious_information_of_noisy_jacobians_is_removed():
    """One coordinate is told, one does nothing; slopes are known to 0.3 of those of the first."""
    random = np.random.default_rng(3)
    slopes = np.stack([STEEP_SLOPE, np.zeros(W.size)], axis=1)
    noise = 0.01 * np.eye(W.size)
    information, feigned = [], []
    for _ in range(200):
        jacobians = [slopes + 0.3 * random.standard_normal(slopes.shape) for _ in range(4)]
        clean, plain = remove_jacobian_noise(jacobians, noise), np.mean(jacobians, axis=0)
        information.append(clean.T @ np.linalg.solve(noise, clean))
        feigned.append((plain.T @ np.linalg.solve(noise, plain))[1, 1])
    exact = float(STEEP_SLOPE @ STEEP_SLOPE) / 0.01
    found = np.array(information)
    spread = found[:, 0, 0].std(ddof=1) / np.sqrt(len(found))
    assert abs(found[:, 0, 0].mean() - exact) < 4.0 * spread
    # As the range knows 12, what is feigned would make its spread 0.6 of that before.
    left = [np.sqrt(12.0 / (12.0 + one)).mean() for one in (np.array(feigned), found[:, 1, 1])]
    assert left[0] < 0.65 and left[1] > 0.9


def test_noise_of_jacobians_is_no_information():
    """Of what does nothing, seen by six Jacobians whose noise is far beyond that of the values."""
    random = np.random.default_rng(9)
    noise = 1e-6 * np.eye(W.size)
    told = 0
    for _ in range(200):
        # Alike in three parts of the spectrum, as runs that share rays are.
        scatter = np.repeat(random.standard_normal((6, 3, 1)), 4, axis=1)[:, : W.size]
        clean = remove_jacobian_noise(list(scatter), noise)
        told += bool((clean.T @ np.linalg.solve(noise, clean) > 36.0).any())
    # F(3, 15) is above 7 with a probability of 0.0036; binomial bound of 0.1 %.
    assert told <= binom.isf(0.001, 200, f.sf(7.0, 3, 15))


def test_more_jacobians_are_asked_for_only_where_noise_decides():
    noise, random = 1e-4 * np.eye(W.size), np.random.default_rng(4)
    told, nothing = STEEP_SLOPE[:, np.newaxis], np.zeros((W.size, 1))
    scatter = random.standard_normal((2, W.size, 1))
    assert not is_jacobian_noisy([told + 0.01 * one for one in scatter], noise)
    assert not is_jacobian_noisy([nothing + 1e-3 * one for one in scatter], noise)
    assert is_jacobian_noisy([nothing + 0.03 * one for one in scatter], noise)


def test_slopes_without_noise_stay_as_they_are():
    slopes = np.stack([STEEP_SLOPE, STEEP_SLOPE**2, np.zeros(W.size)], axis=1)
    clean = remove_jacobian_noise([slopes, slopes], np.diag(0.01 * STEEP_SLOPE))
    np.testing.assert_allclose(clean, slopes, atol=1e-9)


@pytest.mark.parametrize("wavelengths", [[1200.0], [1000.0, 1200.0]])
def test_a_large_misfit_is_reported_for_as_few_values_as_parameters(table, wavelengths):
    w = np.array(wavelengths)
    free = [SIZE, SOOT][: w.size]
    at = FIXED if w.size > 1 else {**FIXED, SOOT: 50.0}
    found = splits.retrieve((w, np.full(w.size, 1.5)), table, free, 0.01, fixed=at)
    assert any("does not fit" in line for line in found.warnings)


def test_a_prior_of_a_hardly_constrained_parameter_contradicts_nothing():
    """One prior is wrong; the other, of what the measurement hardly tells, is right."""
    rows = np.stack([np.ones(W.size), 0.02 * np.linspace(-1.0, 1.0, W.size)])
    nodes = np.linspace(-1.0, 1.0, 6)
    linear = make_table(lambda a, b: 0.5 + 0.1 * (a * rows[0] + b * rows[1]),
                      {"a": nodes, "b": nodes}, 1e-8)  # fmt: skip
    random = np.random.default_rng(5)
    for _ in range(6):
        measured = 0.5 + 0.1 * 0.5 * rows[0] + 0.01 * random.standard_normal(W.size)
        found = splits.retrieve((W, measured), linear, ["a", "b"], 0.01,
                                prior={"a": (-0.5, 0.05), "b": (0.0, 0.05)})  # fmt: skip
        said = [line for line in found.warnings if "standard deviations apart" in line]
        assert len(said) == 1 and said[0].startswith("a:")


def test_least_squares_account_for_active_bounds(table):
    """A range that excludes the truth leaves a misfit that counts as one, and in the errors."""
    measured = evaluate_spectrum(400.0, 50.0) + 0.002 * np.random.default_rng(6).standard_normal(
        W.size
    )
    free, at = {SIZE: (50.0, 150.0)}, {**FIXED, SOOT: 50.0}
    found = splits.retrieve((W, measured), table, free, fixed=at)
    about = found.dataset.attrs
    assert about["chi2"] < 3.0 * about["chi2_expected"]
    assert about["chi2_expected"] == W.size
    assert any("lies at the high end" in line for line in found.warnings)


def test_parameters_without_effect_give_no_alternative(table):
    found = splits.retrieve((W, evaluate_spectrum(200.0, 50.0)), table, [SIZE, "incidence_deg"],
                            fixed={SOOT: 50.0})  # fmt: skip
    assert not any("another answer" in line for line in found.warnings)


class LinearModel:
    """Runs of a straight line without noise of their own."""

    bound_margin = 0.0

    def __init__(self, slopes):
        self.slopes_, self.state_vector = (
            slopes,
            make_unit_state(*(f"x{i}" for i in range(slopes.shape[1]))),
        )

    def evaluate(self, state, stage):
        return self.slopes_ @ state + 0.3 * (state**2).sum()

    def compute_jacobian(self, state, stage):
        return self.slopes_ + 0.6 * state


def test_descents_of_many_values_end_near_the_optimum():
    """Within half a standard error of independent noise, of 1001 values as of 11."""
    random = np.random.default_rng(7)
    for count in (11, 1001):
        x = np.linspace(0.0, 1.0, count)
        runs = LinearModel(np.stack([np.ones(count), x], axis=1))
        truth = np.array([0.4, 0.6])
        wanted = runs.evaluate(truth, 1) + 0.02 * random.standard_normal(count)
        aim = Objective.least_squares(wanted, runs.state_vector)
        rough = minimize_gauss_newton(runs, 1, np.array([0.5, 0.4]), aim, 60, 0.3)
        exact = rough.state.copy()
        for _ in range(20):
            exact += np.linalg.lstsq(
                runs.compute_jacobian(exact, 1), wanted - runs.evaluate(exact, 1)
            )[0]
        slopes = runs.compute_jacobian(exact, 1)
        off = slopes @ (rough.state - exact)
        assert np.sqrt(off @ off) < 0.5 * 0.02
