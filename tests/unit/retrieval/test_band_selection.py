"""Selection of bands: information by the textbook formula, and the selected bands."""

from __future__ import annotations

import numpy as np
import pytest
from formula_tables import W, make_snowlike_table, make_table

import splits
from splits.core.validation import InvalidValue

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0}


def test_information_of_all_bands_matches_the_formula():
    """All bands of a linear model in any order give ½ log₂ det(I + Kᵀ S⁻¹ K Sₐ)."""
    rows = np.stack([np.ones(W.size), np.linspace(-1.0, 1.0, W.size)])
    nodes = np.linspace(-1.0, 1.0, 40)
    linear = make_table(lambda a, b: 0.5 + 0.1 * (a * rows[0] + b * rows[1]),
                      {"a": nodes, "b": nodes}, 1e-8)  # fmt: skip
    result = splits.select_bands(linear, W, ["a", "b"], 0.02, n_bands=W.size)
    k = 0.2 * rows.T / 0.02
    exact = 0.5 * np.linalg.slogdet(np.eye(2) + k.T @ k / 12.0)[1] / np.log(2.0)
    assert float(result.information_bits[-1]) == pytest.approx(exact, rel=1e-4)
    spread = np.sqrt(np.diag(np.linalg.inv(k.T @ k + 12.0 * np.eye(2))) * 12.0)
    np.testing.assert_allclose(result.spread[-1], spread, rtol=1e-4)
    # The first two bands are at the ends, where the sensitivities are largest and independent.
    assert set(result.band.values[:2]) == {"500 nm", "1500 nm"}


def test_more_bands_add_decreasing_information():
    result = splits.select_bands(
        make_snowlike_table(), W, [SIZE, SOOT], 0.01, n_bands=4, fixed=FIXED
    )
    bits = result.information_bits.values
    assert (np.diff(bits) > 0.0).all()
    assert len(set(result.band.values)) == 4
    assert (np.diff(result.spread.values, axis=0) <= 1e-12).all()


def test_sensor_bands_are_selected():
    bands = {"blue": (500, 560), "near infrared": (850, 950), "short-wave": (1200, 1300)}
    result = splits.select_bands(
        make_snowlike_table(), bands, [SIZE, SOOT], 0.01, n_bands=2, fixed=FIXED
    )
    assert "blue" in result.band.values


INVALID_CALLS = {
    "too many": ({"n_bands": W.size + 1}, "1 to 11"),
    "no noise": ({"noise": 0.0}, "no measurement is without noise"),
    "unknown noise": ({"noise": None}, "noise = None: must be given"),
    "correlated": ({"noise": 1e-4 + 1e-4 * np.eye(W.size)}, "independent"),
    "outside": ({"bands": [300.0, 600.0], "n_bands": 1}, "500 to 1500"),
    "no table": ({"table": 1}, "a Table"),
}


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_invalid_input_is_rejected(name):
    changes, message = INVALID_CALLS[name]
    valid = {
        "table": make_snowlike_table(),
        "bands": W,
        "free": [SIZE, SOOT],
        "noise": 0.01,
        "fixed": FIXED,
    }
    with pytest.raises(InvalidValue, match=message):
        splits.select_bands(**(valid | changes))
