"""Lines of figures: labels, colours, legends, large grids, refractive indices and seasons."""

from inspect import signature

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from shipped import CONFIG

from splits.core.declarations import list_inputs
from splits.core.validation import ConfigError, InvalidValue
from splits.experiments import ExperimentConfig, load_experiment
from splits.plotting import (
    draw,
    draw_beam_spread,
    draw_points,
    draw_refractive_indices,
    draw_spectra,
    save_figure,
)
from splits.plotting.figure import FIGURES
from splits.plotting.grammar import format_value, pick_colours
from splits.plotting.lines import DASHES, PlotLines
from splits.plotting.settings import (
    MAX_LINES,
    MAX_PANELS,
    MAX_ROWS,
    choose_panel_parameters,
)
from splits.plotting.spectra import draw_season

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
        ("None", "ground", "open"),
        ("None", "surface", "smooth"),
        (None, "other", "none"),
        ("0", "polarized", "no"),
        ("1", "opaque", "yes"),
        (True, None, "yes"),
        ("False", None, "no"),
        (1e-5, None, "10⁻⁵"),
        ("1e-05", "ground", "10⁻⁵"),
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
    figure = draw_spectra(make_dataset({"ground": ["None", "1e-05", "0.5"]}, value=0.1))
    (axes,) = figure.axes
    assert not figure.legends
    assert list_legend_entries(axes.get_legend()) == ["open", "10⁻⁵", "0.5"]
    assert axes.get_legend().get_title().get_text() == "ground"


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
    figure = draw(dataset, **SECTION, quantity=["reflectance", "transmittance"])
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


MEDIA = CONFIG / "media"


def make_large_dataset(grid, quantities=("reflectance",)):
    coords = {**{k: np.array(v) for k, v in grid.items()}, "wavelength": X}
    shape = tuple(len(v) for v in coords.values())
    values = np.linspace(0.1, 0.9, int(np.prod(shape))).reshape(shape)
    variables = {}
    for name in quantities:
        variables[name] = (tuple(coords), values, {"long_name": f"a {name}"})
        variables[f"{name}_stderr"] = (tuple(coords), np.full(shape, 0.01))
    return xr.Dataset(variables, coords)


def load_text(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return load_experiment(path, MEDIA)


def make_grid(*sizes):
    names = ("saturation", "density_kg_m3", "depth_m", "temperature_c")
    lows = (0.0, 200.0, 0.1, -20.0)
    highs = (1.0, 800.0, 2.0, -1.0)
    values = [np.linspace(low, high, n) for low, high, n in zip(lows, highs, sizes, strict=False)]
    axes = (f"{k}: {v.round(5).tolist()}" for k, v in zip(names, values, strict=False))
    return "grid: {" + ", ".join(axes) + "}\n"


def test_panel_parameters_are_chosen_by_number_of_lines():
    assert choose_panel_parameters({"a": 5, "b": 12}) == []
    assert choose_panel_parameters({"a": 40, "b": 2}) == ["b"]
    assert choose_panel_parameters({"one": 1, "a": 40, "b": 4, "c": 5}) == ["b", "c"]
    for sizes in ({"a": 70}, {"a": 20, "b": 80}, {"a": 9, "b": 3, "c": 2, "d": 2}):
        with pytest.raises(ValueError, match=r"^select = {}: must be with values of enough"):
            choose_panel_parameters(sizes)


def make_directions(n_points, azimuths=tuple(range(0, 360, 30)), **attributes):
    """Return a dataset of directions over a parameter of a grid."""
    coords = {"saturation": np.linspace(0.0, 1.0, n_points), "wavelength": [500.0]}
    coords |= {"polar_deg": [0.0, 30.0, 60.0], "azimuth_deg": np.array(azimuths, dtype=float)}
    shape = tuple(len(values) for values in coords.values())
    names = ("brdf", "brdf_stderr")
    return xr.Dataset(
        {name: (tuple(coords), np.full(shape, 0.3)) for name in names}, coords,
        {"incidence_deg": 0.0, "estimator": "expansion", **attributes},
    )  # fmt: skip


SIZES = {"saturation": np.linspace(0, 1, 20), "density_kg_m3": np.linspace(200, 800, 40)}
LARGE_FIGURES = [
    ({}, make_large_dataset(SIZES), "800"),
    ({"quantity": ["reflectance", "transmittance"]},
     make_large_dataset({**SIZES, "density_kg_m3": np.linspace(200, 800, 16)},
                  ("reflectance", "transmittance")), "320"),
    ({"kind": "points"}, make_large_dataset(SIZES).isel(wavelength=[0]), "800"),
    ({"kind": "points"}, make_large_dataset({"saturation": [0.0, 1.0]}).isel(
        wavelength=np.zeros(61, dtype=int)).assign_coords(wavelength=np.arange(61.0)), "61"),
    ({"kind": "swatches"}, make_large_dataset({"saturation": range(4), "depth_m": range(100)}),
     "100"),
    ({"kind": "swatches"}, make_large_dataset({"saturation": range(100), "depth_m": range(4)}),
     "100"),
    ({"kind": "lobes"}, make_directions(100), "100"),
    ({"kind": "hemisphere"}, make_directions(30), "30"),
    ({"kind": "principal_plane"}, make_directions(100), "100"),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(LARGE_FIGURES)))
def test_too_large_figures_are_rejected_when_they_are_drawn(number):
    section, dataset, count = LARGE_FIGURES[number]
    with pytest.raises(InvalidValue, match=rf"select = {{}}: must be .* of {count}") as error:
        draw(dataset, **section)
    assert "\n" not in str(error.value) and "figure: none" in str(error.value)


def test_experiments_of_too_large_figures_are_read(tmp_path):
    """Without a figure, and with one: its job reports the limit, and the dataset is kept."""
    assert load_text(tmp_path, make_grid(20, 40)).resolve_figure()["kind"] == "spectra"
    experiment = load_text(tmp_path, "figure: none\n" + make_grid(20, 40))
    assert experiment.figure == {"kind": "none"}
    text = "instrument: {kind: beam_spread, wavelength_nm: [500], half_width_m: 0.1}\n"
    experiment = load_text(tmp_path, "figure: none\n" + text + make_grid(2))
    reloaded = ExperimentConfig.model_validate({**experiment.dump_simulation(), "figure": "none"})
    assert reloaded.dump_simulation() == experiment.dump_simulation()


MEASURED = pd.DataFrame({"wavelength_nm": X, "reflectance": 0.5})
ONE = make_large_dataset({"saturation": [0.0, 1.0]})
OF_GRID = make_directions(2, configuration='{"grid": {"saturation": {}}}')
WRONG_DATA = {
    "several points": ({"kind": "bins"}, OF_GRID,
                       None, r"select = {}: must be with a value of saturation"),
    "wavelengths": ({"wavelength_nm": [1100, 1200]}, ONE, None,
                    r"wavelength_nm = .*wavelengths from 400 to 1000 nm"),
    "quantity": ({"quantity": "btdf"}, ONE, None, r"quantity = 'btdf': must be one of"),
    "no spectrum": ({"quantity": "length"}, ONE.assign(length=0.1), None,
                    r"quantity = 'length': must be one of"),
    "unused setting": ({"kind": "points", "ylim": [0, 1]}, ONE, None,
                       r"ylim = .*left out for kind points .it belongs to principal_plane"),
    "unknown setting": ({"colour": "red"}, ONE, None, r"colour: unknown key"),
    "other columns": ({}, ONE, MEASURED.rename(columns={"reflectance": "albedo"}),
                      r"measured = .*with columns wavelength_nm and reflectance"),
    "per cent": ({}, ONE, 100.0 * MEASURED, r"measured .reflectance. = 50.0: .*per cent"),
    "one limit": ({}, ONE, MEASURED.assign(reflectance_min=0.1), "with both reflectance_min"),
    "limits": ({}, ONE, MEASURED.assign(reflectance_min=0.6, reflectance_max=0.7),
               "with reflectance_min <= reflectance"),
    "many lines": ({}, make_large_dataset({**SIZES, "density_kg_m3": [200, 300, 400, 500]}),
                   MEASURED,
                   r"measured = 'given': must be left out for a figure of more than 60"),
    "no numbers": ({"kind": "range_bias"}, xr.Dataset({"mean_delay": ("a", [1.0])}, {"a": ["x"]}),
                   None, "a parameter with several numbers"),
    "no map": ({"kind": "hemisphere"}, make_directions(1, (0, 180)), None, "8 azimuths"),
    "colours": ({"kind": "swatches"}, ONE.isel(wavelength=slice(4, None)), None, "400 to 780 nm"),
    "no parameter": ({"kind": "swatches"}, make_large_dataset({}), None, "one or two parameters"),
    "no plane": ({"kind": "principal_plane"}, make_directions(1, (0, 90)), None, "0 and 180"),
    "no bins": ({"kind": "bins"}, make_directions(1), None, "'expansion': must be bins"),
    "no polarization": ({"kind": "polarization"}, make_directions(1), None, "without polar"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_DATA)
def test_figures_check_their_data(name):
    section, dataset, measured, message = WRONG_DATA[name]
    with pytest.raises(InvalidValue, match=message) as error:
        draw(dataset, **section, measured=measured)
    assert "\n" not in str(error.value)


def test_settings_of_kinds_are_declared_arguments_of_their_functions():
    for kind, one in FIGURES.items():
        _, *arguments = signature(one.draw).parameters
        assert {*arguments} - {"reference", "prefixes"} == {*list_inputs(one.draw)}, kind


def test_grids_within_the_limits_are_accepted(tmp_path):
    assert load_text(tmp_path, make_grid(40, 4, 5)).resolve_figure()["kind"] == "spectra"
    selected = "figure: {select: {depth_m: 0.1}}\n" + make_grid(20, 4, 50)
    assert load_text(tmp_path, selected).figure["select"] == {"depth_m": 0.1}
    rows = "instrument: {wavelength_nm: [500]}\n" + make_grid(MAX_ROWS)
    assert load_text(tmp_path, rows).resolve_figure()["kind"] == "points"


def test_figure_none_is_the_only_spelling(tmp_path):
    for text, message in (
        ("figure:", r"figure = None: must be a mapping"),
        ("figure: nothing", r"figure = 'nothing': must be a mapping"),
        (
            "figure: {kind: none, legend: a}",
            r"figure\.legend = 'a': must be left out for kind none",
        ),
    ):
        with pytest.raises(ConfigError, match=message):
            load_text(tmp_path, text)
    with pytest.raises(ValueError, match=r"kind = 'none'"):
        draw(make_large_dataset({}), **load_text(tmp_path, "figure: none").resolve_figure())


@pytest.mark.long
@pytest.mark.parametrize(
    ("grid", "quantities", "n_panels"),
    [
        ({"saturation": np.linspace(0, 1, 40), "density_kg_m3": [200.0, 300.0],
          "depth_m": [0.1, 0.2, 0.3]}, ("reflectance",), 6),
        ({"saturation": np.linspace(0, 1, 9), "medium": [f"sand {i}" for i in range(10)]},
         ("reflectance", "transmittance"), 20),
    ],
)  # fmt: skip
def test_many_lines_have_several_panels(grid, quantities, n_panels, tmp_path):
    dataset = make_large_dataset(grid, quantities)
    figure = draw_spectra(dataset, quantities)
    panels_with_lines = [axes for axes in figure.axes if axes.lines]
    assert len(panels_with_lines) == n_panels <= MAX_PANELS
    n_lines = len(grid["saturation"])
    assert all(len(axes.lines) == n_lines <= MAX_LINES for axes in panels_with_lines)
    plotted = np.stack([line.get_ydata() for axes in panels_with_lines for line in axes.lines])
    order = dataset.transpose(*list(grid)[1:], "saturation", "wavelength")
    expected = [order[name].values.reshape(-1, X.size) for name in quantities]
    np.testing.assert_array_equal(plotted, np.concatenate(expected))
    figure.draw_without_rendering()
    titles = [axes.title.get_window_extent() for axes in panels_with_lines]
    assert not any(a.overlaps(b) for i, a in enumerate(titles) for b in titles[:i])
    assert all(box.x1 <= figure.bbox.x1 for box in titles)
    svg = save_figure(figure, tmp_path / "many")[1]
    assert svg.stat().st_size < 4_000_000


def make_index_dataset(materials):
    """Return refractive indices with a given n for each material."""
    n = np.array([[index, index] for index in materials.values()]).T
    axes = {"wavelength": [500.0, 900.0], "material": list(materials)}
    dims = ("wavelength", "material")
    return xr.Dataset({"n": (dims, n), "k": (dims, np.full(n.shape, 1e-6))}, axes)


def list_legend_labels(materials):
    """Return the labels of the legend."""
    figure = draw_refractive_indices(make_index_dataset(materials))
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_materials_common_to_layers_are_shown_once():
    stack = {
        "layers.0.air": 1.0,
        "layers.0.ice": 1.31,
        "layers.1.ice": 1.31,
        "layers.1.water": 1.33,
    }
    assert list_legend_labels(stack) == ["ice", "water"]


def test_materials_that_differ_between_layers_have_labels():
    assert list_legend_labels({"layers.0.ice": 1.3, "layers.1.ice": 1.4}) == [
        "layer 0: ice", "layer 1: ice",
    ]  # fmt: skip


def test_figures_without_materials_have_no_legend():
    assert list_legend_labels({"layers.0.air": 1.0, "layers.0.matrix": 1.5}) == []


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
