"""Comparison of modelled and measured directions."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.core.validation import InvalidValue
from splits.plotting.grammar import save_figure
from workflow.papers.wet_sand import (
    ALL_DIRECTIONS,
    NADIR_RATIO,
    REFLECTANCE_FACTOR,
    compare_with_measured,
    draw_anisotropy,
    summarize_by_angle,
)

POLAR, AZIMUTH = np.arange(0.0, 90.0, 2.5), np.arange(0.0, 360.0, 5.0)
MODELS, SAMPLES, W = ["lobe", "none"], ["0", "0.4"], [500.0, 900.0]
AZIMUTHS, SCALE = (0, 36, 180, 357.5), 1.2


def make_dataset():
    """Return BRDFs of two models: a linear increase in forward directions, and a constant."""
    rise = POLAR[:, np.newaxis] / 100.0 * (1.0 + np.cos(np.radians(AZIMUTH)))
    varying = 0.1 * (1.0 + rise)
    models = np.stack([varying, np.full_like(varying, 0.1)])
    values = models[:, np.newaxis, np.newaxis] * np.ones((2, 2, 2, 1, 1))
    dims = ("interpretation", "saturation", "wavelength", "polar_deg", "azimuth_deg")
    reflectance = np.full(values.shape[:3], 0.1 * np.pi)
    return xr.Dataset(
        {"brdf": (dims, values), "brdf_stderr": (dims, 0.01 * values),
         "reflectance": (dims[:3], reflectance)},
        {"interpretation": MODELS, "saturation": SAMPLES, "wavelength": W, "polar_deg": POLAR,
         "azimuth_deg": AZIMUTH},
    )  # fmt: skip


def make_measured():
    """Return factors of the first model in three scans, between the directions of the dataset.

    Each scan has a level of its own, of which the ratio to the nadir is independent.
    """
    directions = [(s, w, p, a) for s in (0.0, 0.4) for w in (500, 900) for p in (0, 20, 41)
                  for a in AZIMUTHS]  # fmt: skip
    columns = ["saturation", "wavelength_nm", "polar_deg", "azimuth_deg"]
    frame = pd.DataFrame(directions, columns=columns)
    cos = np.cos(np.radians(frame.azimuth_deg))
    factor = 0.1 * np.pi * (1.0 + frame.polar_deg / 100.0 * (1.0 + cos))
    return frame.assign(reflectance_factor=SCALE * factor)


def compare(quantity):
    table = compare_with_measured(make_dataset(), make_measured(), SCALE)
    return table[table.quantity == quantity]


def test_exact_model_agrees_within_interpolation_error():
    level, ratio = compare(REFLECTANCE_FACTOR), compare(NADIR_RATIO)
    assert len(level) == 2 * len(make_measured()) and len(ratio) == len(level) * 2 // 3
    for table, error in ((level, 0.01), (ratio, 0.01 * np.sqrt(2.0))):
        exact = table[table.interpretation == "lobe"]
        np.testing.assert_allclose(exact.modelled, exact.measured, rtol=1e-3)
        np.testing.assert_allclose(exact.stderr / exact.modelled, error, rtol=0.05)
        none = table[table.interpretation == "none"]
        np.testing.assert_allclose(none.modelled, none.isotropic, rtol=1e-9)


def test_ratios_to_the_nadir_are_those_within_a_scan():
    measured = make_measured()
    level = 1.0 + (measured.azimuth_deg % 180) / 100
    measured = measured.assign(reflectance_factor=level * measured.reflectance_factor)
    table = compare_with_measured(make_dataset(), measured)
    ratios = table[(table.quantity == NADIR_RATIO) & (table.interpretation == "lobe")]
    np.testing.assert_allclose(ratios.modelled, ratios.measured, rtol=1e-3)


def test_misfits_by_angle_match_their_directions():
    summary = summarize_by_angle(compare(NADIR_RATIO))
    assert len(summary) == 2 * 2 * 2 * 3
    row = summary[(summary.interpretation == "none") & (summary.saturation == 0.4)
                & (summary.wavelength_nm == 900) & (summary.polar_deg == 20)].iloc[0]  # fmt: skip
    deviations = 0.2 * (1.0 + np.cos(np.radians(AZIMUTHS)))
    assert row.rmse == pytest.approx(np.sqrt((deviations**2).mean()))
    assert row.bias == pytest.approx(-deviations.mean())
    # The second model is isotropic.
    assert row.rmse == pytest.approx(row.isotropic_rmse) and row.directions == 4
    total = summary[summary.polar_deg == ALL_DIRECTIONS]
    assert (total.directions == 8).all() and (
        total[total.interpretation == "lobe"].rmse < 1e-3
    ).all()


def test_the_figure_shows_every_sample(tmp_path):
    table = compare_with_measured(make_dataset(), make_measured())
    figure = draw_anisotropy(make_dataset(), table, summarize_by_angle(table), 500.0)
    assert len(figure.axes) == 4
    for path in save_figure(figure, tmp_path / "figure"):
        assert path.stat().st_size > 10_000


INVALID_CALLS = {
    "column": (make_measured().drop(columns="azimuth_deg"), "azimuth_deg"),
    "sample": (make_measured().assign(saturation=0.7), r"directions\.saturation = '0\.7'.*0, 0\.4"),
    "wavelength": (make_measured().assign(wavelength_nm=650), r"directions\.wavelength_nm"),
    "gap": (make_measured().assign(reflectance_factor=np.nan), r"reflectance_factor = nan"),
    "text": (make_measured().assign(polar_deg="high"), r"polar_deg = 'high'"),
    "no axis": (make_measured().assign(site=1), r"'site': must be left out"),
    "empty": (make_measured().iloc[:0], "no rows"),
    "angle": (make_measured().assign(polar_deg=89), r"directions\.polar_deg"),
    "nadir": (make_measured().query("polar_deg > 0"), "with the nadir"),
}


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_tables_that_do_not_match_the_model_are_rejected(name):
    table, message = INVALID_CALLS[name]
    with pytest.raises(InvalidValue, match=message):
        compare_with_measured(make_dataset(), table)
