"""Figure files and notebooks: reproducible bytes, and independence of pyplot."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from test_figure_directions import make_dataset as directions

from splits.plotting import draw, save_figure

SECTION = {
    "kind": "spectra", "quantity": ["reflectance"], "select": {}, "legend": None, "ylim": None,
    "wavelength_nm": None,
}  # fmt: skip
PROGRAM = """
import matplotlib
before = dict.__getitem__(matplotlib.rcParams, "backend")
from test_figure_files import SECTION, spectrum
from splits.plotting import draw, save_figure
from splits.plotting.style import pick_colours
save_figure(draw(spectrum(), SECTION), "one")
pick_colours(3, "medium")
assert dict.__getitem__(matplotlib.rcParams, "backend") == before
import matplotlib.pyplot as plt
assert plt.get_fignums() == []
assert plt.get_backend().lower() == "svg", plt.get_backend()
"""


def spectrum():
    x = np.linspace(400.0, 1000.0, 7)
    coords = {"saturation": [0.0, 0.5], "wavelength": x}
    value = np.stack([0.5 + x / 4000.0, 0.3 + x / 4000.0])
    variables = {
        "reflectance": (tuple(coords), value),
        "reflectance_stderr": (tuple(coords), np.full_like(value, 0.01)),
    }
    return xr.Dataset(variables, coords)


def test_a_figure_is_beside_pyplot(tmp_path):
    environment = os.environ | {"MPLBACKEND": "svg"}
    environment.pop("DISPLAY", None)
    here = os.path.dirname(__file__)
    environment["PYTHONPATH"] = os.pathsep.join([here, os.environ.get("PYTHONPATH", os.getcwd())])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, cwd=tmp_path, capture_output=True,
        text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_a_notebook_shows_a_figure():
    assert draw(spectrum(), SECTION)._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize("kind", ["spectra", "points", "hemisphere"])
def test_the_same_data_gives_the_same_bytes(kind, tmp_path):
    section = SECTION | {"kind": kind}
    made_of = directions() if kind == "hemisphere" else spectrum()
    stems = (tmp_path / "one", tmp_path / "two")
    made = [
        [path.read_bytes() for path in save_figure(draw(made_of, section), stem)] for stem in stems
    ]
    assert made[0] == made[1]
    svg = made[0][1].decode()
    words = "forward" if kind == "hemisphere" else "wavelength (nm)"
    assert words in svg, "text stays text"
    assert "<dc:date>" not in svg
    pdf = made[0][2]
    assert pdf.startswith(b"%PDF") and b"CreationDate" not in pdf
