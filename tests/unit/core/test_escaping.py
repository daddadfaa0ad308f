"""User text, hostile or harmless, is escaped for every program that interprets it."""

import html
import json
import re

import matplotlib.text
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.figure import Figure

from splits.core.escaping import (
    escape_cell,
    escape_json,
    escape_markdown,
    escape_mathtext,
    write_data_frame,
)
from splits.core.validation import ConfigError
from splits.experiments import load_experiments, load_settings
from splits.plotting import draw_spectra
from splits.plotting.grammar import format_parameter, format_value, use_style
from splits.plotting.lines import draw_shifts
from splits.tables.conversions import write_csv
from workflow.papers.information import draw_band_selection, draw_sobol_indices
from workflow.papers.sensitivity import draw_sensitivity_bars
from workflow.papers.surface_area import draw_fitted_spectra

WORDS = [
    "</script><script>alert(1)</script>", "<!-- <script>", "<img src=x onerror=alert(1)>",
    "a < b & c > d", "&lt;b&gt;", "&amp;", '"quoted" and \'quoted\'', "*half", "r_", "|y|", "`tick",
    "``two``", "[1]_",
    ":sup:`2`", "https://example.org/a_b", "Ångström µ 積雪", "a\\b", "\\", "{x}",
    "{{ snakemake }}", "{% raw %}", "$x$", "$5", r"$\frac$", "a_$b^$", r"\$", "=1+1", "@sum", "%d",
    "..", "- a", "1. a", "* a", "> a", "# a", "::", "--", "====", "a_ b__", "| a", "_a_", "__x__",
]  # fmt: skip
"""Markup, formulas and harmless text."""


@pytest.mark.parametrize("text", WORDS)
def test_json_contains_no_html(text):
    source = escape_json({text: [text, 1.5, float("inf"), None]})
    assert "<" not in source
    assert json.loads(source) == {text: [text, 1.5, float("inf"), None]}


@pytest.mark.parametrize("text", WORDS)
def test_markdown_is_rendered_as_plain_text(text):
    parser = pytest.importorskip("markdown_it").MarkdownIt("commonmark")
    rendered = parser.render(f"Authors: {escape_markdown(text)}, and others.")
    assert set(re.findall(r"</?(\w+)", rendered)) == {"p"}
    assert html.unescape(rendered) == f"<p>Authors: {text}, and others.</p>\n"


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        ("=1+1", "'=1+1"), ("@sum(A1)", "'@sum(A1)"), ("+A1", "'+A1"), ("-2+3", "'-2+3"),
        ("-cmd|' /C calc'!A0", "'-cmd|' /C calc'!A0"), ("\t=1", "'\t=1"), ("\r=1", "'\r=1"),
        ("＝1", "'＝1"), ("-10--5", "'-10--5"), ("-5", "-5"), ("+1e-3", "+1e-3"), ("-inf", "-inf"),
        ("-", "-"), ("a=b", "a=b"), ("300-750", "300-750"), ("ID2081@47", "ID2081@47"), ("", ""),
        (-2.5, -2.5), (None, None), (True, True),
    ],
)  # fmt: skip
def test_csv_cells_are_no_formulas(value, cell):
    assert escape_cell(value) == cell


def test_csv_tables_contain_no_formulas(tmp_path):
    table = pd.DataFrame({"@name": ["=1+1", "fine"], "value": [-1.0, 2.0], "mixed": ["-a", -3.0]})
    original = table.copy()
    write_data_frame(table, tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()
    assert lines == ["'@name,value,mixed", "'=1+1,-1,'-a", "fine,2,-3.0"]
    pd.testing.assert_frame_equal(table, original)


def test_exported_lookup_tables_contain_no_formulas(tmp_path):
    axes = {"ground": ["=1+1", "dry"], "wavelength": [500.0, 600.0]}
    values = (("ground", "wavelength"), np.array([[-0.5, 0.25], [0.5, 0.75]]))
    write_csv(xr.Dataset({"reflectance": values}, axes), tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()
    assert lines[:3] == ["ground,wavelength,reflectance", "'=1+1,500,-0.5", "'=1+1,600,0.25"]


# --- figures ----------------------------------------------------------------------------------


def render_mathtext(text):
    """Return the text that matplotlib draws, or fail if it is interpreted as a formula."""
    with use_style():
        artist = matplotlib.text.Text(0, 0, text, figure=Figure())
        plain, is_formula = artist._preprocess_math(text)
    assert not is_formula
    return plain


@pytest.mark.parametrize("text", WORDS)
def test_figures_show_plain_text(text):
    assert render_mathtext(escape_mathtext(text)) == text
    assert render_mathtext(" · ".join([escape_mathtext(text)] * 2)) == f"{text} · {text}"
    assert render_mathtext(format_value(text)) == text.replace("_", " ")
    assert render_mathtext(format_parameter(text)) == text.replace("_", " ")


def make_labelled_dataset(labels, dim="ground"):
    shape = (len(labels), 3)
    variables = {
        "reflectance": ((dim, "wavelength"), np.full(shape, 0.5), {"long_name": "part_$b^$ of it"}),
        "reflectance_stderr": ((dim, "wavelength"), np.full(shape, 0.01)),
    }
    return xr.Dataset(variables, {dim: labels, "wavelength": [500.0, 600.0, 700.0]})


def list_figure_texts(figure):
    figure.canvas.draw()
    return [render_mathtext(artist.get_text()) for artist in figure.findobj(matplotlib.text.Text)]


def test_labels_are_drawn_as_plain_text():
    labels = [r"$\frac$", "a_$b^$", "$x$"]
    texts = list_figure_texts(draw_spectra(make_labelled_dataset(labels)))
    assert {label.replace("_", " ") for label in labels} <= set(texts)
    assert "part_$b^$ of\nit" in texts or "part_$b^$ of it" in texts


@pytest.mark.parametrize("n_before", range(18, 24))
def test_wrapped_dollar_signs_are_no_formula(n_before):
    label = "x" * n_before + "$" + "y" * 5 + r"$\frac$"
    data = make_labelled_dataset(["default", label])
    labels = ("wavelength (nm)", ["reflectance"])
    texts = list_figure_texts(draw_shifts(data, ["reflectance"], "ground", "wavelength", labels))
    assert any(label in text.replace("\n", "") for text in texts)


def make_bands_dataset(name):
    row = ("step", [1.0, 2.0])
    return xr.Dataset(
        {
            "information_bits": row, "information_bits_stderr": row,
            "spread": (("parameter", "step"), [[0.5, 0.2]]),
        },
        {"step": [1, 2], "parameter": [name], "band": ("step", [name, "B2"])},
    )  # fmt: skip


def make_sobol_dataset(label):
    row = (("parameter", "wavelength"), [[0.5, 0.2]])
    names = ("first_order", "first_order_stderr", "total", "total_stderr")
    variables = {name: row for name in names} | {"standard_deviation": ("wavelength", [0.1, 0.2])}
    return xr.Dataset(variables, {"parameter": [label], "wavelength": [500.0, 600.0]})


def make_sensitivity_dataset(name):
    row = (("quantity", "parameter"), [[0.5], [0.2]])
    variables = {"msi": row, "msi_stderr": row}
    return xr.Dataset(
        variables, {"quantity": ["reflectance", "transmittance"], "parameter": [name]}
    )


def make_spectra_table(name):
    columns = ("measured", "model", "stderr", "difference", "area")
    table = pd.DataFrame({"wavelength_nm": [500.0, 600.0], **dict.fromkeys(columns, 0.5)})
    return table.assign(spectrum=f"{name}@30", fitted=True)


@pytest.mark.parametrize(
    "draw_figure",
    [
        lambda name: draw_band_selection({name: make_bands_dataset(name)}, f"known {name}"),
        lambda name: draw_sobol_indices({name: make_sobol_dataset(name)}),
        lambda name: draw_sensitivity_bars(make_sensitivity_dataset(name), f"ranges: {name}"),
        lambda name: draw_fitted_spectra(make_spectra_table(name)),
    ],
    ids=["bands", "sobol", "sensitivity", "surface area"],
)
def test_names_in_figures_are_no_formulas(draw_figure):
    name = r"a$\frac$b"
    assert any(name in text for text in list_figure_texts(draw_figure(name)))


def test_labels_are_not_rendered_by_tex():
    with matplotlib.rc_context({"text.usetex": True}), use_style():
        assert not matplotlib.rcParams["text.usetex"]


# --- configuration ----------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["a{b}", "a</script>", "a\nb", "<b"])
@pytest.mark.parametrize("key", ["results", "experiments_folder", "measured_folder"])
def test_paths_with_wildcard_characters_are_rejected(key, path):
    content = {"accuracies": {"standard": {"max_stderr": 0.01}}, key: path}
    with pytest.raises(ConfigError, match=rf"{key} = .*: must be a path without {{ }} < >"):
        load_settings(content)


def test_table_files_with_wildcard_characters_are_rejected(tmp_path):
    table = tmp_path / "a{b}.csv"
    table.write_text("wavelength_nm,n,k\n200,1.3,0\n3000,1.3,0\n", encoding="utf-8")
    content = {"medium": {"refractive_index": {"ice": str(table)}}}
    (tmp_path / "own.yaml").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"own\.yaml: table = .*: must be a path without { } < >"):
        load_experiments(tmp_path)
    measured = {"figure": {"measured": "a{b}.csv"}}
    (tmp_path / "own.yaml").write_text(json.dumps(measured), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"figure\.measured = .*: must be a path without { } < >"):
        load_experiments(tmp_path)


def test_labels_of_the_explorer_are_one_line():
    content = {"accuracies": {"standard": {"max_stderr": 0.01}}, "explorer": {"a\nb": "deep"}}
    with pytest.raises(ConfigError, match=r"explorer \(key\) = .*control characters"):
        load_settings(content)
