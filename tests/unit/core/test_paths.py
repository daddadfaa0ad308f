"""Paths that no file can have: one line in every function that takes one."""

from __future__ import annotations

import inspect

import pytest
import xarray as xr

import splits
from splits.core.paths import expand_path
from splits.core.validation import InvalidValue
from splits.plotting import save_figure

NAMES = ["a\0b", "\ud800", "~/a\0b"]
CALLS = {
    "load": splits.load, "open_table": splits.open_table, "read_caaml": splits.read_caaml,
    "read_crocus": splits.read_crocus,
    "read_snow_packs": lambda path: splits.read_snow_packs(f"{path}.csv"),
    "save": lambda path: splits.save(xr.Dataset(), f"{path}.nc"),
    "ground": lambda path: splits.Snow(ground=f"{path}.csv"),
    "index": lambda path: splits.Snow(refractive_index={"ice": f"{path}.csv"}),
    "impurity": lambda path: splits.Snow(impurities_ng_g={"mine": {"ng_g": 1, "table": path}}),
    "sky": lambda path: splits.sky(f"{path}.csv", 50.0),
    "matrix": lambda path: splits.ParticleLayer(scattering_matrix=f"{path}.nc"),
    "figure": lambda path: save_figure(None, path),
    "load_medium": lambda path: splits.load_medium(f"{path}.yaml"),
}  # fmt: skip
OTHER_FUNCTIONS = {"build_table"}
"""Public functions with a path and other arguments, which are checked first."""


def test_all_functions_of_paths_are_called():
    found = {
        name
        for name in splits.__all__
        if callable(getattr(splits, name))
        and any("Path" in str(parameter.annotation) for parameter in
                inspect.signature(getattr(splits, name)).parameters.values())
    }  # fmt: skip
    assert found <= {*CALLS} | OTHER_FUNCTIONS


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("path", NAMES)
def test_impossible_paths_raise_one_line(name, path):
    with pytest.raises(InvalidValue, match=r"must be ") as error:
        CALLS[name](path)
    assert str(error.value).isprintable()


def test_names_that_are_no_text_are_possible():
    assert str(expand_path("a\udc80b")) == "a\udc80b"
