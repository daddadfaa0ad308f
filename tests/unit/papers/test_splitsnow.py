"""Verdicts on the agreement with published and measured numbers, for synthetic data."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from shipped import CONFIG

from splits.analysis.measured import read_measured, read_published
from splits.core.escaping import write_data_frame
from workflow.papers.splitsnow import (
    DIFFUSE_FRACTION,
    LETCHER_COLUMNS,
    _compare_with_published,
    _make_band_comparison_row,
    _make_depth_rows,
    compare_with_letcher,
    compare_with_spectrum,
    compute_measured_rmse,
    compute_rmse,
)
from workflow.papers.statements import UNRESOLVED_VERDICT

PUBLISHED = """\
# made up
id,quantity,place,published,bar,low,high
absolute,q,p,0.5,0.03,,
relative,q,p,0.5,3%,,
negative,q,p,-2,10%,,
between,q,p,0.026,,0.020,0.032
at_most,q,p,3.6,,,6
printed,q,p,0.938,0.1,,
trailing,q,p,0.890,3%,,
zero,q,p,0,0.001,,
power,q,p,4.3e-4,3%,,
"""
VERDICTS = [
    ("absolute", 0.529, "agrees"), ("absolute", 0.531, "outside"), ("absolute", 0.471, "agrees"),
    ("absolute", 0.469, "outside"),
    ("relative", 0.514, "agrees"), ("relative", 0.516, "outside"),
    ("negative", -2.19, "agrees"), ("negative", -2.21, "outside"),
    ("between", 0.0201, "agrees"), ("between", 0.0199, "outside"), ("between", 0.033, "outside"),
    ("at_most", 0.0, "agrees"), ("at_most", 5.9, "agrees"), ("at_most", 6.1, "outside"),
]  # fmt: skip


@pytest.fixture
def published(tmp_path):
    path = tmp_path / "published.csv"
    path.write_text(PUBLISHED)
    return read_published(path)


@pytest.mark.parametrize(("name", "ours", "verdict"), VERDICTS)
def test_a_number_agrees_within_its_tolerance(published, name, ours, verdict):
    row = _compare_with_published(name, published.loc[name], (ours, 1e-5))
    assert row["verdict"] == verdict
    assert row["difference"] == pytest.approx(ours - published.loc[name].published)
    assert row["stderr"] == 1e-5
    assert row["id"] == name


@pytest.mark.parametrize(
    ("name", "ours", "stderr"),
    [("absolute", 0.531, 0.001), ("at_most", 5.0, 0.6)],
)
def test_a_number_with_large_error_has_no_verdict(published, name, ours, stderr):
    row = _compare_with_published(name, published.loc[name], (ours, stderr))
    assert row["verdict"] == "not resolved at this accuracy"


@pytest.mark.parametrize(
    ("name", "ours", "stderr", "verdict"),
    [
        ("printed", 0.8374, 0.0009, "at the bar"), ("printed", 0.8386, 0.0009, "at the bar"),
        ("printed", 1.0376, 0.0009, "at the bar"),
        ("printed", 0.8374, 0.0011, "not resolved at this accuracy"),
        ("printed", 0.8369, 0.0009, "not resolved at this accuracy"),
        ("printed", 0.8374, 0.0002, "outside"), ("printed", 0.8386, 0.0002, "agrees"),
        ("trailing", 0.9163, 0.0009, "at the bar"),
        ("at_most", 6.0, 1e-9, "at the bar"), ("at_most", 6.05, 0.04, "at the bar"),
        ("at_most", 6.05, 0.2, UNRESOLVED_VERDICT),
        ("zero", 0.0009, 0.0002, "not resolved at this accuracy"),
    ],
)  # fmt: skip
def test_a_number_is_at_the_bar_within_the_last_printed_digit(
    published, name, ours, stderr, verdict
):
    row = _compare_with_published(name, published.loc[name], (ours, stderr))
    assert row["verdict"] == verdict


def test_the_resolution_is_that_of_the_printed_number(published):
    given = {"absolute": 0.1, "negative": 1.0, "between": 0.001, "trailing": 0.001, "zero": 1.0}
    given["power"] = 1e-5
    assert published.resolution[list(given)].to_dict() == pytest.approx(given)


def test_tolerances_are_stated_as_applied(published):
    tolerances = {
        name: _compare_with_published(name, row, (1.0, 0.0))["bar"]
        for name, row in published.iterrows()
    }
    assert tolerances["absolute"] == "±0.03"
    assert tolerances["relative"] == "±3 %"
    assert tolerances["between"] == "0.02 to 0.032"
    assert tolerances["at_most"] == "at most 6"


def test_a_number_without_a_counterpart_is_not_reproducible(published):
    row = _compare_with_published("absolute", published.loc["absolute"], None)
    assert row["verdict"].startswith("not reproducible")
    assert "ours" not in row


def test_shipped_published_numbers_have_tolerances():
    table = read_published(CONFIG / "published" / "splitsnow2021.csv")
    assert table.index.is_unique
    bar = table.bar.notna() | table.low.notna() | table.high.notna()
    assert table.index[~bar].tolist() == ["dumont_rmse"]


def test_rmse_of_independent_errors_scatters_as_stated():
    random = np.random.default_rng(4)
    exact, stderr = np.array([0.03, -0.04, 0.01]), np.array([0.002, 0.004, 0.003])
    results = [
        compute_rmse(
            exact + stderr * random.normal(size=3),
            stderr,
            lambda w: float(np.hypot.reduce(w * stderr)),
        )
        for _ in range(4000)
    ]
    values, errors = np.array(results).T
    rms_deviation = np.sqrt(np.mean((values - np.sqrt(np.mean(exact**2))) ** 2))
    assert rms_deviation / np.sqrt(np.mean(errors**2)) == pytest.approx(1.0, abs=0.05)


def test_rmse_of_correlated_errors_is_bounded():
    stderr = np.array([0.01, 0.01])
    value, error = compute_rmse([0.03, -0.03], stderr, lambda weights: float(weights @ stderr))
    assert value == pytest.approx(0.03)
    # A common shift changes the squared differences in second order only.
    assert error == pytest.approx(0.5 * 1e-4 / 0.03)
    assert compute_rmse([0.0, 0.0], [0.01, 0.03], lambda _: 9.0) == (
        0.0,
        pytest.approx(np.sqrt(5e-4)),
    )
    assert compute_rmse([0.01, 0.0], stderr, lambda _: 9.0)[1] == pytest.approx(0.01)


def test_rmse_to_a_measured_spectrum_includes_correlations():
    batches = np.array([[0.003, 0.003], [0.004, 0.004]])
    dataset = xr.Dataset(
        {
            "reflectance": ("wavelength", [0.9, 0.5]),
            "reflectance_stderr": ("wavelength", [0.005, 0.005]),
            "reflectance_batches": (("batch", "wavelength"), batches),
        },
        {"wavelength": [500.0, 1000.0]},
    )
    measured = pd.DataFrame({"wavelength_nm": [500.0, 1000.0], "reflectance": [0.8, 0.4]})
    value, error = compute_measured_rmse(dataset, measured)
    assert value == pytest.approx(0.1)
    assert error == pytest.approx(0.005, rel=0.01)
    _, cancelled = compute_measured_rmse(dataset, measured.assign(reflectance=[0.8, 0.6]))
    assert cancelled < 0.001


def test_model_is_compared_with_a_measured_spectrum():
    dataset = xr.Dataset(
        {
            "reflectance": ("wavelength", [0.9, 0.5]),
            "reflectance_stderr": ("wavelength", [0.1, 0.2]),
        },
        {"wavelength": [500.0, 1000.0]},
    )
    measured = pd.DataFrame({"wavelength_nm": [1000.0], "reflectance": [0.4]})
    row = compare_with_spectrum(dataset, measured).iloc[0]
    assert (row.model, row.measured, row.stderr) == (0.5, 0.4, 0.2)
    assert row.difference == pytest.approx(0.1)
    with pytest.raises(KeyError):
        compare_with_spectrum(dataset, measured.assign(wavelength_nm=[999.0]))


def test_letcher_mixes_beam_and_diffuse_light():
    dims = ("medium", "depth_m", "incidence_deg", "wavelength")
    values = np.zeros((2, 2, 2, 1))
    values[:, :, 0, 0], values[:, :, 1, 0] = 0.4, 0.8
    dataset = xr.Dataset(
        {
            "reflectance": (dims, values),
            "reflectance_stderr": (dims, np.full_like(values, 0.01)),
            "reflectance_batches": (("batch", *dims), np.full((1, *values.shape), 0.01)),
        },
        {
            "medium": ["natural snow", "other"],
            "depth_m": list(LETCHER_COLUMNS),
            "incidence_deg": ["beam", "diffuse"],
            "wavelength": [500.0],
        },
    )
    columns = {column: [0.7] for column in LETCHER_COLUMNS.values()}
    letcher = pd.DataFrame({"wavelength_nm": [500.0], **columns})
    table = compare_with_letcher(snows=dataset, letcher=letcher)
    fraction = DIFFUSE_FRACTION
    assert sorted(table.depth_m) == sorted(2 * [*LETCHER_COLUMNS])
    np.testing.assert_allclose(table.model, fraction * 0.8 + (1 - fraction) * 0.4)
    np.testing.assert_allclose(table.stderr, 0.01 * np.hypot(fraction, 1 - fraction))
    assert list(table.snow) == ["natural snow"] * 2 + ["other"] * 2
    with pytest.raises(ValueError, match=r"measured\.letcher = .*with albedo_45mm_black"):
        compare_with_letcher(snows=dataset, letcher=letcher.drop(columns="albedo_45mm_black"))


@pytest.mark.parametrize("name", ["aviris_ng_varsa2021", "snow_albedo_letcher2022"])
def test_shipped_measurements_are_fractions_over_wavelength(name):
    path = CONFIG / "measured" / f"{name}.csv"
    table = read_measured(path)
    assert path.read_text(encoding="utf-8").startswith("#"), "the citation comes first"
    assert (np.diff(table.wavelength_nm) > 0.0).all()
    values = table.drop(columns="wavelength_nm").to_numpy()
    # The absolute error of a measured albedo is about 2 %.
    assert ((values >= 0.0) & (values <= 1.02)).all()


def test_tables_are_written_atomically(tmp_path):
    path = tmp_path / "new" / "table.csv"
    write_data_frame(pd.DataFrame({"a": [1 / 3], "b": ["x"]}), path)
    assert path.read_text() == "a,b\n0.333333,x\n"
    assert [p.name for p in path.parent.iterdir()] == ["table.csv"]


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
