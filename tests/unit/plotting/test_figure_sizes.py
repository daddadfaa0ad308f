"""Large grids: several panels, limits, and no figure at all."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from shipped import CONFIG

from splits.core.yaml import ConfigError
from splits.experiments import ExperimentConfig, load_experiment
from splits.plotting import draw, draw_spectra, save_figure
from splits.plotting.panels import MAX_LINES, MAX_PANELS, MAX_ROWS, choose_panel_parameters

MEDIA = CONFIG / "media"
X = np.linspace(400.0, 1000.0, 13)


def make_dataset(grid, quantities=("reflectance",)):
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
        with pytest.raises(
            ValueError, match=r"^figure\.select = {}: must be with values of enough"
        ):
            choose_panel_parameters(sizes)


@pytest.mark.parametrize(
    ("text", "count"),
    [
        (make_grid(20, 40), "800"),
        ("figure: {quantity: [reflectance, transmittance]}\n" + make_grid(20, 16), "320"),
        ("figure: {kind: points}\ninstrument: {wavelength_nm: [500]}\n" + make_grid(20, 16), "320"),
        ("instrument: {wavelength_nm: [500]}\n" + make_grid(20, 40), "800"),
        ("figure: {kind: swatches}\n" + make_grid(4, 100), "100"),
        ("figure: {kind: swatches}\n" + make_grid(100, 4), "100"),
        ("figure: {kind: lobes}\ninstrument: {kind: goniophotometer, wavelength_nm: [500]}\n"
         + make_grid(100), "100"),
        ("instrument: {kind: goniophotometer, wavelength_nm: [500]}\n" + make_grid(100), "100"),
    ],
)  # fmt: skip
def test_too_large_figures_are_rejected_before_the_run(tmp_path, text, count):
    with pytest.raises(
        ConfigError, match=rf"figure\.select = {{}}: must be .* of {count}"
    ) as error:
        load_text(tmp_path, text)
    assert "\n" not in str(error.value) and "figure: none" in str(error.value)
    lines = [line for line in text.splitlines() if not line.startswith("figure")]
    experiment = load_text(tmp_path, "\n".join(["figure: none", *lines]))
    assert experiment.figure.kind == "none"


def test_maps_of_several_points_require_figure_none(tmp_path):
    text = "instrument: {kind: beam_spread, wavelength_nm: [500], half_width_m: 0.1}\n" + make_grid(
        2
    )
    with pytest.raises(ConfigError, match=r"figure\.select"):
        load_text(tmp_path, text)
    experiment = load_text(tmp_path, "figure: none\n" + text)
    reloaded = ExperimentConfig.model_validate({**experiment.dump_simulation(), "figure": "none"})
    assert reloaded.dump_simulation() == experiment.dump_simulation()


def test_too_many_wavelengths_for_points_are_rejected(tmp_path):
    with pytest.raises(ConfigError, match=r"wavelength_nm = '211 wavelengths': must be at most 60"):
        load_text(tmp_path, "figure: {kind: points}\n" + make_grid(2))


def test_grids_within_the_limits_are_accepted(tmp_path):
    assert load_text(tmp_path, make_grid(40, 4, 5)).resolve_figure()["kind"] == "spectra"
    selected = "figure: {select: {depth_m: 0.1}}\n" + make_grid(20, 4, 50)
    assert load_text(tmp_path, selected).figure.select == {"depth_m": 0.1}
    rows = "instrument: {wavelength_nm: [500]}\n" + make_grid(MAX_ROWS)
    assert load_text(tmp_path, rows).resolve_figure()["kind"] == "points"


def test_figure_none_is_the_only_spelling(tmp_path):
    for text, message in (
        ("figure:", r"figure = None: must be a mapping"),
        ("figure: nothing", r"figure = 'nothing': must be a mapping"),
        ("figure: {kind: none, legend: a}", r"figure\.kind = 'none': must be left out with legend"),
    ):
        with pytest.raises(ConfigError, match=message):
            load_text(tmp_path, text)
    with pytest.raises(ValueError, match=r"figure\.kind = 'none'"):
        draw(make_dataset({}), load_text(tmp_path, "figure: none").resolve_figure())


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
    dataset = make_dataset(grid, quantities)
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
