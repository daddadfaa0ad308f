"""Retrievals: exact answers where available, coverage, results, and posteriors of a sampler."""

import emcee
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from formula_tables import W, evaluate_spectrum, make_snowlike_table, make_table
from scipy.stats import binom

import splits
from splits.core.validation import InvalidValue
from splits.retrieval.forward_model import TableModel, get_table_ranges
from splits.retrieval.measurement import Measurement
from splits.retrieval.optimal_estimation import (
    N_DRAWS,
    MAPEstimate,
    Solution,
)
from splits.retrieval.retrieve import list_warnings
from splits.retrieval.state_vector import ParameterRange, StateVector

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0}


@pytest.fixture(scope="module")
def table():
    return make_snowlike_table()


def make_model(table, free, fixed=FIXED, noise=0.01):
    measurement = Measurement.from_input((W, np.full(W.size, 0.5)), noise)
    state_vector = StateVector.from_ranges(free, None, get_table_ranges(table))
    return TableModel(table, measurement, state_vector, fixed)


def test_model_values_equal_table_interpolation(table):
    model = make_model(table, [SIZE, SOOT], {"incidence_deg": 20.0})
    states = np.random.default_rng(1).random((20, 2))
    values = model.evaluate(states)
    for state, row in zip(states, values, strict=True):
        size, soot = model.state_vector.to_physical(state)
        expected = table.interp(**{SIZE: size, SOOT: soot, "incidence_deg": 20.0})
        np.testing.assert_allclose(row, expected.reflectance, rtol=1e-9)


def test_jacobian_equals_finite_differences(table):
    model = make_model(table, [SIZE, SOOT, "scale"])
    state = np.array([0.31, 0.62, 0.4])
    slopes = model.jacobian(state)
    for i, step in enumerate(1e-6 * np.eye(3)):
        pair = model.evaluate(np.stack([state - step, state + step]))
        np.testing.assert_allclose(slopes[:, i], (pair[1] - pair[0]) / 2e-6, rtol=1e-5, atol=1e-8)


def test_linear_gaussian_case_matches_exact_solution():
    """A linear Gaussian problem has the closed-form solution of Rodgers (2000, chapter 2)."""
    slopes = np.stack([np.ones(W.size), np.linspace(-1.0, 1.0, W.size)])
    nodes = np.linspace(-1.0, 1.0, 6)
    linear = make_table(lambda a, b: 0.5 + 0.1 * (a * slopes[0] + b * slopes[1]),
                      {"a": nodes, "b": nodes}, 1e-8)  # fmt: skip
    noise, prior = 0.02, {"a": (0.1, 0.2), "b": (-0.1, 0.3)}
    measured = 0.5 + 0.1 * (0.2 * slopes[0] - 0.3 * slopes[1])
    result = splits.retrieve((W, measured), linear, ["a", "b"], noise, prior=prior)
    k = 0.1 * slopes.T
    fisher, prior_inverse = k.T @ k / noise**2, np.diag([1.0 / 0.2**2, 1.0 / 0.3**2])
    posterior = np.linalg.inv(fisher + prior_inverse)
    exact = posterior @ (fisher @ [0.2, -0.3] + prior_inverse @ [0.1, -0.1])
    ds = result.dataset
    np.testing.assert_allclose(ds.value, exact, atol=1e-6)
    kernel = (posterior @ fisher) * np.array([0.2, 0.3]) / np.array([[0.2], [0.3]])
    np.testing.assert_allclose(ds.averaging_kernel, kernel, atol=1e-6)
    assert ds.attrs["degrees_of_freedom"] == pytest.approx(np.trace(posterior @ fisher), rel=1e-5)
    bits = (
        0.5 * np.linalg.slogdet(np.eye(2) + fisher @ np.linalg.inv(prior_inverse))[1] / np.log(2.0)
    )
    assert ds.attrs["information_bits"] == pytest.approx(bits, rel=1e-5)
    # With 4000 samples the standard error of a standard deviation is 1 to 2 % of it, and that of
    # a mean 2 % of it.
    samples = ds.draws.values
    np.testing.assert_allclose(
        np.cov(samples, rowvar=False), posterior, atol=0.08 * posterior.max()
    )
    np.testing.assert_allclose(samples.mean(axis=0), exact, atol=0.08 * np.sqrt(posterior.max()))


def test_samples_follow_a_non_gaussian_posterior(table):
    """A soot content near the detection limit, compared with numerical integration."""
    measured = evaluate_spectrum(200.0, 3.0)
    result = splits.retrieve((W, measured), table, [SOOT], 0.01, fixed={**FIXED, SIZE: 200.0})
    model = make_model(table, [SOOT], {**FIXED, SIZE: 200.0})
    u = np.linspace(0.0, 1.0, 20_001)
    best = np.sqrt(result.dataset.value.values / 1600.0)
    misfit = model.evaluate(u[:, np.newaxis]) - measured
    covariance = model.measurement.covariance + model.error_covariance(best)
    chi2 = (misfit * np.linalg.solve(covariance, misfit.T).T).sum(axis=1)
    cumulative = np.cumsum(np.exp(-0.5 * (chi2 - chi2.min())))
    probabilities = result.dataset["quantile"].values
    coordinates = np.sqrt(result.dataset.quantiles.values[:, 0] / 1600.0)
    exact = np.interp(coordinates, u, cumulative / cumulative[-1])
    # Four binomial standard errors of the quantiles.
    n_samples = result.dataset.attrs["effective_sample_size"]
    assert (
        np.abs(exact - probabilities)
        < 4.0 * np.sqrt(probabilities * (1.0 - probabilities) / n_samples)
    ).all()


@pytest.mark.long
@NEEDS_JIT
def test_credible_intervals_cover_the_truth(table):
    random = np.random.default_rng(5)
    model = make_model(table, [SIZE, SOOT])
    n_covered = np.zeros((2, 2), dtype=int)
    misfits, n_fits = [], 200
    for seed in range(n_fits):
        size, soot = model.state_vector.to_physical(random.random(2))
        measured = evaluate_spectrum(size, soot) + 0.01 * random.standard_normal(W.size)
        result = splits.retrieve((W, measured), table, [SIZE, SOOT], 0.01, fixed=FIXED, seed=seed)
        quantiles = result.dataset.quantiles.values
        for row, (low, high) in enumerate(((1, 3), (0, 4))):
            n_covered[row] += (quantiles[low] <= [size, soot]) & ([size, soot] <= quantiles[high])
        misfits.append(result.dataset.attrs["chi2"])
    for row, probability in zip(n_covered, (0.68, 0.95), strict=True):
        low, high = binom.ppf([0.001, 0.999], n_fits, probability)
        assert (low <= row).all() and (row <= high).all()
    assert np.mean(misfits) == pytest.approx(W.size - 2, abs=4.0 * np.sqrt(2.0 * 9 / n_fits))


def test_table_batches_give_correlated_errors():
    """A fully correlated error of the spectral shape of soot does not average out."""
    plain = make_snowlike_table(stderr=0.004)
    shape = np.linspace(2.0, 0.5, W.size) * 0.004 / np.sqrt(32.0)
    dims = ("batch", *plain.dataset.reflectance.dims)
    size = tuple(plain.dataset.reflectance.shape)
    signs = np.where(np.arange(32) % 2, 1.0, -1.0).reshape(-1, *[1] * len(size))
    batches = (signs * np.broadcast_to(shape, size)).astype(np.float32)
    dataset = plain.dataset.assign(reflectance_batches=(dims, batches))
    model = make_model(splits.Table(dataset), [SIZE, SOOT], noise=0.001)
    # Between grid nodes, where the interpolation weights differ.
    covariance = model.error_covariance(np.array([0.4, 0.3]))
    expected = 32.0 * np.outer(shape, shape)
    off_diagonal = ~np.eye(W.size, dtype=bool)
    np.testing.assert_allclose(
        covariance[off_diagonal], expected[off_diagonal], rtol=0.02, atol=1e-7
    )
    assert (np.diag(covariance) >= 0.99 * np.maximum(np.diag(expected), 0.25 * 0.004**2)).all()


def test_unconstrained_parameters_are_reported(table):
    measured = (W, evaluate_spectrum(200.0, 50.0))
    result = splits.retrieve(measured, table, [SIZE, "incidence_deg"], 0.01, fixed={SOOT: 50.0})
    assert result.constrained == {SIZE: True, "incidence_deg": False}
    assert any(
        "not constrained by the measurement: incidence_deg" in line for line in result.warnings
    )
    assert "not constrained by the measurement" in repr(result)
    assert result.dataset.attrs["degrees_of_freedom"] == pytest.approx(1.0, abs=0.02)


def test_one_band_does_not_constrain_two_parameters(table):
    result = splits.retrieve(([600.0], evaluate_spectrum(200.0, 500.0, np.array([600.0]))), table,
                            [SIZE, SOOT], 0.01, fixed=FIXED)  # fmt: skip
    assert not all(result.constrained.values())


def test_a_misfit_enlarges_the_errors(table):
    bumpy = evaluate_spectrum(200.0, 50.0) * (1.0 + 0.1 * np.sin(W / 60.0))
    plain = splits.retrieve(
        (W, evaluate_spectrum(200.0, 50.0)), table, [SIZE], 0.005, fixed={**FIXED, SOOT: 50.0}
    )
    result = splits.retrieve((W, bumpy), table, [SIZE], 0.005, fixed={**FIXED, SOOT: 50.0})
    assert any("does not fit" in line for line in result.warnings)
    assert result.stderr[SIZE] > 3.0 * plain.stderr[SIZE]


@pytest.mark.long
def test_unknown_noise_is_estimated_from_the_misfit(table):
    """Stated errors match the deviations for noise with a correlation length of 100 nm."""
    random = np.random.default_rng(11)
    covariance = 0.01**2 * np.exp(-np.abs(W[:, np.newaxis] - W) / 100.0)
    factor = np.linalg.cholesky(covariance)
    deviations, stated = [], []
    for seed in range(100):
        measured = evaluate_spectrum(200.0, 50.0) + factor @ random.standard_normal(W.size)
        result = splits.retrieve(
            (W, measured), table, [SIZE], fixed={**FIXED, SOOT: 50.0}, seed=seed
        )
        log_sizes = np.log(result.dataset.draws.values[:, 0])
        deviations.append(log_sizes.mean() - np.log(200.0))
        stated.append(log_sizes.std())
    # The rms of 100 fits has a relative standard error of 7 %: three of these; with few values
    # the errors are overestimated.
    assert 0.6 < np.sqrt(np.mean((np.array(deviations) / np.array(stated)) ** 2)) < 1.21
    assert "as noise is not given" in repr(result)
    rmse = np.sqrt(np.mean((result.dataset.fitted - result.dataset.measured) ** 2))
    assert result.dataset.attrs["rmse"] == pytest.approx(float(rmse))


def test_priors_are_used_with_unknown_noise(table):
    measured = evaluate_spectrum(200.0, 50.0) + 0.01 * np.random.default_rng(12).standard_normal(
        W.size
    )
    free, fixed = [SIZE], {**FIXED, SOOT: 50.0}
    plain = splits.retrieve((W, measured), table, free, fixed=fixed)
    constrained = splits.retrieve(
        (W, measured), table, free, fixed=fixed, prior={SIZE: (300.0, 1.0)}
    )
    assert constrained.values[SIZE] == pytest.approx(300.0, abs=4.0)
    assert constrained.stderr[SIZE] < plain.stderr[SIZE]
    assert any("prior and measurement are" in line for line in constrained.warnings)


def test_too_few_values_do_not_determine_noise(table):
    with pytest.raises(InvalidValue, match=r"noise = None: must be given .*too few"):
        splits.retrieve(
            (W[:2], evaluate_spectrum(200.0, 50.0)[:2]), table, [SIZE], fixed={**FIXED, SOOT: 50.0}
        )


def test_a_prior_that_excludes_the_truth_is_reported(table):
    result = splits.retrieve((W, evaluate_spectrum(200.0, 50.0)), table, [SIZE], 0.01,
                             fixed={**FIXED, SOOT: 50.0}, prior={SIZE: (900.0, 30.0)})  # fmt: skip
    assert any("prior and measurement are" in line for line in result.warnings)


def test_a_solution_at_a_bound_is_reported(table):
    measured = (W, evaluate_spectrum(200.0, 50.0))
    result = splits.retrieve(
        measured, table, {SIZE: (50.0, 150.0)}, 0.01, fixed={**FIXED, SOOT: 50.0}
    )
    assert any("high end of its range, 150" in line for line in result.warnings)


def test_scale_factor_is_retrieved(table):
    measured = 1.12 * evaluate_spectrum(200.0, 50.0)
    result = splits.retrieve((W, measured), table, [SIZE, SOOT, "scale"], 0.002, fixed=FIXED)
    assert result.values["scale"] == pytest.approx(1.12, abs=4.0 * result.stderr["scale"])


def test_band_averages_are_retrieved(table):
    bands = {"red": (600, 700), "near infrared": (800, 900), "1240": (1200, 1300)}
    w = np.linspace(500.0, 1500.0, 1001)
    fine = evaluate_spectrum(300.0, 200.0, w)
    means = [fine[(w >= low) & (w <= high)].mean() for low, high in bands.values()]
    result = splits.retrieve(means, table, [SIZE, SOOT], 0.003, fixed=FIXED, bands=bands)
    assert result.values[SIZE] == pytest.approx(300.0, abs=4.0 * result.stderr[SIZE])


def test_all_spectrum_types_give_the_same_result(table):
    measured = evaluate_spectrum(200.0, 50.0)
    forms = [
        (W, measured),
        pd.Series(measured, index=W),
        pd.DataFrame({"reflectance": measured}, index=W),
        xr.DataArray(measured, {"wavelength": W}, "wavelength"),
    ]
    first, *others = (
        splits.retrieve(form, table, [SIZE], 0.01, fixed={**FIXED, SOOT: 50.0}) for form in forms
    )
    for other in others:
        xr.testing.assert_equal(other.dataset, first.dataset)


VALID_CALLS = (W, evaluate_spectrum(200.0, 50.0))
INVALID_CALLS = {
    "solver": ({"solver": "monte_carlo"}, "left out.*a table has its own spectra"),
    "gap": ({"measured": (W, np.where(W == 700.0, np.nan, 0.5))}, "1 gaps, the first at 700 nm"),
    "per cent": ({"measured": (W, 100.0 * VALID_CALLS[1])}, "not per cent"),
    "outside": ({"measured": ([400.0, 700.0], [0.5, 0.5])}, "500 to 1500"),
    "columns": (
        {"measured": pd.DataFrame({"a": VALID_CALLS[1], "b": VALID_CALLS[1]}, index=W)},
        "a DataFrame of 2 columns.*choose one",
    ),
    "noise elsewhere": (
        {"noise": pd.Series(0.01, index=W + 500.0)},
        "noise = .values at .*must be values at",
    ),
    "default index": ({"measured": pd.Series(VALID_CALLS[1])}, "default index.*index_col"),
    "texts": ({"measured": (W, ["dark"] * W.size)}, "measured = .*numbers"),
    "errors of errors": (
        {"noise": {"stderr": 1e-4 * np.eye(W.size), "correlation_nm": 100.0}},
        "one standard error or 11",
    ),
    "huge covariance": ({"noise": 10.0 * np.eye(W.size)}, "a variance of 10"),
    "two angles": ({"fixed": {**FIXED, "sza": 20.0}}, "left out, because"),
    "no noise": ({"noise": 0.0}, "no measurement is without noise"),
    "noise in per cent": ({"noise": 1}, "noise = 1.0: must be standard errors in .0, 1.*per cent"),
    "noise of counts": ({"noise": np.full(W.size, 300.0)}, "noise = 300.0.*of counts.*0.02 for 2"),
    "correlated per cent": (
        {"noise": {"stderr": 2.0, "correlation_nm": 50.0}},
        "noise.stderr = 2.0.*in per cent",
    ),
    "variances in per cent": (
        {"noise": 4.0 * np.eye(W.size)},
        "a variance of 4.*per cent",
    ),
    "noise of wrong length": ({"noise": np.full(W.size - 1, 0.01)}, "one or 11 of them"),
    "unknown": ({"free": ["optical_radius"]}, "did you mean"),
    "scale only": (
        {"free": ["scale"], "fixed": {**FIXED, SIZE: 100.0, SOOT: 10.0}},
        "at least one axis",
    ),
    "wide prior": ({"prior": {SIZE: (500.0, 5000.0)}}, "fits into the range"),
    "no free parameter": ({"free": []}, "names of parameters"),
    "reversed range": ({"free": {SIZE: (300.0, 200.0), SOOT: (0.0, 10.0)}}, "low < high"),
    "outside the table": ({"free": {SIZE: (10.0, 200.0), SOOT: (0.0, 10.0)}}, "40 <= low"),
    "angle left out": ({"fixed": {}}, "fixed.incidence_deg"),
    "free and given": ({"fixed": {**FIXED, SIZE: 100.0}}, "left out, as it is free"),
    "prior of an unknown parameter": ({"prior": {"depth_m": (1.0, 1.0)}}, "unknown key"),
    "prior outside": ({"prior": {SIZE: (5000.0, 10.0)}}, "a mean in the range"),
    "prior without spread": ({"prior": {SIZE: (500.0, 0.0)}}, "standard deviation above 0"),
    "no table": ({"model": 3}, "a Table"),
    "another quantity": ({"quantity": "transmittance"}, "reflectance"),
}


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_invalid_input_is_rejected_in_one_line(table, name):
    arguments, message = INVALID_CALLS[name]
    valid = {
        "measured": VALID_CALLS,
        "model": table,
        "free": [SIZE, SOOT],
        "noise": 0.01,
        "fixed": FIXED,
    }
    with pytest.raises(InvalidValue, match=message) as error:
        splits.retrieve(**(valid | arguments))
    assert "\n" not in str(error.value)


# --- settings, alternative solutions and messages -------------------------------------------------


@pytest.mark.parametrize("noise", [0.01, None])
def test_exact_spectra_are_retrieved_from_a_table(table, noise):
    measured = table.interp(**{SIZE: 200.0, SOOT: 50.0, **FIXED}).reflectance
    result = splits.retrieve(measured, table, [SIZE, SOOT], noise, fixed=FIXED)
    np.testing.assert_allclose(result.dataset.value, [200.0, 50.0], rtol=1e-3)


def test_results_state_their_settings(table, tmp_path):
    measured = W, evaluate_spectrum(200.0, 50.0)
    prior = {SIZE: (210.0, 30.0)}
    result = splits.retrieve(measured, table, {SIZE: (100, 400)}, 0.01, prior=prior, seed=3,
                             fixed={**FIXED, SOOT: 50.0})  # fmt: skip
    result.dataset.to_netcdf(tmp_path / "result.nc")
    with xr.open_dataset(tmp_path / "result.nc") as saved:
        attributes = saved.attrs
    assert (attributes["solver"], attributes["seed"]) == ("table", 3)
    assert attributes["fixed_incidence_deg"] == 30.0
    assert attributes[f"free_{SIZE}"].tolist() == [100.0, 400.0]
    assert attributes[f"prior_{SIZE}"].tolist() == [210.0, 30.0]
    assert f"fixed: {SOOT} 50, incidence_deg 30" in repr(result).splitlines()


MEDIUM = splits.Snow.natural(optical_radius_um=200.0)
MESSAGES = [
    (1e-3 * W, {SIZE: (50, 500)}, r"micrometres\? write"),
    (W, {SIZE: (50, 1e6)}, r"free.optical_radius_um = 1000000.0: must be in \[0\.\d+, \d+\.?\d*\]"),
    (W, [SIZE], r"must be a mapping of names to \(low, high\)"),
    (W, {"incidence": (10, 20)}, r"scale \(did you mean incidence_deg\?\)"),
]


@pytest.mark.parametrize(("wavelengths", "free", "message"), MESSAGES)
def test_messages_about_media(wavelengths, free, message):
    with pytest.raises(InvalidValue, match=message):
        splits.retrieve((wavelengths, np.full(W.size, 0.5)), MEDIUM, free, 0.01)


def make_solution(alternatives, spread):
    """Return a solution at 0.2 with other estimates, and draws with a spread."""
    draws = 0.2 + spread * np.random.default_rng(1).standard_normal((N_DRAWS, 1))
    covariance, none = np.array([[1e-4]]), np.zeros(1)
    estimates = [
        MAPEstimate(np.array([x]), none, covariance, covariance, 0.0, 0.0, np.array([False]))
        for x in (0.2, *alternatives[:1])
    ]
    return Solution(estimates, draws, 4000.0, covariance, np.eye(1), 1.0, none, none,
                    tuple(np.array([x]) for x in alternatives))  # fmt: skip


@pytest.mark.parametrize(("spread", "is_covered"), [(0.01, False), (0.3, True)])
def test_similar_alternatives_are_listed_once(spread, is_covered):
    state_vector = StateVector.from_ranges(
        {"a": (0.0, 1.0)}, None, {"a": ParameterRange(0.0, 1.0, "identity")}
    )
    solution = make_solution([0.8, 0.81, 0.21, 0.6], spread)
    warnings = [
        one for one in list_warnings(state_vector, solution, np.array([True])) if "alter" in one
    ]
    assert [one[-3:] for one in warnings] == ["0.8", "0.6"]
    assert all(("draws do not cover it" in one) != is_covered for one in warnings)


# --- posterior samples against an MCMC sampler ----------------------------------------------------


N_WALKERS, N_STEPS, N_BURN_IN = 32, 3000, 500


@NEEDS_JIT
def test_quantiles_match_an_ensemble_sampler():
    """Scale, size and soot are correlated for visible wavelengths and a noise of 5 %."""
    w, table = W[:4], make_snowlike_table()
    measured, names = evaluate_spectrum(300.0, 20.0, w), [SIZE, SOOT, "scale"]
    ranges = {SIZE: (40.0, 2000.0), SOOT: (0.0, 1600.0), "scale": (0.8, 1.2)}
    result = splits.retrieve((w, measured), table, ranges, 0.05, fixed=FIXED)
    measurement = Measurement.from_input((w, measured), 0.05)
    model = TableModel(
        table, measurement, StateVector.from_ranges(ranges, None, get_table_ranges(table)), FIXED
    )
    best = model.state_vector.to_coordinates(result.dataset.value.values)
    covariance = measurement.covariance + model.error_covariance(best)
    lower = np.linalg.cholesky(covariance)

    def compute_log_probability(states):
        inside = ((states >= 0.0) & (states <= 1.0)).all(axis=1)
        misfit = model.evaluate(np.clip(states, 0.0, 1.0)) - measured
        log_probability = -0.5 * (np.linalg.solve(lower, misfit.T) ** 2).sum(axis=0)
        return np.where(inside, log_probability, -np.inf)

    sampler = emcee.EnsembleSampler(N_WALKERS, len(names), compute_log_probability, vectorize=True)
    sampler._random.seed(1)
    start = np.random.default_rng(1).random((N_WALKERS, len(names)))
    sampler.run_mcmc(start, N_STEPS)
    chain = sampler.get_chain(discard=N_BURN_IN)
    autocorrelation_time = sampler.get_autocorr_time(discard=N_BURN_IN, tol=0)
    states = model.state_vector.to_coordinates(result.dataset.draws.values)
    for i in range(len(names)):
        for probability in (0.16, 0.5, 0.84):
            quantile = np.quantile(chain[:, :, i], probability)
            fraction = float((states[:, i] <= quantile).mean())
            n_effective = 1.0 / (
                1.0 / result.dataset.attrs["effective_sample_size"]
                + autocorrelation_time[i] / (N_WALKERS * (N_STEPS - N_BURN_IN))
            )
            assert abs(fraction - probability) < 4.0 * np.sqrt(
                probability * (1.0 - probability) / n_effective
            ), names[i]
