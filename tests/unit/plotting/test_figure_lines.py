"""Labels, colours and dashes of figures, and the placement of legends."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.plotting import draw, draw_beam_spread, draw_points, draw_spectra
from splits.plotting.lines import DASHES, PlotLines
from splits.plotting.style import format_value, pick_colours

X = np.linspace(400.0, 1000.0, 13)


def make_dataset(grid, wavelength=X, value=0.5, quantities=("reflectance",)):
    """Return constant spectra over a grid, 0.01 apart."""
    coords = {**{k: np.array(v) for k, v in grid.items()}, "wavelength": np.array(wavelength)}
    shape = tuple(len(v) for v in coords.values())
    n_spectra = int(np.prod(shape[:-1], dtype=int))
    base = value + 0.01 * np.arange(n_spectra).reshape(*shape[:-1], 1)
    variables = {}
    for name in quantities:
        variables[name] = (tuple(coords), np.broadcast_to(base, shape), {"long_name": f"a {name}"})
        variables[f"{name}_stderr"] = (tuple(coords), np.full(shape, 1e-3))
    return xr.Dataset(variables, coords)


def make_plot_lines(grid, **options):
    return PlotLines(make_dataset(grid), list(grid), **options)


def list_legend_entries(legend):
    return [text.get_text() for text in legend.get_texts()]


@pytest.mark.parametrize(
    ("value", "parameter", "text"),
    [
        ("None", "bottom_albedo", "no bottom"),
        ("None", "surface", "smooth"),
        (None, "other", "none"),
        ("0", "polarized", "no"),
        ("1", "opaque", "yes"),
        (True, None, "yes"),
        ("False", None, "no"),
        (1e-5, None, "10⁻⁵"),
        ("1e-05", "bottom_albedo", "10⁻⁵"),
        (2.5e-7, None, "2.5 × 10⁻⁷"),
        (1e-4, "size_tail", "10⁻⁴"),
        (0.002, "depth_m", "0.002"),
        (2e6, None, "2 × 10⁶"),
        (float("inf"), "optical_thickness", "∞"),
        (-5.0, "temperature_c", "−5"),
        ("300-750", "grain_size_um", "300–750"),
        ("0-0.15-0.85", "texture", "0 / 0.15 / 0.85"),
        ("0.5-0.1", "roundness", "0.5, 0.1"),
        ("1.31+1e-7j", "refractive_index", "1.31 + 10⁻⁷i"),
        ("henyey_greenstein", "phase_function", "Henyey–Greenstein"),
        ("keep_overlap_with_segment", "interpretation", "keep overlap with segment"),
        ("10019201", "medium", "10019201"),
    ],
)
def test_values_are_formatted_for_print(value, parameter, text):
    assert format_value(value, parameter) == text


@pytest.mark.parametrize(
    "sizes", [(), (1,), (5,), (1, 5), (2, 4), (2, 9), (9, 3), (3, 3, 3), (12,), (14, 2)]
)
def test_all_lines_have_different_styles(sizes):
    grid = {f"p{i}": np.arange(float(n)) for i, n in enumerate(sizes)}
    for use_dashes in (False, True):
        styles = [
            (line.colour, line.dash) for line in make_plot_lines(grid, use_dashes=use_dashes).lines
        ]
        assert len(set(styles)) == len(styles) == np.prod(sizes, dtype=int)


def test_many_unordered_names_combine_colours_and_dashes():
    lines = make_plot_lines({"interpretation": [f"r{i}" for i in range(13)]}).lines
    assert len({(line.colour, line.dash) for line in lines}) == 13
    assert {line.colour for line in lines} == set(pick_colours(10, "interpretation"))
    assert {line.dash for line in lines} == set(DASHES[:2])


def test_colours_of_ordered_values_increase_in_lightness():
    for n_colours in (2, 5, 12):
        luminance = [0.2126 * r + 0.7152 * g + 0.0722 * b for r, g, b in pick_colours(n_colours)]
        assert (np.diff(luminance) > 0.0).all()
        assert luminance[-1] < 0.75, "the lightest colour is visible on white"


def test_the_default_is_black_and_on_top():
    lines = make_plot_lines({"interpretation": ["a", "default", "b"]}).lines
    default, others = lines[1], (lines[0], lines[2])
    assert default.colour == "black" and default.is_default
    assert all(line.zorder < default.zorder and line.colour != "black" for line in others)
    assert all(line.to_plot_style()["lw"] < default.to_plot_style()["lw"] for line in others)
    assert [line.colour for line in others] == pick_colours(2, "interpretation")


def test_legend_of_few_lines_is_inside_the_axes():
    figure = draw_spectra(make_dataset({"bottom_albedo": ["None", "1e-05", "0.5"]}, value=0.1))
    (axes,) = figure.axes
    assert not figure.legends
    assert list_legend_entries(axes.get_legend()) == ["no bottom", "10⁻⁵", "0.5"]
    assert axes.get_legend().get_title().get_text() == "bottom albedo"


def test_a_legend_over_lines_is_placed_outside():
    zigzag = make_dataset({"saturation": [0.0, 0.5, 1.0]})
    zigzag["reflectance"] = xr.where(np.arange(X.size) % 2 == 0, 1.0, 0.01) + 0.0 * (
        zigzag.reflectance
    )
    figure = draw_spectra(zigzag)
    assert figure.axes[0].get_legend() is None
    (legend,) = figure.legends
    assert list_legend_entries(legend) == ["0", "0.5", "1"]


def is_legend_clear(figure):
    """Return whether legends are within the figure and outside its axes."""
    figure.draw_without_rendering()
    boxes = [legend.get_window_extent() for legend in figure.legends]
    inside = all(
        box.x0 >= -1.0 and box.y0 >= -1.0 and box.x1 <= figure.bbox.x1 + 1.0
        and box.y1 <= figure.bbox.y1 + 1.0
        for box in boxes
    )  # fmt: skip
    panels = [axes.get_window_extent() for axes in figure.axes]
    return inside and not any(box.overlaps(panel) for box in boxes for panel in panels)


def test_legend_of_two_parameters_lists_each_value_once():
    figure = draw_spectra(
        make_dataset({"density_kg_m3": np.arange(9.0), "depth_m": [0.1, 0.2, 0.3]})
    )
    (legend,) = figure.legends
    names = [str(i) for i in range(9)]
    assert list_legend_entries(legend) == [
        "density (kg m⁻³)",
        *names,
        "depth (m)",
        "0.1",
        "0.2",
        "0.3",
    ]
    assert is_legend_clear(figure)
    assert figure.axes[0].get_window_extent().height > 0.6 * figure.bbox.height


def test_many_values_have_a_colour_bar():
    grid = {"grain_size_um": [f"{i}00-{i + 1}00" for i in range(1, 25)], "depth_m": [0.1, 0.2]}
    figure = draw_spectra(make_dataset(grid))
    axes, bar = figure.axes
    assert bar.get_ylabel() == "grain size (µm)"
    ticks = [text.get_text() for text in bar.get_yticklabels()]
    assert 5 <= len(ticks) <= 10 and ticks[0] == "100–200"
    assert len(axes.lines) == 48
    assert list_legend_entries(figure.legends[0]) == ["depth (m)", "0.1", "0.2"]
    assert is_legend_clear(figure)


def test_legend_of_forty_interpretations_fits():
    figure = draw_spectra(
        make_dataset({"interpretation": [f"interpretation number {i}" for i in range(40)]})
    )
    assert len(list_legend_entries(figure.legends[0])) == 40
    assert is_legend_clear(figure)


def test_measured_values_are_in_the_legend():
    table = pd.DataFrame({"wavelength_nm": [500.0], "reflectance": [0.5]})
    figure = draw_spectra(make_dataset({}, value=0.2), measured=table)
    assert list_legend_entries(figure.axes[0].get_legend()) == ["model", "measured"]


SECTION = {"kind": "points", "select": {}, "legend": None}


def test_points_show_every_quantity():
    dataset = make_dataset(
        {"density_kg_m3": [100.0, 200.0]}, [500.0, 600.0, 700.0],
        quantities=("reflectance", "transmittance"),
    )  # fmt: skip
    dataset["transmittance"] = 0.1 * dataset.transmittance
    figure = draw(dataset, {**SECTION, "quantity": ["reflectance", "transmittance"]})
    assert [axes.get_xlabel() for axes in figure.axes] == ["a reflectance", "a transmittance"]
    for axes, name in zip(figure.axes, ("reflectance", "transmittance"), strict=True):
        plotted = [container.lines[0].get_xdata() for container in axes.containers]
        np.testing.assert_array_equal(plotted, dataset[name].transpose("wavelength", ...))
    assert [t.get_text() for t in figure.axes[0].get_yticklabels()] == ["100", "200"]
    assert list_legend_entries(figure.legends[0]) == ["500", "600", "700"]
    assert is_legend_clear(figure)


def test_points_show_grain_quantities_at_one_wavelength():
    dataset = make_dataset({"density_kg_m3": [100.0, 200.0]}, [600.0])
    long_name = {"long_name": "mean distance"}
    dataset["mean_grain_distance"] = ("density_kg_m3", np.array([2e-3, 1e-3]), long_name)
    (axes,) = draw_points(dataset).axes
    assert axes.get_xlabel() == "a reflectance"
    (axes,) = draw_points(dataset, ["mean_grain_distance"]).axes
    assert axes.get_xlabel() == "mean distance (mm)"
    np.testing.assert_allclose(axes.lines[0].get_xdata(), [2.0, 1.0])


def test_points_are_shifts_from_the_stated_default():
    dataset = make_dataset({"interpretation": ["a", "default", "b"]}, [500.0, 600.0])
    axes = draw_points(dataset).axes[0]
    for container in axes.containers:
        np.testing.assert_allclose(container.lines[0].get_xdata(), [-0.01, 0.0, 0.01], atol=1e-12)
        intervals = [segment[:, 0] for segment in container.lines[2][0].get_segments()]
        half_widths = [0.5 * (high - low) for low, high in intervals]
        np.testing.assert_allclose(half_widths, [2e-3 * 2**0.5, 0.0, 2e-3 * 2**0.5], atol=1e-12)
    assert axes.get_xlabel().splitlines()[1] == "default: 0.510 (500 nm), 0.510 (600 nm)"
    absolute = draw_points(make_dataset({"interpretation": ["a", "b"]}, [500.0])).axes[0]
    np.testing.assert_allclose(absolute.containers[0].lines[0].get_xdata(), [0.5, 0.51])


def test_spectra_are_shifts_in_one_panel_each():
    dataset = make_dataset({"interpretation": ["a", "default", "b"], "depth_m": [0.1]})
    figure = draw_spectra(dataset)
    default, one, other = figure.axes
    np.testing.assert_allclose(default.lines[0].get_ydata(), 0.51)
    np.testing.assert_allclose(one.lines[0].get_ydata(), -0.01)
    np.testing.assert_allclose(other.lines[0].get_ydata(), 0.01)
    assert "independent" in next(t.get_text() for t in figure.texts if t.get_gid() == "foot")
    limited = draw_spectra(dataset, ylim=(0.2, 0.8))
    assert limited.axes[0].get_ylim() == (0.2, 0.8)
    assert limited.axes[1].get_ylim() == one.get_ylim()
    crossed = make_dataset({"interpretation": ["a", "default"], "depth_m": [0.1, 0.2]})
    assert len(draw_spectra(crossed).axes[0].lines) == 4, "several parameters stay absolute"


def test_legend_of_many_beam_wavelengths_is_outside():
    radius, side = np.geomspace(1e-4, 1e-1, 8), ["reflected", "transmitted"]
    for n in (2, 5):
        x = 600.0 + 100.0 * np.arange(n)
        dataset = xr.Dataset(
            {
                "profile": (("wavelength", "side", "radius"), np.ones((n, 2, 8))),
                "profile_stderr": (("wavelength", "side", "radius"), np.full((n, 2, 8), 0.01)),
                "profile_map": (("wavelength", "side", "x", "y"), np.ones((n, 2, 3, 3))),
            },
            {"wavelength": x, "side": side, "radius": radius, "x": np.arange(3.0),
             "y": np.arange(3.0)},
        )  # fmt: skip
        figure = draw_beam_spread(dataset)
        assert len(figure.legends) == (n == 5)
        assert is_legend_clear(figure)
