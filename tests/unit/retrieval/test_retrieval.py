"""Retrievals: exact answers where available, coverage, and unconstrained parameters."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from formula_tables import W, evaluate_spectrum, make_snowlike_table, make_table
from scipy.stats import binom

import splits
from splits.core.validation import InvalidValue
from splits.retrieval.forward_model import TableForwardModel, get_table_ranges
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import StateVector

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0}


@pytest.fixture(scope="module")
def table():
    return make_snowlike_table()


def make_model(table, free, at=FIXED, noise=0.01):
    measurement = Measurement.from_input((W, np.full(W.size, 0.5)), noise)
    which = StateVector.from_ranges(free, None, get_table_ranges(table))
    return TableForwardModel(table, measurement, which, at)


def test_values_are_those_of_the_table(table):
    model = make_model(table, [SIZE, SOOT], {"incidence_deg": 20.0})
    places = np.random.default_rng(1).random((20, 2))
    found = model.evaluate(places)
    for place, row in zip(places, found, strict=True):
        size, dirt = model.state_vector.to_physical(place)
        there = table.interp(**{SIZE: size, SOOT: dirt, "incidence_deg": 20.0})
        np.testing.assert_allclose(row, there.reflectance, rtol=1e-9)


def test_slopes_are_those_of_the_values(table):
    model = make_model(table, [SIZE, SOOT, "scale"])
    place = np.array([0.31, 0.62, 0.4])
    values, slopes = model.evaluate_with_jacobian(place)
    np.testing.assert_allclose(values, model.evaluate(place[np.newaxis])[0])
    for i, step in enumerate(1e-6 * np.eye(3)):
        both = model.evaluate(np.stack([place - step, place + step]))
        np.testing.assert_allclose(slopes[:, i], (both[1] - both[0]) / 2e-6, rtol=1e-5, atol=1e-8)


def test_linear_models_have_the_exact_answer():
    """Where all is linear and normal, the textbook's formulas hold (Rodgers 2000, chapter 2)."""
    rows = np.stack([np.ones(W.size), np.linspace(-1.0, 1.0, W.size)])
    nodes = np.linspace(-1.0, 1.0, 6)
    linear = make_table(lambda a, b: 0.5 + 0.1 * (a * rows[0] + b * rows[1]),
                      {"a": nodes, "b": nodes}, 1e-8)  # fmt: skip
    noise, prior = 0.02, {"a": (0.1, 0.2), "b": (-0.1, 0.3)}
    measured = 0.5 + 0.1 * (0.2 * rows[0] - 0.3 * rows[1])
    found = splits.retrieve((W, measured), linear, ["a", "b"], noise, prior=prior)
    k = 0.1 * rows.T
    fisher, before = k.T @ k / noise**2, np.diag([1.0 / 0.2**2, 1.0 / 0.3**2])
    after = np.linalg.inv(fisher + before)
    exact = after @ (fisher @ [0.2, -0.3] + before @ [0.1, -0.1])
    ds = found.dataset
    np.testing.assert_allclose(ds.value, exact, atol=1e-6)
    kernel = (after @ fisher) * np.array([0.2, 0.3]) / np.array([[0.2], [0.3]])
    np.testing.assert_allclose(ds.averaging_kernel, kernel, atol=1e-6)
    assert ds.attrs["degrees_of_freedom"] == pytest.approx(np.trace(after @ fisher), rel=1e-5)
    bits = 0.5 * np.linalg.slogdet(np.eye(2) + fisher @ np.linalg.inv(before))[1] / np.log(2.0)
    assert ds.attrs["information_bits"] == pytest.approx(bits, rel=1e-5)
    # Of 4000 draws, a spread is known to 1 to 2 %, a mean to 2 % of it.
    draws = ds.draws.values
    np.testing.assert_allclose(np.cov(draws, rowvar=False), after, atol=0.08 * after.max())
    np.testing.assert_allclose(draws.mean(axis=0), exact, atol=0.08 * np.sqrt(after.max()))


def test_draws_follow_a_posterior_that_is_not_normal(table):
    """Little dirt, which the measurement hardly tells from none, against integration."""
    measured = evaluate_spectrum(200.0, 3.0)
    found = splits.retrieve((W, measured), table, [SOOT], 0.01, fixed={**FIXED, SIZE: 200.0})
    model = make_model(table, [SOOT], {**FIXED, SIZE: 200.0})
    u = np.linspace(0.0, 1.0, 20_001)
    best = np.sqrt(found.dataset.value.values / 1600.0)
    off = model.evaluate(u[:, np.newaxis]) - measured
    covariance = model.measurement.covariance + model.compute_error_covariance(best)
    chi2 = (off * np.linalg.solve(covariance, off.T).T).sum(axis=1)
    height = np.cumsum(np.exp(-0.5 * (chi2 - chi2.min())))
    shares = found.dataset["quantile"].values
    places = np.sqrt(found.dataset.quantiles.values[:, 0] / 1600.0)
    exact = np.interp(places, u, height / height[-1])
    # Quantiles of so many draws, by four standard errors.
    many = found.dataset.attrs["effective_sample_size"]
    assert (np.abs(exact - shares) < 4.0 * np.sqrt(shares * (1.0 - shares) / many)).all()


@NEEDS_JIT
def test_errors_cover_the_truth(table):
    random = np.random.default_rng(5)
    model = make_model(table, [SIZE, SOOT])
    inside = np.zeros((2, 2), dtype=int)
    misfits, many = [], 200
    for number in range(many):
        size, dirt = model.state_vector.to_physical(random.random(2))
        measured = evaluate_spectrum(size, dirt) + 0.01 * random.standard_normal(W.size)
        found = splits.retrieve((W, measured), table, [SIZE, SOOT], 0.01, fixed=FIXED, seed=number)
        quantiles = found.dataset.quantiles.values
        for row, (low, high) in enumerate(((1, 3), (0, 4))):
            inside[row] += (quantiles[low] <= [size, dirt]) & ([size, dirt] <= quantiles[high])
        misfits.append(found.dataset.attrs["chi2"])
    for row, share in zip(inside, (0.68, 0.95), strict=True):
        low, high = binom.ppf([0.001, 0.999], many, share)
        assert (low <= row).all() and (row <= high).all()
    assert np.mean(misfits) == pytest.approx(W.size - 2, abs=4.0 * np.sqrt(2.0 * 9 / many))


def test_a_table_with_covariance_gives_the_correlations():
    """One error at all wavelengths, of the shape of dirt, does not average away."""
    plain = make_snowlike_table(stderr=0.004)
    shape = np.linspace(2.0, 0.5, W.size) * 0.004 / np.sqrt(32.0)
    dims = ("batch", *plain.dataset.reflectance.dims)
    size = tuple(plain.dataset.reflectance.shape)
    signs = np.where(np.arange(32) % 2, 1.0, -1.0).reshape(-1, *[1] * len(size))
    groups = (signs * np.broadcast_to(shape, size)).astype(np.float32)
    both = plain.dataset.assign(reflectance_batches=(dims, groups))
    model = make_model(splits.Table(both), [SIZE, SOOT], noise=0.001)
    # In the middle of a cell, where weights of nodes are not all the same.
    found = model.compute_error_covariance(np.array([0.4, 0.3]))
    alike = 32.0 * np.outer(shape, shape)
    off = ~np.eye(W.size, dtype=bool)
    np.testing.assert_allclose(found[off], alike[off], rtol=0.02, atol=1e-7)
    assert (np.diag(found) >= 0.99 * np.maximum(np.diag(alike), 0.25 * 0.004**2)).all()


def test_unconstrained_parameters_are_reported(table):
    measured = (W, evaluate_spectrum(200.0, 50.0))
    found = splits.retrieve(measured, table, [SIZE, "incidence_deg"], 0.01, fixed={SOOT: 50.0})
    assert found.constrained == {SIZE: True, "incidence_deg": False}
    assert any(
        "not constrained by the measurement: incidence_deg" in line for line in found.warnings
    )
    assert "not constrained by the measurement" in repr(found)
    assert found.dataset.attrs["degrees_of_freedom"] == pytest.approx(1.0, abs=0.02)


def test_one_band_does_not_constrain_two_parameters(table):
    found = splits.retrieve(([600.0], evaluate_spectrum(200.0, 500.0, np.array([600.0]))), table,
                            [SIZE, SOOT], 0.01, fixed=FIXED)  # fmt: skip
    assert not all(found.constrained.values())


def test_a_misfit_enlarges_the_errors(table):
    bumpy = evaluate_spectrum(200.0, 50.0) * (1.0 + 0.1 * np.sin(W / 60.0))
    plain = splits.retrieve(
        (W, evaluate_spectrum(200.0, 50.0)), table, [SIZE], 0.005, fixed={**FIXED, SOOT: 50.0}
    )
    found = splits.retrieve((W, bumpy), table, [SIZE], 0.005, fixed={**FIXED, SOOT: 50.0})
    assert any("does not fit" in line for line in found.warnings)
    assert found.stderr[SIZE] > 3.0 * plain.stderr[SIZE]


def test_unknown_noise_is_found_from_the_misfit(table):
    """Least squares, off by what their errors say, with noise that is alike over 100 nm."""
    random = np.random.default_rng(11)
    alike = 0.01**2 * np.exp(-np.abs(W[:, np.newaxis] - W) / 100.0)
    factor = np.linalg.cholesky(alike)
    off, stated = [], []
    for number in range(100):
        measured = evaluate_spectrum(200.0, 50.0) + factor @ random.standard_normal(W.size)
        found = splits.retrieve(
            (W, measured), table, [SIZE], fixed={**FIXED, SOOT: 50.0}, seed=number
        )
        own = np.log(found.dataset.draws.values[:, 0])
        off.append(own.mean() - np.log(200.0))
        stated.append(own.std())
    # 100 fits know an rms to 7 %: three of these; from few values errors are rather too large.
    assert 0.6 < np.sqrt(np.mean((np.array(off) / np.array(stated)) ** 2)) < 1.21
    assert "as noise is not given" in repr(found)
    least = np.sqrt(np.mean((found.dataset.fitted - found.dataset.measured) ** 2))
    assert found.dataset.attrs["rmse"] == pytest.approx(float(least))


def test_priors_count_for_unknown_noise(table):
    measured = evaluate_spectrum(200.0, 50.0) + 0.01 * np.random.default_rng(12).standard_normal(
        W.size
    )
    free, at = [SIZE], {**FIXED, SOOT: 50.0}
    plain = splits.retrieve((W, measured), table, free, fixed=at)
    held = splits.retrieve((W, measured), table, free, fixed=at, prior={SIZE: (300.0, 1.0)})
    assert held.values[SIZE] == pytest.approx(300.0, abs=4.0)
    assert held.stderr[SIZE] < plain.stderr[SIZE]
    assert any("prior and measurement are" in line for line in held.warnings)


def test_too_few_values_do_not_determine_noise(table):
    with pytest.raises(InvalidValue, match=r"noise = None: must be given .*too few"):
        splits.retrieve(
            (W[:2], evaluate_spectrum(200.0, 50.0)[:2]), table, [SIZE], fixed={**FIXED, SOOT: 50.0}
        )


def test_a_prior_that_excludes_the_truth_is_reported(table):
    found = splits.retrieve((W, evaluate_spectrum(200.0, 50.0)), table, [SIZE], 0.01,
                            fixed={**FIXED, SOOT: 50.0}, prior={SIZE: (900.0, 30.0)})  # fmt: skip
    assert any("prior and measurement are" in line for line in found.warnings)


def test_the_end_of_a_range_is_reported(table):
    found = splits.retrieve((W, evaluate_spectrum(200.0, 50.0)), table, {SIZE: (50.0, 150.0)}, 0.01,
                            fixed={**FIXED, SOOT: 50.0})  # fmt: skip
    assert any("high end of its range, 150" in line for line in found.warnings)


def test_the_scale_of_a_panel(table):
    measured = 1.12 * evaluate_spectrum(200.0, 50.0)
    found = splits.retrieve((W, measured), table, [SIZE, SOOT, "scale"], 0.002, fixed=FIXED)
    assert found.values["scale"] == pytest.approx(1.12, abs=4.0 * found.stderr["scale"])


def test_bands(table):
    bands = {"red": (600, 700), "near infrared": (800, 900), "1240": (1200, 1300)}
    w = np.linspace(500.0, 1500.0, 1001)
    fine = evaluate_spectrum(300.0, 200.0, w)
    means = [fine[(w >= low) & (w <= high)].mean() for low, high in bands.values()]
    found = splits.retrieve(means, table, [SIZE, SOOT], 0.003, fixed=FIXED, bands=bands)
    assert found.values[SIZE] == pytest.approx(300.0, abs=4.0 * found.stderr[SIZE])


def test_series_and_arrays_say_the_same(table):
    measured = evaluate_spectrum(200.0, 50.0)
    kinds = [
        (W, measured),
        pd.Series(measured, index=W),
        pd.DataFrame({"reflectance": measured}, index=W),
        xr.DataArray(measured, {"wavelength": W}, "wavelength"),
    ]
    first, *others = (
        splits.retrieve(one, table, [SIZE], 0.01, fixed={**FIXED, SOOT: 50.0}) for one in kinds
    )
    for other in others:
        xr.testing.assert_equal(other.dataset, first.dataset)


VALID_CALLS = (W, evaluate_spectrum(200.0, 50.0))
INVALID_CALLS = {
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
    "counted": ({"measured": pd.Series(VALID_CALLS[1])}, "default index.*index_col"),
    "texts": ({"measured": (W, ["dark"] * W.size)}, "measured = .*numbers"),
    "errors of errors": (
        {"noise": {"stderr": 1e-4 * np.eye(W.size), "correlation_nm": 100.0}},
        "one standard error or 11",
    ),
    "huge": ({"noise": 10.0 * np.eye(W.size)}, "a variance of 10"),
    "two angles": ({"fixed": {**FIXED, "sza": 20.0}}, "left out beside"),
    "no noise": ({"noise": 0.0}, "no measurement is without noise"),
    "noise of one too few": ({"noise": np.full(W.size - 1, 0.01)}, "one or 11 of them"),
    "unknown": ({"free": ["optical_radius"]}, "did you mean"),
    "a level only": (
        {"free": ["scale"], "fixed": {**FIXED, SIZE: 100.0, SOOT: 10.0}},
        "at least one axis",
    ),
    "a vague prior": ({"prior": {SIZE: (500.0, 5000.0)}}, "fits into the range"),
    "nothing free": ({"free": []}, "names of parameters"),
    "contradictory": ({"free": {SIZE: (300.0, 200.0), SOOT: (0.0, 10.0)}}, "low < high"),
    "beyond the table": ({"free": {SIZE: (10.0, 200.0), SOOT: (0.0, 10.0)}}, "40 <= low"),
    "angle left out": ({"fixed": {}}, "fixed.incidence_deg"),
    "free and given": ({"fixed": {**FIXED, SIZE: 100.0}}, "left out, as it is free"),
    "prior of nothing": ({"prior": {"depth_m": (1.0, 1.0)}}, "unknown key"),
    "prior outside": ({"prior": {SIZE: (5000.0, 10.0)}}, "a mean in the range"),
    "sure prior": ({"prior": {SIZE: (500.0, 0.0)}}, "standard deviation above 0"),
    "no table": ({"model": 3}, "a Table"),
    "another quantity": ({"quantity": "transmittance"}, "reflectance"),
}


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_bad_input_is_rejected_in_one_line(table, name):
    other, message = INVALID_CALLS[name]
    given = {
        "measured": VALID_CALLS,
        "model": table,
        "free": [SIZE, SOOT],
        "noise": 0.01,
        "fixed": FIXED,
    }
    with pytest.raises(InvalidValue, match=message) as caught:
        splits.retrieve(**(given | other))
    assert "\n" not in str(caught.value)
