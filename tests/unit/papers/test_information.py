"""Sobol indices and information of bands, compared with functions known in closed form."""

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z
from formula_tables import W, make_snowlike_table, make_table

from splits.core.validation import InvalidValue
from workflow.papers.information import (
    compute_sobol_indices,
    make_band_selection,
    make_sobol_indices,
    select_bands,
)

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0}
A, B = np.linspace(0.1, 0.8, W.size), np.linspace(0.6, 0.2, W.size)


@pytest.fixture(scope="module")
def product_table():
    """Return a table of a product, whose variance decomposition is known."""
    nodes = np.linspace(-0.5, 0.5, 6)
    return make_table(lambda a, b: 0.4 * (1.0 + A * a) * (1.0 + B * b), {"a": nodes, "b": nodes})


@NEEDS_JIT
def test_indices_match_the_exact_values(product_table):
    result = compute_sobol_indices(product_table, ["a", "b"], points=256)
    variances = np.stack([A**2 / 12.0, B**2 / 12.0, A**2 * B**2 / 144.0])
    total_variance = variances.sum(axis=0)
    exact = {
        "first_order": variances[:2] / total_variance,
        "total": (variances[:2] + variances[2]) / total_variance,
    }
    for name, values in exact.items():
        error = result[f"{name}_stderr"].values
        z = (result[name].values - values)[error > 0.0] / error[error > 0.0]
        # Wavelengths use the same points, so that their errors are correlated.
        assert np.abs(z).max() < 5.0
        assert np.abs(result[name].values - values).max() < 0.02
    sums = result.first_order_sum.values
    np.testing.assert_allclose(sums, result.first_order.sum("parameter"), atol=1e-12)
    assert (sums <= 1.0 + 5.0 * result.first_order_sum_stderr.values).all()
    deviation = 0.4 * np.sqrt(total_variance)
    np.testing.assert_allclose(result.standard_deviation, deviation, rtol=0.05)


def test_the_same_seed_gives_the_same_result(product_table):
    one, other = (
        compute_sobol_indices(product_table, ["a", "b"], points=64, seed=3) for _ in range(2)
    )
    np.testing.assert_array_equal(one.first_order, other.first_order)


@NEEDS_JIT
def test_scatter_between_seeds_matches_stated_errors(product_table):
    """Only the middle wavelength of ten seeds is used, as all wavelengths are correlated."""
    runs = [compute_sobol_indices(product_table, ["a", "b"], points=64, seed=s) for s in range(10)]
    z = []
    for name in ("first_order", "total"):
        value, error = (np.stack([run[f"{name}{suffix}"].values[:, W.size // 2] for run in runs])
                        for suffix in ("", "_stderr"))  # fmt: skip
        z.append((value - value.mean(axis=0)) / (error * np.sqrt(0.9)))
        # Total indices include the first-order indices.
        assert (runs[0].total - runs[0].first_order > -3.0 * runs[0].total_stderr).all()
    judge_z(np.concatenate(z).ravel())


def test_constant_reflectance_has_no_indices(product_table):
    table = make_table(lambda a, b: np.where(W < 800.0, 0.5, 0.5 + 0.1 * a),
                     {"a": [0.0, 1.0, 2.0], "b": [0.0, 1.0]})  # fmt: skip
    result = compute_sobol_indices(table, ["a", "b"], points=64)
    assert (result.first_order.sel(wavelength=slice(None, 750.0)) == 0.0).all()
    np.testing.assert_allclose(
        result.first_order.sel(parameter="a", wavelength=1000.0), 1.0, atol=0.1
    )


def test_information_of_all_bands_matches_the_formula():
    """All bands of a linear model in any order give ½ log₂ det(I + Kᵀ S⁻¹ K Sₐ)."""
    rows = np.stack([np.ones(W.size), np.linspace(-1.0, 1.0, W.size)])
    nodes = np.linspace(-1.0, 1.0, 40)
    linear = make_table(lambda a, b: 0.5 + 0.1 * (a * rows[0] + b * rows[1]),
                      {"a": nodes, "b": nodes}, 1e-8)  # fmt: skip
    result = select_bands(linear, W, ["a", "b"], 0.02, n_bands=W.size)
    k = 0.2 * rows.T / 0.02
    exact = 0.5 * np.linalg.slogdet(np.eye(2) + k.T @ k / 12.0)[1] / np.log(2.0)
    assert float(result.information_bits[-1]) == pytest.approx(exact, rel=1e-4)
    spread = np.sqrt(np.diag(np.linalg.inv(k.T @ k + 12.0 * np.eye(2))) * 12.0)
    np.testing.assert_allclose(result.spread[-1], spread, rtol=1e-4)
    # The first two bands are at the ends, where the sensitivities are largest and independent.
    assert set(result.band.values[:2]) == {"500 nm", "1500 nm"}


def test_more_bands_add_decreasing_information():
    result = select_bands(make_snowlike_table(), W, [SIZE, SOOT], 0.01, n_bands=4, fixed=FIXED)
    bits = result.information_bits.values
    assert (np.diff(bits) > 0.0).all()
    assert len(set(result.band.values)) == 4
    assert (np.diff(result.spread.values, axis=0) <= 1e-12).all()


def test_sensor_bands_are_selected():
    bands = {"blue": (500, 560), "near infrared": (850, 950), "short-wave": (1200, 1300)}
    result = select_bands(make_snowlike_table(), bands, [SIZE, SOOT], 0.01, n_bands=2, fixed=FIXED)
    assert "blue" in result.band.values


def test_studies_of_tables_write_rows_and_a_column_for_each():
    snow = make_snowlike_table().dataset
    options = {"fixed": FIXED, "n_bands": 2, "seed": 1}
    table, figure = make_band_selection(my_snow=snow, other=snow, **options)
    assert list(dict.fromkeys(table.table)) == ["my snow", "other"]
    assert len(figure.axes) == 4
    table, figure = make_sobol_indices(my_snow=snow, seed=1)
    assert set(table.table) == {"my snow"} and len(figure.axes) == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bands": "sentinel"}, "bands = 'sentinel': must be one of"),
        ({"noise": 0}, r"options\.noise = 0"),
        ({"n_bands": 0}, r"options\.n_bands = 0"),
        ({"fixed": {"incidence": 40}}, r"options\.fixed\.incidence: .*did you mean incidence_deg"),
        ({"fixed": {"incidence_deg": 89}}, "incidence_deg = 89"),
    ],
)
def test_invalid_options_are_rejected(options, message):
    with pytest.raises(InvalidValue, match=message):
        make_band_selection(**{"seed": 1, "snow": make_snowlike_table().dataset, **options})


def test_inputs_other_than_tables_are_rejected():
    table = make_snowlike_table().dataset
    with pytest.raises(InvalidValue, match=r"inputs = \['a b', 'a_b'\]: must be names that differ"):
        make_sobol_indices(**{"a b": table, "a_b": table}, seed=1)
    with pytest.raises(InvalidValue, match=r"inputs\.a = '': must be a table of reflectance over"):
        make_sobol_indices(a=table.isel({SIZE: [0], SOOT: [0]}), seed=1)
    with pytest.raises(InvalidValue, match=r"inputs = {}: must be at least one table"):
        make_sobol_indices(seed=1)
