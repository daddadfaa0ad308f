"""Results of retrievals: exact spectra, settings, alternative solutions, and messages."""

import numpy as np
import pytest
import xarray as xr
from formula_tables import W, evaluate_spectrum, make_snowlike_table

import splits
from splits.core.validation import InvalidValue
from splits.retrieval.optimal_estimation import (
    N_DRAWS,
    MAPEstimate,
    PosteriorDraws,
    PosteriorSummary,
    Solution,
    list_warnings,
)
from splits.retrieval.state_vector import ParameterRange, StateVector

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0}


@pytest.fixture(scope="module")
def table():
    return make_snowlike_table()


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
    summary = PosteriorSummary(covariance, np.eye(1), 1.0, 1.0)
    return Solution(estimates, summary, PosteriorDraws(draws, 4000.0), 1.0, none, none,
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
