"""What each kind of study makes, of which experiments, and which tables of numbers it reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from splits.analysis.roles import ANGULAR, ANISOTROPY, LAYER, SAND, SNOW, SURFACE_AREA, Role

FIGURE = (".png", ".svg", ".pdf")
"""What names of figures end in; the report shows the first."""


class Product(NamedTuple):
    """Files that a study makes: their folder, suffixes and usual name."""

    folder: str
    suffixes: tuple[str, ...]
    name: str


def _table(name: str) -> Product:
    return Product("tables", (".csv",), name)


PRODUCTS: dict[str, dict[str, Product]] = {
    "sensitivity": {
        "table": _table("{study}"),
        "chosen": _table("{study}_chosen"),
        "data": Product("data", (".nc",), "{study}_index"),
        "figure": Product("figures", FIGURE, "{study}_index"),
    },
    "agreement": {
        "agreement": _table("{study}"),
        "bands": _table("{study}_bands"),
        "table1": _table("{study}_table1"),
        "table3": _table("{study}_table3"),
        "figure": Product("figures", FIGURE, "{study}_measured"),
    },
    "sand_tables": {
        key: _table(f"{{study}}_{key}") for key in ("trends", "weights", "colours")
    },
    "sand_compositions": {"table": _table("{study}")},
    "readings": {
        "table": _table("{study}"),
        "statements": _table("{study}_statements"),
        "without": _table("{study}_without"),
        "figure": Product("figures", FIGURE, "{study}"),
    },
    "sobol": {"table": _table("{study}"), "figure": Product("figures", FIGURE, "{study}")},
    "bands": {"table": _table("{study}"), "figure": Product("figures", FIGURE, "{study}")},
    "anisotropy": {
        "table": _table("{study}"),
        "misfits": _table("{study}_by_angle"),
        "figure": Product("figures", FIGURE, "{study}"),
    },
    "angular_trends": {"table": _table("{study}")},
    "layer_trends": {"table": _table("{study}")},
    "surface_area": {
        "table": _table("{study}"),
        "law": _table("{study}_law"),
        "figure": Product("figures", FIGURE, "{study}_found"),
        "law_figure": Product("figures", FIGURE, "{study}_law"),
    },
}  # fmt: skip
"""What each kind of study makes, by key; `Study.products` gives other names."""

ROLES: dict[str, Mapping[str, Role]] = {
    "agreement": SNOW, "sand_tables": SAND, "angular_trends": ANGULAR, "layer_trends": LAYER,
    "surface_area": SURFACE_AREA, "anisotropy": ANISOTROPY,
}  # fmt: skip
SOME = ("angular_trends", "layer_trends")
"""Kinds that make what they can of some of their roles."""
OF_TABLES = ("sobol", "bands")
"""Kinds that are made of tables, however they are called."""
FILES = {
    "sensitivity": {"published": "published"},
    "readings": {"published": "published"},
    "agreement": {"published": "published", "aviris": "measured", "letcher": "measured"},
    "surface_area": {"spectra": "measured"},
    "anisotropy": {"directions": "measured"},
}
"""Tables of numbers that a kind of study reads, and their folders beside that of media."""
