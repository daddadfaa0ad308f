"""Large grids: several panels, limits, and no figure at all."""

from __future__ import annotations

from inspect import signature

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from shipped import CONFIG

from splits.core.validation import ConfigError, InvalidValue
from splits.experiments import ExperimentConfig, load_experiment
from splits.plotting import draw, draw_spectra, save_figure
from splits.plotting.figure import FUNCTIONS
from splits.plotting.panels import (
    FIGURE_SETTINGS,
    MAX_LINES,
    MAX_PANELS,
    MAX_ROWS,
    choose_panel_parameters,
)

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


def make_directions(n_points, azimuths=tuple(range(0, 360, 30)), **attributes):
    """Return a dataset of directions over a parameter of a grid."""
    coords = {"saturation": np.linspace(0.0, 1.0, n_points), "wavelength": [500.0]}
    coords |= {"polar": [0.0, 30.0, 60.0], "azimuth": np.array(azimuths, dtype=float)}
    shape = tuple(len(values) for values in coords.values())
    names = ("brdf", "brdf_stderr")
    return xr.Dataset(
        {name: (tuple(coords), np.full(shape, 0.3)) for name in names}, coords,
        {"incidence_deg": 0.0, "estimator": "expansion", **attributes},
    )  # fmt: skip


SIZES = {"saturation": np.linspace(0, 1, 20), "density_kg_m3": np.linspace(200, 800, 40)}
LARGE_FIGURES = [
    ({}, make_dataset(SIZES), "800"),
    ({"quantity": ["reflectance", "transmittance"]},
     make_dataset({**SIZES, "density_kg_m3": np.linspace(200, 800, 16)},
                  ("reflectance", "transmittance")), "320"),
    ({"kind": "points"}, make_dataset(SIZES).isel(wavelength=[0]), "800"),
    ({"kind": "points"}, make_dataset({"saturation": [0.0, 1.0]}).isel(
        wavelength=np.zeros(61, dtype=int)).assign_coords(wavelength=np.arange(61.0)), "61"),
    ({"kind": "swatches"}, make_dataset({"saturation": range(4), "depth_m": range(100)}), "100"),
    ({"kind": "swatches"}, make_dataset({"saturation": range(100), "depth_m": range(4)}), "100"),
    ({"kind": "lobes"}, make_directions(100), "100"),
    ({"kind": "hemisphere"}, make_directions(30), "30"),
    ({"kind": "principal_plane"}, make_directions(100), "100"),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(LARGE_FIGURES)))
def test_too_large_figures_are_rejected_when_they_are_drawn(number):
    section, dataset, count = LARGE_FIGURES[number]
    with pytest.raises(
        InvalidValue, match=rf"figure\.select = {{}}: must be .* of {count}"
    ) as error:
        draw(dataset, section)
    assert "\n" not in str(error.value) and "figure: none" in str(error.value)


def test_experiments_of_too_large_figures_are_read(tmp_path):
    """Without a figure, and with one: its job reports the limit, and the dataset is kept."""
    assert load_text(tmp_path, make_grid(20, 40)).resolve_figure()["kind"] == "spectra"
    experiment = load_text(tmp_path, "figure: none\n" + make_grid(20, 40))
    assert experiment.figure.kind == "none"
    text = "instrument: {kind: beam_spread, wavelength_nm: [500], half_width_m: 0.1}\n"
    experiment = load_text(tmp_path, "figure: none\n" + text + make_grid(2))
    reloaded = ExperimentConfig.model_validate({**experiment.dump_simulation(), "figure": "none"})
    assert reloaded.dump_simulation() == experiment.dump_simulation()


MEASURED = pd.DataFrame({"wavelength_nm": X, "reflectance": 0.5})
ONE = make_dataset({"saturation": [0.0, 1.0]})
OF_GRID = ONE.assign_attrs(configuration='{"grid": {"saturation": {}}}')
WRONG_DATA = {
    "several points": ({"kind": "lens"}, OF_GRID,
                       None, r"figure\.select = {}: must be with a value of saturation"),
    "wavelengths": ({"wavelength_nm": [1100, 1200]}, ONE, None,
                    r"figure\.wavelength_nm = .*wavelengths from 400 to 1000 nm"),
    "quantity": ({"quantity": "btdf"}, ONE, None, r"figure\.quantity = 'btdf': must be one of"),
    "no spectrum": ({"quantity": "length"}, ONE.assign(length=0.1), None, "one over wavelength"),
    "unused setting": ({"kind": "points", "ylim": [0, 1]}, ONE, None,
                       r"figure\.ylim = .*left out for kind points .it belongs to spectra"),
    "unknown setting": ({"colour": "red"}, ONE, None, r"figure\.colour: unknown key"),
    "other columns": ({}, ONE, MEASURED.rename(columns={"reflectance": "albedo"}),
                      r"figure\.measured = .*with columns wavelength_nm and reflectance"),
    "per cent": ({}, ONE, 100.0 * MEASURED, r"figure\.measured .reflectance. = 50.0: .*per cent"),
    "one limit": ({}, ONE, MEASURED.assign(reflectance_min=0.1), "with both reflectance_min"),
    "limits": ({}, ONE, MEASURED.assign(reflectance_min=0.6, reflectance_max=0.7),
               "with reflectance_min <= reflectance"),
    "many lines": ({}, make_dataset({**SIZES, "density_kg_m3": [200, 300, 400, 500]}), MEASURED,
                   r"figure\.measured = 'given': must be left out for a figure of more than 60"),
    "no numbers": ({"kind": "range_bias"}, xr.Dataset({"mean_delay": ("a", [1.0])}, {"a": ["x"]}),
                   None, "a parameter with several numbers"),
    "no map": ({"kind": "hemisphere"}, make_directions(1, (0, 180)), None, "8 azimuths"),
    "colours": ({"kind": "swatches"}, ONE.isel(wavelength=slice(4, None)), None, "400 to 780 nm"),
    "no parameter": ({"kind": "swatches"}, make_dataset({}), None, "one or two parameters"),
    "no plane": ({"kind": "principal_plane"}, make_directions(1, (0, 90)), None, "0 and 180"),
    "no bins": ({"kind": "bins"}, make_directions(1), None, "'expansion': must be bins"),
    "no polarization": ({"kind": "polarization"}, make_directions(1), None, "without polar"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_DATA)
def test_figures_check_their_data(name):
    section, dataset, measured, message = WRONG_DATA[name]
    with pytest.raises(InvalidValue, match=message) as error:
        draw(dataset, section, measured)
    assert "\n" not in str(error.value)


def test_settings_of_kinds_are_arguments_of_their_functions():
    for kind, function in FUNCTIONS.items():
        _, *arguments = signature(function).parameters
        assert {*arguments} == {*FIGURE_SETTINGS[kind]}, kind
    assert FUNCTIONS.keys() == FIGURE_SETTINGS.keys()


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
        (
            "figure: {kind: none, legend: a}",
            r"figure\.legend = 'a': must be left out for kind none",
        ),
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
