"""Kinds of studies: what a class must have, the order of values, and missing experiments."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest
import xarray as xr
from pydantic import Field
from shipped import CONFIG

from splits.core.yaml import read_yaml
from splits.experiments import load_experiments, load_settings
from splits.experiments.config.messages import validate_content
from splits.experiments.config.sections import Number
from splits.experiments.studies import STUDY_KINDS, collect_kinds
from splits.experiments.studies.study import Inputs, Study, StudyProduct, sort_values
from splits.experiments.studies.study_files import MEASURED_SPECTRA

ROOT = Path(__file__).parents[3]
PRODUCTS = {"table": StudyProduct("{study}", "Title")}


def define(fields, **values):
    """Define a kind of study from the annotations of its fields and its class variables."""
    annotations = {"kind": Literal["made"], **fields}
    names = {name: ClassVar for name in values}
    content = {"__annotations__": annotations | names, "__module__": __name__, **values}
    return type(Study)("MadeStudy", (Study,), content)


@pytest.mark.parametrize(
    ("fields", "values", "message"),
    [
        ({"inputs": Inputs}, {"MESSAGE": "Making"}, "a class with PRODUCTS"),
        ({"inputs": Inputs}, {"PRODUCTS": PRODUCTS}, "a class with MESSAGE"),
        ({"inputs": Inputs, "files": dict[str, str]}, {"PRODUCTS": PRODUCTS, "MESSAGE": "Making"},
         "with both a field files and FILES"),
        ({"inputs": Inputs}, {"PRODUCTS": PRODUCTS, "MESSAGE": "Making",
                              "FILES": {"spectra": MEASURED_SPECTRA}},
         "with both a field files and FILES"),
        ({"experiments": list[str]}, {"PRODUCTS": PRODUCTS, "MESSAGE": "Making"},
         "with a field inputs, or with list_experiments"),
    ],
)  # fmt: skip
def test_incomplete_classes_are_rejected(fields, values, message):
    with pytest.raises(ValueError, match=rf"MadeStudy.kind = 'made': must be {message}"):
        define(fields, **values)


def test_two_classes_of_one_kind_are_rejected():
    class Base(Study):
        """Base of two kinds."""

    for name in ("First", "Second"):
        content = {"__annotations__": {"kind": Literal["made"], "inputs": Inputs,
                                       "PRODUCTS": ClassVar, "MESSAGE": ClassVar},
                   "__module__": __name__, "PRODUCTS": PRODUCTS, "MESSAGE": "Making"}  # fmt: skip
        type(Study)(name, (Base,), content)
    with pytest.raises(ValueError, match=r"Second.kind = 'made': must be unique \(First has it\)"):
        collect_kinds(Base)


def test_a_field_of_a_kind_may_be_a_boolean():
    class Switched(Study):
        """A kind with a switch and a number."""

        smooth: bool = Field(False, description="whether to smooth")
        limits: dict[str, tuple[Number, ...]] = Field({}, description="limits by key")

    assert validate_content(Switched, {"kind": "x", "smooth": True}).smooth
    with pytest.raises(ValueError, match=r"limits\.a\[0\] = True: must be a number"):
        validate_content(Switched, {"kind": "x", "limits": {"a": [True]}})


def test_fixed_values_of_bands_are_no_booleans():
    content = {"kind": "bands", "inputs": {"a": "b"}, "fixed": {"incidence_deg": True}}
    with pytest.raises(ValueError, match=r"fixed\.incidence_deg = True: must be a number"):
        validate_content(STUDY_KINDS["bands"], content)


def test_values_are_sorted_by_numbers_or_means():
    dataset = xr.Dataset(
        {"brdf": (("grain_size_um", "facetness", "medium"), np.arange(8.0).reshape(2, 2, 2))},
        {
            "grain_size_um": ["fine", "coarse"],
            "grain_size_um_mean": ("grain_size_um", [100.0, 900.0]),
            "facetness": [0.9, 0.1],
            "medium": ["wet", "dry"],
        },
    )
    axes = ("grain_size_um", "facetness", "medium")
    ordered = sort_values(dataset, axes, descending="grain_size_um")
    assert ordered.grain_size_um.values.tolist() == ["coarse", "fine"]
    assert ordered.facetness.values.tolist() == [0.1, 0.9]
    assert ordered.medium.values.tolist() == ["wet", "dry"]
    assert sort_values(dataset, axes).grain_size_um.values.tolist() == ["fine", "coarse"]


def test_missing_names_are_always_reported():
    config = CONFIG
    shipped, main_file = load_experiments(config / "experiments"), read_yaml(config / "config.yaml")
    assert load_settings(main_file).list_warnings(shipped) == []
    studies = {
        "a": {"kind": "sobol", "inputs": {"snow": "explorer_snoww"}},
        "b": {"kind": "sobol", "group": "exploer", "inputs": {"snow": "explorer_snow"}},
        "c": {"kind": "sobol", "inputs": {"snow": "zzzzzzz"}},
    }
    content = {**main_file, "studies": studies, "explorer": {"snow": "nosuch"}}
    content["explorer_directions"] = {"snow": "explorer_snow_direction"}
    assert load_settings(content).list_warnings(shipped) == [
        "study a is left out: no such experiment: explorer_snoww (did you mean explorer_snow?)",
        "study b is left out: no experiment is in its group exploer",
        "explorer: no such experiment: nosuch",
        "explorer: no such experiment: explorer_snow_direction (did you mean "
        "explorer_snow_directions?)",
        "none of their experiments exists: studies c",
    ]
