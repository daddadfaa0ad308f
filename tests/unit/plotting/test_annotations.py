"""All figures: width, panel letters, conditions, reproducible bytes, independence of pyplot."""

import os
import subprocess
import sys
from functools import cache

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.collections import QuadMesh
from test_figure_directions import BIN_CENTERS
from test_figure_directions import make_dataset as make_directions
from test_figure_lines import X
from test_figure_lines import make_dataset as make_spectra

import splits
from benchmarks.performance import draw_speed_against_error
from splits.plotting import describe_conditions, draw, save_figure
from splits.plotting.grammar import (
    ONE_COLUMN_INCHES,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    format_panel_letter,
)
from splits.plotting.lines import find_coarse_nodes
from workflow.papers.interpretations import draw_interpretation_shifts
from workflow.papers.sensitivity import describe_ranges, draw_sensitivity_bars
from workflow.papers.splitsnow import draw_albedo
from workflow.papers.surface_area import draw_area_law, draw_fitted_spectra

ATTRIBUTES = {
    "medium": "snow", "instrument": "spectrophotometer", "snow_grain_size_um": np.array([300, 750]),
    "snow_density_kg_m3": 275.0, "snow_saturation": 0.05, "snow_depth_m": 0.12,
    "snow_ground": "open", "snow_refractive_index_water": "hale_querry_1973",
    "snow_refractive_index_ice": "warren_brandt_2008", "incidence_deg": 30.0,
    "max_stderr_reached": 0.0019,
}  # fmt: skip
SECTION = {
    "select": {}, "legend": None, "ylim": None, "wavelength_nm": None,
}  # fmt: skip
INFRARED = np.arange(1000.0, 2001.0, 10.0)


def read_notes(figure):
    """Return the text of the notes below a figure on one line."""
    text = next(artist.get_text() for artist in figure.texts if artist.get_gid() == "foot")
    return text.replace("\n", " ").replace("\u00a0", " ")


def make_beam_dataset():
    radius, side = np.geomspace(1e-4, 1e-1, 8), ["reflected", "transmitted"]
    shape = (1, 2, 8)
    return xr.Dataset(
        {
            "profile": (("wavelength", "side", "radius"), np.ones(shape)),
            "profile_stderr": (("wavelength", "side", "radius"), np.full(shape, 0.01)),
            "profile_map": (("wavelength", "side", "x", "y"), np.ones((1, 2, 3, 3))),
        },
        {"wavelength": [600.0], "side": side, "radius": radius, "x": np.arange(3.0),
         "y": np.arange(3.0)},
    )  # fmt: skip


def make_returns(grid):
    """Return reflected light over delays, for a grid and two wavelengths."""
    delay = np.geomspace(1e-11, 1e-8, 6)
    dims, shape = (*grid, "side", "wavelength"), (*map(len, grid.values()), 2, 2)
    moments = {"mean_delay": 1e-10, "mean_delay_stderr": 1e-12}
    variables = {name: (dims, np.full(shape, value)) for name, value in moments.items()}
    for name, value in {"return_rate": 1e8, "return_rate_stderr": 1e6}.items():
        variables[name] = ((*dims, "delay_s"), np.full((*shape, 5), value))
    bounds = np.column_stack([delay[:-1], delay[1:]])
    return xr.Dataset(
        variables,
        {**grid, "side": ["reflected", "transmitted"], "wavelength": [532.0, 1064.0],
         "delay_s": bounds.mean(axis=1), "delay_bounds": (("delay_s", "bounds"), bounds)},
    )  # fmt: skip


def make_many_bins_dataset():
    azimuth = np.arange(0.0, 360.0, 10.0)
    return make_directions(polar=BIN_CENTERS, estimator="bins", azimuth=azimuth)


def make_minerals_dataset():
    shape = (X.size, 2)
    index = {name: (("wavelength", "material"), np.full(shape, 0.1)) for name in "nk"}
    return xr.Dataset(index, {"wavelength": X, "material": ["ice", "water"]})


def make_season():
    """Return spectra of snowpacks over time, one of them without a result."""
    time = pd.date_range("2024-01-01", periods=5)
    values = np.full((5, 2), 0.97)
    values[2] = np.nan
    dims = ("time", "wavelength")
    meanings = {"flag_values": [0, 1], "flag_meanings": "good no_snow"}
    return xr.Dataset(
        {"reflectance": (dims, values), "reflectance_stderr": (dims, np.full((5, 2), 1e-3)),
         "quality_flag": ("time", [0, 0, 1, 0, 0], meanings)},
        {"time": time, "wavelength": [500.0, 1300.0]},
    )  # fmt: skip


def make_views():
    """Return a table of anisotropy factors over directions."""
    axes = {
        "optical_radius_um": [50.0, 200.0], "incidence_deg": np.arange(0.0, 80.0, 10.0),
        "polar_deg": [0.0, 30.0, 60.0], "azimuth_deg": [0.0, 90.0, 180.0],
        "wavelength": np.linspace(400.0, 2500.0, 7),
    }  # fmt: skip
    shape = tuple(map(len, axes.values()))
    values = np.linspace(1.0, 0.1, 7) * np.ones(shape)
    variables = {name: (tuple(axes), value) for name, value in (
        ("anisotropy_factor", values), ("anisotropy_factor_stderr", 1e-3 * values))}  # fmt: skip
    return xr.Dataset(variables, axes)


def make_surface_area_rows():
    row = {"spectrum": "A@10", "area": 20.0, "measured": 0.5, "model": 0.5, "stderr": 0.01,
           "difference": 0.0, "fitted": True}  # fmt: skip
    return pd.DataFrame([row | {"wavelength_nm": x} for x in X])


def make_statements():
    rows = [
        {"combination": number, "interpretation": f"entry_point: {choice}", "set": name,
         "statement": statement,
         "place": "Fig 1", "nearest_water": True, "ours": value, "stderr": 0.01, "bar": 0.1,
         "distance": 10.0 * value}
        for number, (choice, name, value) in enumerate(
            [("uniform", "", 0.2), ("projected", "splitsnow_2021", 0.1)], start=1
        )
        for statement in ("one", "two")
    ]  # fmt: skip
    return pd.DataFrame(rows)


def make_indices():
    dims = ("quantity", "parameter")
    return xr.Dataset(
        {name: (dims, np.full((2, 2), 0.1)) for name in ("msi", "msi_stderr")},
        {"quantity": ["reflectance", "transmittance"], "parameter": ["grain_size", "density"]},
    )


ALBEDO = pd.DataFrame(
    {"depth_m": [0.3, 0.3, 0.05, 0.05], "snow": "natural", "wavelength_nm": [500.0, 600.0] * 2,
     "measured": 0.9, "model": 0.9, "stderr": 0.01, "difference": 0.0}
)  # fmt: skip
LAW = pd.DataFrame({"snow": ["ours", "theirs"], "area": 20.0, "reflectance": 0.3,
                    "stderr": [0.01, np.nan]})  # fmt: skip
SPEED = pd.DataFrame(
    {"method": "vectorized", "medium": "snow", "how": "measured", "error": [0.01, 0.001],
     "seconds": [1.0, 10.0], "deviation_largest": 0.0, "stderr_largest": [0.01, 0.001]}
)  # fmt: skip


def draw_kind(kind, dataset, **section):
    return lambda: draw(dataset(), **SECTION | {"kind": kind} | section)


FIGURES = {
    "spectra": draw_kind("spectra", lambda: make_spectra({"saturation": [0.0, 1.0]})),
    "many spectra": draw_kind("spectra",
                              lambda: make_spectra({"saturation": np.linspace(0.0, 1.0, 9)})),
    "facets": draw_kind("spectra", lambda: make_spectra({"saturation": np.linspace(0, 1, 40),
                                                 "depth_m": [0.1, 0.2]})),
    "colour bar": draw_kind("spectra", lambda: make_spectra({"saturation": np.linspace(0, 1, 20)})),
    "shifts": draw_kind("spectra", lambda: make_spectra({"interpretation": ["default", "a"]})),
    "points": draw_kind("points", lambda: make_spectra({"depth_m": [0.1, 0.2]}, [500.0])),
    "points of many": draw_kind("points", lambda: make_spectra({"depth_m": [0.1, 0.2]}, X)),
    "swatches": draw_kind("swatches", lambda: make_spectra({"depth_m": [0.1, 0.2]},
                                                   np.arange(400.0, 781.0, 10.0))),
    "refractive_index": draw_kind("refractive_index", make_minerals_dataset),
    "principal_plane": draw_kind("principal_plane", make_directions, quantity=["brdf", "btdf"]),
    "plane of two": draw_kind("principal_plane", lambda: make_directions({"depth_m": [0.1, 0.2]})),
    "hemisphere": draw_kind("hemisphere", make_directions),
    "hemispheres": draw_kind("hemisphere", lambda: make_directions({"depth_m": [0.1, 0.2]})),
    "lobes": draw_kind("lobes", make_directions),
    "bins": draw_kind("bins", make_many_bins_dataset),
    "polarization": draw_kind("polarization", make_directions),
    "spread": draw_kind("spread", make_beam_dataset),
    "return": draw_kind("return", lambda: make_returns({"depth_m": [0.1, 0.2]})),
    "range_bias": draw_kind(
        "range_bias", lambda: make_returns({"density_kg_m3": [100.0, 200.0, 300.0],
                                            "medium": ["dune", "beach"]})),
    "measured": lambda: draw_albedo(ALBEDO),
    "surface area": lambda: draw_fitted_spectra(make_surface_area_rows()),
    "law": lambda: draw_area_law(LAW),
    "interpretation": lambda: draw_interpretation_shifts(make_statements()),
    "sensitivity": lambda: draw_sensitivity_bars(make_indices()),
    "speed": lambda: draw_speed_against_error(SPEED),
    "season": draw_kind("season", make_season),
    "views": draw_kind("summary", make_views, quantity=["anisotropy_factor"]),
    "planes of many": draw_kind(
        "principal_plane", lambda: make_directions({"depth_m": [0.1, 0.2, 0.3, 0.4],
                                                    "saturation": [0.0, 0.1]})),
}  # fmt: skip


@cache
def draw_once(kind):
    """Return a drawn figure, which tests share."""
    figure = FIGURES[kind]()
    figure.draw_without_rendering()
    return figure


@pytest.mark.parametrize("kind", FIGURES)
def test_figures_have_column_width_and_readable_text(kind):
    figure = draw_once(kind)
    assert figure.get_figwidth() in (ONE_COLUMN_INCHES, TWO_COLUMNS_INCHES)
    artists = [
        artist
        for artist in figure.findobj(lambda a: hasattr(a, "get_fontsize"))
        if artist.get_text()
    ]
    assert min(artist.get_fontsize() for artist in artists) >= SMALL_FONT_PT
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    letters = [title[:3] for title in titles if title.startswith("(")]
    assert sorted(letters) == [f"({format_panel_letter(i)})" for i in range(len(letters))]
    bars = [axes for axes in figure.axes if hasattr(axes, "_colorbar") or axes.get_label() ==
            "<colorbar>"]  # fmt: skip
    panels = [axes for axes in figure.axes if axes.get_visible() and axes not in bars]
    assert len(letters) in (len(panels), 0)
    assert letters or len(panels) == 1 or kind == "refractive_index"


@pytest.mark.parametrize("kind", FIGURES)
def test_axes_end_above_the_data_and_legends_leave_room(kind):
    figure = draw_once(kind)
    framed = ("refractive_index", "return", "range_bias", "swatches", "interpretation")
    for axes in figure.axes:
        is_map = any(isinstance(mesh, QuadMesh) for mesh in axes.collections) or axes.images
        if axes.name != "rectilinear" or axes.get_label() == "<colorbar>" or is_map:
            continue
        if axes.get_yscale() == "linear" and np.isfinite(axes.dataLim.ymax):
            assert axes.dataLim.ymax < max(axes.get_ylim())
        is_open = not any(axes.spines[side].get_visible() for side in ("top", "right"))
        assert is_open or kind in framed
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
    boxes = [one.get_window_extent() for one in legends if one is not None]
    assert (
        sum(box.width * box.height for box in boxes) < 0.3 * figure.bbox.width * figure.bbox.height
    )


@pytest.mark.parametrize("draw_figure", [
    draw_kind("spectra", lambda: make_spectra({"incidence_deg": np.arange(20.0),
                                               "depth_m": [0.1, 0.2, 0.3, 0.4]})),
    draw_kind("principal_plane", lambda: make_directions({"depth_m": [0.1, 0.2, 0.3, 0.4],
                                                          "saturation": [0.0, 0.1]})),
    draw_kind("hemisphere", lambda: make_directions({"depth_m": [0.1, 0.2]})),
    draw_kind("bins", make_many_bins_dataset),
    draw_kind("spectra", lambda: make_spectra({"saturation": ["default", "0.5"]})),
])  # fmt: skip
def test_titles_of_numbers_name_the_parameter(draw_figure):
    titles = [axes.get_title(loc="left").partition(") ")[2] for axes in draw_figure().axes]
    numeric = [title for title in titles if title and title[-1].isdigit()]
    assert numeric and all(": " in title.replace("\n", " ") for title in numeric)


@pytest.mark.parametrize(("value", "has_one"), [(0.99, True), (0.5, False)])
def test_axes_of_fractions_near_one_show_one(value, has_one):
    dataset = make_spectra({})
    dataset["reflectance"] = xr.full_like(dataset.reflectance, value)
    axes = draw(dataset, **SECTION | {"kind": "spectra"}).axes[0]
    low, high = axes.get_ylim()
    assert low == 0.0 and high > value and (high > 1.0) == has_one
    assert (1.0 in axes.get_yticks()[axes.get_yticks() < high]) == has_one


@pytest.mark.parametrize(
    ("keywords", "text"),
    [
        ({"specific_surface_area_m2_kg": 50}, "specific surface area 50 m²/kg"),
        ({"optical_radius_um": 250}, "optical radius 250 µm"),
        ({"grain_size_um": (100, 200)}, "grains 100–200 µm"),
        ({"optical_radius_um": 500, "liquid_water_content": 0.03}, "liquid water content 0.03"),
        ({"optical_radius_um": 500, "saturation": 0.1}, "water saturation 0.1"),
    ],
)
def test_conditions_state_what_was_written(keywords, text):
    snow = splits.Snow.natural(**keywords)
    attributes = {"medium": "snow"} | {f"snow_{key}": v for key, v in snow.describe().items()}
    found = describe_conditions(make_spectra({}).assign_attrs(attributes)).replace("\u00a0", " ")
    assert text in found and found.count("µm") + found.count("m²/kg") == 1


def test_tables_without_a_principal_plane_are_drawn_as_spectra():
    table = make_views().isel(azimuth_deg=[0, 1])
    section = SECTION | {"kind": "summary", "quantity": ["anisotropy_factor"]}
    assert "wavelength (nm)" in [axes.get_xlabel() for axes in draw(table, **section).axes]
    assert "viewing" in draw(make_views(), **section).axes[1].get_xlabel()


def test_panel_letters_continue_after_z():
    assert [format_panel_letter(i) for i in (0, 25, 26, 27, 52)] == ["a", "z", "aa", "ab", "ba"]


def test_conditions_state_fixed_values():
    dataset = make_spectra({"saturation": [0.0, 1.0]}, [600.0]).assign_attrs(ATTRIBUTES)
    assert describe_conditions(dataset).replace("\u00a0", " ") == (
        "Snow, grains 300–750 µm, density 275 kg m⁻³, water saturation 0.05, depth 0.12 m, "
        "incidence 30°, 600 nm, bands: 2 standard errors; standard error ≤ 0.002"
    )
    panel_values = {
        "depth_m": 0.02,
        "saturation": 0.0,
        "incidence_deg": "diffuse",
        "medium": "dune",
    }
    text = describe_conditions(dataset, panel_values, "").replace("\u00a0", " ")
    assert "dry, depth 0.02 m" in text and "diffuse light" in text and "sample: dune" in text
    assert describe_conditions(make_spectra({})) == ""
    opaque = {"medium": "particle_layer", "particle_layer_opaque": "true",
              "particle_layer_refractive_index": 1.5,
              "particle_layer_optical_thickness": 10.0}  # fmt: skip
    text = describe_conditions(make_spectra({}).assign_attrs(opaque)).replace("\u00a0", " ")
    assert text.startswith("Particle layer, index 1.5, nothing below the surface")
    assert "thickness" not in text


@pytest.mark.parametrize("kind", ["spectra", "hemisphere", "principal_plane", "points"])
@pytest.mark.parametrize("count", [1, 3, 9])
def test_notes_do_not_overlap_panels_or_legends(kind, count):
    grid = {"density_kg_m3": np.linspace(100.0, 900.0, count)}
    directed = kind in ("hemisphere", "principal_plane")
    dataset = make_directions(grid) if directed else make_spectra(grid, INFRARED[::10])
    long_note = "a sentence that is far longer than a line of a figure of one column can be " * 2
    figure = draw(dataset.assign_attrs(ATTRIBUTES), **SECTION, kind=kind, note=long_note)
    figure.draw_without_rendering()
    note = next(artist for artist in figure.texts if artist.get_gid() == "foot")
    assert long_note.strip() in read_notes(figure)
    box = note.get_window_extent()
    assert box.x0 >= 0.0 and box.y0 >= 0.0 and box.x1 <= figure.bbox.x1
    other_artists = [*figure.legends, *figure.axes]
    assert not any(box.overlaps(artist.get_tightbbox()) for artist in other_artists)


def test_coarse_refractive_index_nodes_are_marked():
    dataset = make_spectra({}, INFRARED).assign_attrs(ATTRIBUTES)
    nodes = find_coarse_nodes(dataset)
    assert list(nodes) == ["water (Hale & Querry 1973)", "ice (Warren & Brandt 2008)"]
    np.testing.assert_allclose(nodes["water (Hale & Querry 1973)"], np.arange(1000, 2001, 200))
    assert (np.diff(nodes["ice (Warren & Brandt 2008)"]) > 0.0).all()
    figure = draw(dataset, **SECTION | {"kind": "spectra"})
    (marks, _) = (line for line in figure.axes[0].lines if line.get_marker() == "|")
    np.testing.assert_allclose(marks.get_xdata(), np.arange(1000, 2001, 200))
    assert "water (Hale & Querry 1973, red)" in read_notes(figure)


def test_irrelevant_refractive_index_nodes_are_not_marked():
    dry = make_spectra({}, INFRARED).assign_attrs(ATTRIBUTES | {"snow_saturation": 0.0})
    assert "water (Hale & Querry 1973)" not in find_coarse_nodes(dry)
    coarse_dataset = make_spectra({}, INFRARED[::20]).assign_attrs(ATTRIBUTES)
    assert find_coarse_nodes(coarse_dataset) == {}
    custom_tables = {"snow_refractive_index_water": "my.csv", "snow_refractive_index_ice": "1.3+0j"}
    assert (
        find_coarse_nodes(make_spectra({}, INFRARED).assign_attrs(ATTRIBUTES | custom_tables)) == {}
    )
    assert find_coarse_nodes(make_spectra({}, [500.0]).assign_attrs(ATTRIBUTES)) == {}


def test_ranges_that_a_paper_does_not_state_are_noted():
    pairs = {
        "grain_size": {"low": "100-200", "high": "900-1000", "source": "paper"},
        "density": {"low": 100.0, "high": 500, "source": "ours"},
    }
    text = describe_ranges(pairs)
    assert text == (
        "Ranges stated by the paper: grain size 100–200 to 900–1000 µm; "
        "chosen here, not stated: density 100 to 500 kg m⁻³."
    )
    assert text in read_notes(draw_sensitivity_bars(make_indices(), text))


def test_interpretations_are_shifts_from_the_default_set():
    default, other = draw_interpretation_shifts(make_statements()).axes
    assert default.get_title(loc="left") == "(a) default"
    np.testing.assert_allclose(default.containers[0].lines[0].get_xdata(), 1.0)
    np.testing.assert_allclose(other.containers[0].lines[0].get_xdata(), 1.0)
    assert [t.get_text() for t in default.get_yticklabels()] == [
        "one · Fig 1: 0.1", "two · Fig 1: 0.1",
    ]  # fmt: skip


def test_maps_need_directions_around_the_full_circle():
    for directions in (
        {"azimuth": np.array([0.0, 90.0, 180.0, 270.0])},
        {"azimuth": np.array([0.0, *range(100, 181, 10)])},
        {"polar": np.array([0.0, 30.0])},
    ):
        with pytest.raises(ValueError, match=r"kind = 'hemisphere'.* at least 3 polar"):
            draw(make_directions(**directions), "hemisphere")


SPECTRA_SECTION = {
    "kind": "spectra", "quantity": ["reflectance"], "select": {}, "legend": None, "ylim": None,
    "wavelength_nm": None,
}  # fmt: skip
PROGRAM = """
import matplotlib
before = dict.__getitem__(matplotlib.rcParams, "backend")
from test_annotations import SPECTRA_SECTION, make_spectrum
from splits.plotting import draw, save_figure
from splits.plotting.grammar import pick_colours
save_figure(draw(make_spectrum(), **SPECTRA_SECTION), "one")
pick_colours(3, "medium")
assert dict.__getitem__(matplotlib.rcParams, "backend") == before
import matplotlib.pyplot as plt
assert plt.get_fignums() == []
assert plt.get_backend().lower() == "svg", plt.get_backend()
"""


def make_spectrum():
    x = np.linspace(400.0, 1000.0, 7)
    coords = {"saturation": [0.0, 0.5], "wavelength": x}
    value = np.stack([0.5 + x / 4000.0, 0.3 + x / 4000.0])
    variables = {
        "reflectance": (tuple(coords), value),
        "reflectance_stderr": (tuple(coords), np.full_like(value, 0.01)),
    }
    return xr.Dataset(variables, coords)


def test_figures_are_independent_of_pyplot(tmp_path):
    environment = os.environ | {"MPLBACKEND": "svg"}
    environment.pop("DISPLAY", None)
    environment["PYTHONPATH"] = os.pathsep.join([os.getcwd(), *sys.path])
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, cwd=tmp_path, capture_output=True,
        text=True,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr


def test_figures_have_a_notebook_representation():
    assert draw(make_spectrum(), **SPECTRA_SECTION)._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize("kind", ["spectra", "points", "hemisphere"])
def test_figure_files_are_reproducible(kind, tmp_path):
    section = SPECTRA_SECTION | {"kind": kind}
    if kind == "hemisphere":
        section |= {"quantity": ["brdf"]}
    dataset = make_directions() if kind == "hemisphere" else make_spectrum()
    stems = (tmp_path / "one", tmp_path / "two")
    files = [
        [path.read_bytes() for path in save_figure(draw(dataset, **section), stem)]
        for stem in stems
    ]
    assert files[0] == files[1]
    svg = files[0][1].decode()
    words = "forward" if kind == "hemisphere" else "wavelength (nm)"
    assert words in svg, "text stays text"
    assert "<dc:date>" not in svg
    pdf = files[0][2]
    assert pdf.startswith(b"%PDF") and b"CreationDate" not in pdf


def test_settings_that_are_left_out_have_defaults():
    spectrum = make_spectrum()
    expected = draw(spectrum, **SPECTRA_SECTION).axes[0]
    for section in ({}, {"kind": None}, {"quantity": "reflectance", "measured": None}):
        axes = draw(spectrum, **section).axes[0]
        assert axes.get_ylabel() == expected.get_ylabel()
        assert len(axes.lines) == len(expected.lines)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"kind": "spectrum"}, "kind = 'spectrum': must be one of .*did you mean spectra"),
        ({"knd": "spectra"}, "knd: unknown key, must be one of kind, legend, .*mean kind"),
        ({"quantity": ["albedo"]}, "quantity = 'albedo': must be one of reflectance"),
    ],
)
def test_unknown_settings_raise_one_line(section, message):
    with pytest.raises(ValueError, match=message) as error:
        draw(make_spectrum(), **section)
    assert "\n" not in str(error.value)
