"""Axes of figures of snowpacks over time and other labels."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.plotting.season import draw_season

FORMULA = r"$\frac{$"


def make_season(label, index):
    """Return reflectances of snowpacks over a label."""
    shape, dims = (len(index), 2), (label, "wavelength")
    flags = {"flag_values": [0, 1], "flag_meanings": "good no_snow"}
    return xr.Dataset(
        {"reflectance": (dims, np.full(shape, 0.9)),
         "reflectance_stderr": (dims, np.full(shape, 1e-3)),
         "quality_flag": (label, np.zeros(len(index), int), flags)},
        {label: index, "wavelength": [500.0, 1300.0]},
    )  # fmt: skip


def draw_axes(label, index):
    figure = draw_season(make_season(label, index))
    figure.draw_without_rendering()
    return figure.axes[0]


def list_ticks(axes):
    low, high = axes.get_xlim()
    return [t.get_text() for t in axes.get_xticklabels() if low <= t.get_position()[0] <= high]


@pytest.mark.parametrize("calendar", ["noleap", "360_day"])
def test_dates_of_other_calendars_are_on_an_axis_of_dates(calendar):
    index = xr.date_range("2023-12-01", periods=40, freq="5D", calendar=calendar, use_cftime=True)
    axes = draw_axes("time", index)
    np.testing.assert_allclose(np.diff(axes.lines[0].get_xdata()), 5.0)
    ticks = list_ticks(axes)
    assert len(ticks) > 2 and all(text.startswith(("2023-1", "2024-0")) for text in ticks)


def test_texts_are_points_with_their_names():
    axes = draw_axes("site", ["Davos", f"col {FORMULA}", "Sodankylä"])
    assert list_ticks(axes) == ["Davos", r"col \$\frac{\$", "Sodankylä"]
    assert axes.lines[0].get_linestyle() == "None"


@pytest.mark.parametrize("index", [[1.0, 2.0, 4.0], pd.date_range("2024-01-01", periods=3)])
def test_names_of_labels_are_plain_text(index):
    assert draw_axes(FORMULA, index).get_xlabel() == r"\$\frac{\$"


def test_many_texts_have_some_ticks():
    ticks = list_ticks(draw_axes("site", [f"site {number}" for number in range(200)]))
    assert len(ticks) <= 24 and ticks[0] == "site 0" and ticks[-1] == "site 199"


@pytest.mark.parametrize("is_given", [[False] * 4, [True, False, False, False]])
@pytest.mark.parametrize(
    "index",
    [pd.date_range("2024-02-01", periods=4), [5.0, 6.0, 8.0, 9.0], ["a", "b", "c", "d"],
     xr.date_range("2024-02-01", periods=4, calendar="noleap", use_cftime=True)],
)  # fmt: skip
def test_the_axis_has_all_labels_without_their_results(index, is_given):
    season = make_season("time", index)
    full = draw_season(season).axes[0].get_xlim()
    figure = draw_season(season.where(xr.DataArray(is_given, dims="time")).assign(
        quality_flag=season.quality_flag
    ))  # fmt: skip
    figure.draw_without_rendering()
    np.testing.assert_allclose(figure.axes[0].get_xlim(), full)
    assert figure.axes[0].get_ylim()[0] == 0.0
