"""Trends: steps of band means along a grid, and their significance."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from splits.experiments.papers.snow_trends import (
    MIN_TREND_SIGMA,
    _make_band_comparison_row,
    _make_depth_rows,
    compute_band_mean,
    compute_steps,
    make_monotone_row,
    make_significance_row,
)

WAVELENGTHS = np.array([400.0, 500.0, 600.0, 900.0])


def make_transmittance(values, stderr=0.01):
    """Return transmittance, one value per depth in 400-600 nm and 9 elsewhere."""
    rows = np.repeat(np.asarray(values, dtype=float)[:, np.newaxis], len(WAVELENGTHS), axis=1)
    rows[:, -1] = 9.0
    error = np.broadcast_to(np.reshape(stderr, (-1, 1)), rows.shape)
    return xr.Dataset(
        {
            "transmittance": (("depth_m", "wavelength"), rows),
            "transmittance_stderr": (("depth_m", "wavelength"), error),
        },
        {"depth_m": np.arange(len(values)) + 1.0, "wavelength": WAVELENGTHS},
    )


def compute_verdict(values, sign, stderr=0.01):
    dataset = make_transmittance(values, stderr)
    return make_monotone_row(
        dataset, "transmittance", "depth_m", sign, (400, 600), "falls", "Fig 0"
    )


def test_band_mean_uses_its_band_only():
    dataset = make_transmittance([0.2, 0.4])
    np.testing.assert_allclose(compute_band_mean(dataset, "transmittance", 400, 600), [0.2, 0.4])
    np.testing.assert_allclose(compute_band_mean(dataset, "transmittance", 850, 950), 9.0)


def test_steps_have_combined_errors():
    dataset = make_transmittance([0.8, 0.5, 0.4], stderr=[0.03, 0.04, 0.0])
    step, error = compute_steps(dataset, "transmittance", "depth_m", 400, 600)
    np.testing.assert_allclose(step, [-0.3, -0.1])
    np.testing.assert_allclose(error, [0.05, 0.04])


def test_steps_along_any_dimension_of_a_grid():
    first, second = (
        make_transmittance([0.8, 0.5, 0.4], [0.03, 0.04, 0.0]),
        make_transmittance([0.9, 0.2, 0.1]),
    )
    dataset = xr.concat([first, second], dim="saturation")
    step, error = compute_steps(dataset, "transmittance", "depth_m", 400, 600)
    assert step.shape == error.shape == (2, 2)
    np.testing.assert_allclose(step, [[-0.3, -0.1], [-0.7, -0.1]])
    np.testing.assert_allclose(error, [[0.05, 0.04], [0.01 * np.sqrt(2)] * 2])


def test_trend_verdict_depends_on_the_least_significant_step():
    assert compute_verdict([0.8, 0.5, 0.3], -1)["verdict"] == "agrees"
    assert compute_verdict([0.8, 0.5, 0.3], +1)["verdict"] == "outside"
    assert compute_verdict([0.8, 0.5, 0.49], -1)["verdict"] == "not resolved at this accuracy"
    assert compute_verdict([0.8, 0.5, 0.51], -1)["verdict"] == "not resolved at this accuracy"
    assert compute_verdict([0.3, 0.5, 0.8], +1)["verdict"] == "agrees"


def test_trend_row_states_the_least_significant_step():
    row = compute_verdict([0.8, 0.5, 0.3], -1, stderr=[0.001, 0.001, 0.04])
    assert row["ours"] == pytest.approx(0.2)
    assert row["stderr"] == pytest.approx(np.hypot(0.001, 0.04))
    assert row["id"] == "trend"
    assert row["place"] == "Fig 0"


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (3.01, "agrees"),
        (2.99, "not resolved at this accuracy"),
        (-3.01, "outside"),
        (np.nan, "not resolved at this accuracy"),
    ],
)
def test_trend_threshold_is_three_standard_errors(value, expected):
    assert MIN_TREND_SIGMA == 3.0
    row = make_significance_row("q", "p", np.array([10.0, value]), np.array([1.0, 1.0]))
    assert row["verdict"] == expected
    np.testing.assert_equal(row["ours"], value)
    assert "3 standard errors" in row["bar"]


def test_band_comparison_error_matches_sampling():
    batches = np.zeros((5, 2, 4))
    # One set of paths in the visible, another one in the infrared.
    batches[:, 0, :2], batches[:, 1, 2:] = 0.01, 0.01
    dims = ("grain_size_um", "wavelength")
    dataset = xr.Dataset(
        {
            "reflectance": (dims, np.full((5, 4), 0.5)),
            "reflectance_stderr": (dims, np.full((5, 4), 0.01)),
            "reflectance_batches": (("grain_size_um", "batch", "wavelength"), batches),
        },
        {"grain_size_um": np.arange(5.0), "wavelength": [400.0, 600.0, 900.0, 1300.0]},
    )
    visible, near = np.random.default_rng(1).normal(0.0, 0.01, (2, 5, 20_000))
    difference = (visible[-1] - visible[0]) - (near[-1] - near[0])
    # The standard deviation of 20 000 samples has a standard error of 0.5 %: four of these.
    assert _make_band_comparison_row(dataset)["stderr"] == pytest.approx(difference.std(), rel=0.02)


@pytest.mark.parametrize(("shallow", "deep"), [(0.2, 0.06), (0.04, 0.03)])
def test_depth_ratio_error_matches_sampling(shallow, deep):
    dataset = xr.Dataset(
        {
            "transmittance": (
                ("depth_m", "wavelength"), [[0.5, 0.5, shallow], [0.25, 0.25, deep]],
            ),
            "transmittance_stderr": (("depth_m", "wavelength"), [[0.0, 0.0, 0.002]] * 2),
        },
        {"depth_m": [0.01, 0.02], "wavelength": [400.0, 700.0, 1030.0]},
    )  # fmt: skip
    samples = np.random.default_rng(2).normal((shallow, deep), 0.002, (20_000, 2))
    stated = _make_depth_rows(dataset)[-1]["stderr"]
    # As above; the ratio is slightly nonlinear.
    assert stated == pytest.approx((samples[:, 1] / samples[:, 0]).std(), rel=0.03)
