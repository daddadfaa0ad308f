"""Comparison of modelled and measured directions."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.analysis.anisotropy import ALL_DIRECTIONS, compare_with_measured, summarize_by_angle
from splits.core.validation import InvalidValue
from splits.plotting.anisotropy import draw_anisotropy
from splits.plotting.style import save_figure

POLAR, AZIMUTH = np.arange(0.0, 90.0, 2.5), np.arange(0.0, 360.0, 5.0)
MODELS, SAMPLES, W = ["lobe", "none"], ["0", "0.4"], [500.0, 900.0]


def dataset():
    """Return a BRDF that rises linearly with the angle, forwards only, or does not change."""
    rise = POLAR[:, np.newaxis] / 100.0 * (1.0 + np.cos(np.radians(AZIMUTH)))
    one = 0.1 * (1.0 + rise)
    both = np.stack([one, np.full_like(one, 0.1)])
    values = both[:, np.newaxis, np.newaxis] * np.ones((2, 2, 2, 1, 1))
    dims = ("interpretation", "saturation", "wavelength", "polar", "azimuth")
    return xr.Dataset(
        {"brdf": (dims, values), "brdf_stderr": (dims, 0.01 * values)},
        {"interpretation": MODELS, "saturation": SAMPLES, "wavelength": W, "polar": POLAR,
         "azimuth": AZIMUTH},
    )  # fmt: skip


def measured():
    """Return what the first model has, at directions between those of the dataset."""
    places = [(s, w, p, a) for s in (0.0, 0.4) for w in (500, 900) for p in (20, 41)
              for a in (0, 36, 180, 357.5)]  # fmt: skip
    frame = pd.DataFrame(places, columns=["saturation", "wavelength_nm", "polar_deg",
                                          "azimuth_deg"])  # fmt: skip
    cos = np.cos(np.radians(frame.azimuth_deg))
    return frame.assign(anisotropy_factor=1.0 + frame.polar_deg / 100.0 * (1.0 + cos))


def test_a_model_that_is_right_is_off_by_interpolation_only():
    table = compare_with_measured(dataset(), measured())
    assert len(table) == 2 * len(measured())
    own = table[table.interpretation == "lobe"]
    np.testing.assert_allclose(own.modelled, own.anisotropy_factor, rtol=1e-3)
    np.testing.assert_allclose(own.stderr / own.modelled, 0.01 * np.sqrt(2.0), rtol=0.05)
    none = table[table.interpretation == "none"]
    np.testing.assert_allclose(none.modelled, 1.0, rtol=1e-9)


def test_misfits_by_angle_are_those_of_their_directions():
    table = compare_with_measured(dataset(), measured())
    found = summarize_by_angle(table)
    assert len(found) == 2 * 2 * 2 * 3
    one = found[(found.interpretation == "none") & (found.saturation == 0.4)
                & (found.wavelength_nm == 900) & (found.polar_deg == 20)].iloc[0]  # fmt: skip
    off = 0.2 * (1.0 + np.cos(np.radians([0.0, 36.0, 180.0, 357.5])))
    assert one.rmse == pytest.approx(np.sqrt((off**2).mean()))
    assert one.bias == pytest.approx(-off.mean())
    # A model without directions misses just what the measured ones spread.
    assert one.rmse == pytest.approx(one.spread) and one.directions == 4
    every = found[found.polar_deg == ALL_DIRECTIONS]
    assert (every.directions == 8).all() and (
        every[every.interpretation == "lobe"].rmse < 1e-3
    ).all()


def test_the_figure_shows_every_sample(tmp_path):
    table = compare_with_measured(dataset(), measured())
    figure = draw_anisotropy(dataset(), table, summarize_by_angle(table), 500.0)
    assert len(figure.axes) == 4
    for path in save_figure(figure, tmp_path / "figure"):
        assert path.stat().st_size > 10_000


INVALID_CALLS = {
    "column": (measured().drop(columns="azimuth_deg"), "azimuth_deg"),
    "sample": (measured().assign(saturation=0.7), r"directions\.saturation = '0\.7'.*0, 0\.4"),
    "wavelength": (measured().assign(wavelength_nm=650), r"directions\.wavelength_nm"),
    "gap": (measured().assign(anisotropy_factor=np.nan), r"anisotropy_factor = nan"),
    "text": (measured().assign(polar_deg="high"), r"polar_deg = 'high'"),
    "no axis": (measured().assign(site=1), r"'site': must be left out"),
    "empty": (measured().iloc[:0], "no rows"),
    "angle": (measured().assign(polar_deg=89), r"directions\.polar_deg"),
}


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_tables_that_do_not_match_the_model_are_rejected(name):
    table, message = INVALID_CALLS[name]
    with pytest.raises(InvalidValue, match=message):
        compare_with_measured(dataset(), table)
