"""Figure files and notebooks: reproducible bytes, and independence of pyplot."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from test_figure_directions import make_dataset as make_directions

from splits.plotting import draw, save_figure

SECTION = {
    "kind": "spectra", "quantity": ["reflectance"], "select": {}, "legend": None, "ylim": None,
    "wavelength_nm": None,
}  # fmt: skip
PROGRAM = """
import matplotlib
before = dict.__getitem__(matplotlib.rcParams, "backend")
from test_figure_files import SECTION, make_spectrum
from splits.plotting import draw, save_figure
from splits.plotting.style import pick_colours
save_figure(draw(make_spectrum(), SECTION), "one")
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
    folder = os.path.dirname(__file__)
    environment["PYTHONPATH"] = os.pathsep.join([folder, os.environ.get("PYTHONPATH", os.getcwd())])
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, cwd=tmp_path, capture_output=True,
        text=True,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr


def test_figures_have_a_notebook_representation():
    assert draw(make_spectrum(), SECTION)._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize("kind", ["spectra", "points", "hemisphere"])
def test_figure_files_are_reproducible(kind, tmp_path):
    section = SECTION | {"kind": kind}
    if kind == "hemisphere":
        section |= {"quantity": ["brdf"]}
    dataset = make_directions() if kind == "hemisphere" else make_spectrum()
    stems = (tmp_path / "one", tmp_path / "two")
    files = [
        [path.read_bytes() for path in save_figure(draw(dataset, section), stem)] for stem in stems
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
    expected = draw(spectrum, SECTION).axes[0]
    for section in ({}, {"kind": None}, {"quantity": "reflectance", "measured": None}):
        axes = draw(spectrum, section).axes[0]
        assert axes.get_ylabel() == expected.get_ylabel()
        assert len(axes.lines) == len(expected.lines)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"kind": "spectrum"}, "figure.kind = 'spectrum': must be one of .*did you mean spectra"),
        ({"knd": "spectra"}, "figure.knd: unknown key, must be one of kind, legend, .*mean kind"),
        ({"quantity": ["albedo"]}, "figure.quantity = 'albedo': must be one of reflectance"),
        (None, "figure = None: must be a mapping of settings"),
    ],
)
def test_unknown_settings_raise_one_line(section, message):
    with pytest.raises(ValueError, match=message) as error:
        draw(make_spectrum(), section)
    assert "\n" not in str(error.value)
