"""Trends: steps of band means along a grid, and their significance; checks of study inputs."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.core.validation import InvalidValue
from workflow.papers.statements import (
    MIN_TREND_SIGMA,
    compute_steps,
    make_monotone_row,
    make_significance_row,
    require,
    require_columns,
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
    np.testing.assert_allclose(dataset.errors.mean("transmittance", 400, 600)[0], [0.2, 0.4])
    np.testing.assert_allclose(dataset.errors.mean("transmittance", 850, 950)[0], 9.0)


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


def make_run(**coordinates):
    """Return reflectance over a grid of these values and two wavelengths."""
    coordinates |= {"wavelength": [400.0, 700.0]}
    shape = [len(np.atleast_1d(one[1] if isinstance(one, tuple) else one))
             for one in coordinates.values()]  # fmt: skip
    dims = [one[0] if isinstance(one, tuple) else name for name, one in coordinates.items()]
    values = np.arange(float(np.prod(shape))).reshape(shape)
    variables = {name: (dims, values) for name in ("reflectance", "reflectance_stderr")}
    return xr.Dataset(variables, coordinates, {"experiment": "mine"})


@pytest.mark.parametrize(
    ("axes", "needs", "message"),
    [
        (("facetness",), {}, "'mine': must be an experiment over facetness, two values or more"),
        ((), {}, "must be an experiment without a grid"),
        (("depth_m",), {"values": {"depth_m": (0.3,)}}, "with depth_m = 0.3 on its grid"),
        (("depth_m",), {"values": {"depth_m": ("0.1",)}}, "with depth_m = 0.1 on its grid"),
        (("depth_m",), {"at_nm": (500,)}, "must be an experiment with wavelength 500 nm"),
        (("depth_m",), {"band_nm": (350, 700)}, "over wavelengths from 350 to 700 nm"),
        (("depth_m",), {"quantity": "brdf"}, "must be an experiment with brdf and its standard"),
    ],
)
def test_unsuitable_experiments_are_rejected(axes, needs, message):
    run = make_run(depth_m=[0.2, 0.1])
    with pytest.raises(InvalidValue, match=message) as error:
        require("below", run, needs.pop("quantity", "reflectance"), axes, **needs)
    assert str(error.value).startswith("inputs.below = 'mine': must be")


def test_a_single_value_of_an_axis_is_rejected():
    with pytest.raises(InvalidValue, match="two values or more each"):
        require("below", make_run(depth_m=[0.2]), "reflectance", ("depth_m",))


def test_values_are_sorted_by_numbers_or_means():
    run = make_run(
        grain_size_um=["coarse", "fine"], facetness=[0.9, 0.1], medium=["wet", "dry"]
    ).assign_coords(grain_size_um_mean=("grain_size_um", [900.0, 100.0]))
    axes = ("grain_size_um", "facetness", "medium")
    values = {"grain_size_um": ("fine",), "facetness": (0.1,), "medium": ("dry",)}
    ordered = require("all", run, "reflectance", axes, values=values, band_nm=(400, 700))
    assert ordered.grain_size_um.values.tolist() == ["fine", "coarse"]
    assert ordered.facetness.values.tolist() == [0.1, 0.9]
    assert ordered.medium.values.tolist() == ["wet", "dry"]


def test_tables_need_their_columns_or_ids():
    table = pd.DataFrame({"reflectance": [0.5]}, index=["msi_r_density"])
    assert require_columns("measured.a", table, ("reflectance", "msi_r_density")) is table
    with pytest.raises(InvalidValue, match=r"measured\.a = .*: must be a table with refl"):
        require_columns("measured.a", table, ("reflectance_min",))
