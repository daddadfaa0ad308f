"""Products, inputs and files of each kind of study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from splits.experiments.config.study_inputs import (
    ANISOTROPY_INPUTS,
    BRDF_INPUTS,
    LAYER_INPUTS,
    SAND_INPUTS,
    SNOW_INPUTS,
    SURFACE_AREA_INPUTS,
    StudyInput,
)

FIGURE_SUFFIXES = (".png", ".svg", ".pdf")
"""File suffixes of figures; the report shows the first."""


class StudyProduct(NamedTuple):
    """Files that a study makes: their folder, suffixes and default name."""

    folder: str
    suffixes: tuple[str, ...]
    name: str


def _make_table_product(name: str) -> StudyProduct:
    return StudyProduct("tables", (".csv",), name)


STUDY_PRODUCTS: dict[str, dict[str, StudyProduct]] = {
    "sensitivity": {
        "table": _make_table_product("{study}"),
        "chosen": _make_table_product("{study}_chosen"),
        "data": StudyProduct("data", (".nc",), "{study}_index"),
        "figure": StudyProduct("figures", FIGURE_SUFFIXES, "{study}_index"),
    },
    "agreement": {
        "agreement": _make_table_product("{study}"),
        "bands": _make_table_product("{study}_bands"),
        "table1": _make_table_product("{study}_table1"),
        "table3": _make_table_product("{study}_table3"),
        "figure": StudyProduct("figures", FIGURE_SUFFIXES, "{study}_measured"),
    },
    "sand_tables": {
        key: _make_table_product(f"{{study}}_{key}") for key in ("trends", "weights", "colours")
    },
    "sand_compositions": {"table": _make_table_product("{study}")},
    "interpretation": {
        "table": _make_table_product("{study}"),
        "statements": _make_table_product("{study}_statements"),
        "without": _make_table_product("{study}_without"),
        "figure": StudyProduct("figures", FIGURE_SUFFIXES, "{study}"),
    },
    "sobol": {
        "table": _make_table_product("{study}"),
        "figure": StudyProduct("figures", FIGURE_SUFFIXES, "{study}"),
    },
    "bands": {
        "table": _make_table_product("{study}"),
        "figure": StudyProduct("figures", FIGURE_SUFFIXES, "{study}"),
    },
    "anisotropy": {
        "table": _make_table_product("{study}"),
        "misfits": _make_table_product("{study}_by_angle"),
        "figure": StudyProduct("figures", FIGURE_SUFFIXES, "{study}"),
    },
    "angular_trends": {"table": _make_table_product("{study}")},
    "layer_trends": {"table": _make_table_product("{study}")},
    "surface_area": {
        "table": _make_table_product("{study}"),
        "law": _make_table_product("{study}_law"),
        "figure": StudyProduct("figures", FIGURE_SUFFIXES, "{study}_found"),
        "law_figure": StudyProduct("figures", FIGURE_SUFFIXES, "{study}_law"),
    },
}
"""Products of each kind of study, by key; `Study.outputs` gives other names."""

STUDY_INPUTS: dict[str, Mapping[str, StudyInput]] = {
    "agreement": SNOW_INPUTS,
    "sand_tables": SAND_INPUTS,
    "angular_trends": BRDF_INPUTS,
    "layer_trends": LAYER_INPUTS,
    "surface_area": SURFACE_AREA_INPUTS,
    "anisotropy": ANISOTROPY_INPUTS,
}
PARTIAL_KINDS = ("angular_trends", "layer_trends")
"""Kinds for which some of the inputs suffice."""
TABLE_KINDS = ("sobol", "bands")
"""Kinds whose inputs are tables with any names."""
STUDY_FILES = {
    "sensitivity": {"published": "published"},
    "interpretation": {"published": "published"},
    "agreement": {"published": "published", "aviris": "measured", "letcher": "measured"},
    "surface_area": {"spectra": "measured"},
    "anisotropy": {"directions": "measured"},
}
"""Tables of numbers that a kind of study reads, and their folders."""
