"""Model of an experiment file: simulation, published figure, figure, retrieval."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import xarray as xr
from pydantic import (
    Field,
    PlainValidator,
    TypeAdapter,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from splits.core.declarations import MAPPING, Input, Quantity, find_quantity, list_inputs
from splits.core.validation import (
    InvalidValue,
    check_choice,
    check_relations,
    expand_path,
    invalid,
    key_prefix,
    unknown_key,
)
from splits.experiments.config.media import find_label, to_coordinate_values
from splits.experiments.config.retrieval import (
    RetrieveReturnSection,
    RetrieveSection,
    check_retrieval,
)
from splits.experiments.config.sections import (
    Caption,
    ConfigSection,
    MeasuredFile,
    Title,
    match_pattern,
)
from splits.experiments.config.simulation import Name, SimulationConfig
from splits.plotting.figure import FIGURES, check_settings, draw, list_instrument_figures
from splits.plotting.grammar import FIGURE_SUFFIXES
from splits.tables.axes import ALL_QUANTITIES

# --------------------------------------------------------------------------------------------------
# Section `reproduces`: the published figure or table that an experiment reproduces.


class Paper(NamedTuple):
    """A published paper whose results the experiments reproduce."""

    name: str
    """Short name, which may precede a place in the tables of statements: "SPLITS Fig 11"."""
    title: str
    """Heading of the paper in the report."""
    reference: str
    """Bibliographic reference."""


PaperKey = Literal["splits_2007", "splitsnow_2021", "budak_grimailo_2020"]
PAPERS: dict[PaperKey, Paper] = {
    "splits_2007": Paper(
        "SPLITS",
        "SPLITS (sand, 2007)",
        "Kimmel & Baranoski (2007), A novel approach for simulating light interaction with "
        "particulate materials: application to the modeling of sand spectral properties, "
        "Optics Express.",
    ),
    "splitsnow_2021": Paper(
        "SPLITSnow",
        "SPLITSnow (snow, 2021)",
        "Varsa, Baranoski & Kimmel (2021), SPLITSnow: A spectral light transport model for snow, "
        "Remote Sensing of Environment.",
    ),
    "budak_grimailo_2020": Paper(
        "Budak & Grimailo",
        "Budak & Grimailo (rough layers, 2020)",
        "Budak & Grimailo (2020), Light reflection from real surfaces: probabilistic model of the "
        "layer radiance factor, CEUR Workshop Proceedings 2744.",
    ),
}
"""Papers by key, in the order of the report."""

PLACE_PATTERN = re.compile(r"((Fig|Table|Eq) \d{1,3}[a-z]?|section \d{1,3}(\.\d{1,3}){0,3})?")
PLACE_RULE = "Fig, Table, Eq or section and a number, such as Fig 8"
PaperPlace = Annotated[
    str,
    match_pattern(PLACE_PATTERN, PLACE_RULE),
    WithJsonSchema({"type": "string", "pattern": f"^{PLACE_PATTERN.pattern}$"}),
]
_PLACE_KINDS = {"Fig": "Figure", "Table": "Table", "section": "Section", "Eq": "Equation"}
_MENTION_PATTERN = re.compile(r"\b(Fig|Table|section|Eq)s? (\d+(?:\.\d+)*)([a-z]?)\b")


class ReproducesSection(ConfigSection):
    """Published paper, and the figure, table, section or equation in it."""

    paper: PaperKey
    """paper with which the report lists the experiment"""
    place: PaperPlace = ""
    """figure of the paper that the experiment reproduces, such as `Fig 8` or `Fig 24b`; `Table 3`,
    `section 5.2` or `Eq 3` for a run that serves a table or a statement; without it, the report
    lists the experiment among the supporting runs"""


class Place(NamedTuple):
    """Place in a paper; places are ordered by kind and number."""

    kind: int
    """Position of the kind: figure, table, section, equation, other."""
    number: tuple[int, ...]
    letter: str
    label: str
    """Place in words, such as "Figure 8"."""

    @property
    def is_figure(self) -> bool:
        """Whether the place is a figure."""
        return self.kind == 0

    @property
    def is_table(self) -> bool:
        """Whether the place is a table."""
        return self.kind == 1


def parse_place(text: str) -> Place:
    """Return the first figure that a text mentions, otherwise the first table, section or equation.

    Parameters
    ----------
    text : str
        Such as "Fig 20", "Figs 7, 10" or "section 2.1, Fig 6".
    """
    kinds = list(_PLACE_KINDS)
    found = []
    for kind, number, letter in _MENTION_PATTERN.findall(text):
        numbers, label = tuple(map(int, number.split("."))), f"{number}{letter}"
        found.append(Place(kinds.index(kind), numbers, letter, f"{_PLACE_KINDS[kind]} {label}"))
    return min(found, key=lambda place: place.kind, default=Place(len(kinds), (), "", text))


# --------------------------------------------------------------------------------------------------
# Section `figure`; the functions that draw check their data.

INSTRUMENT_QUANTITIES: dict[str, tuple[str, ...]] = {
    "spectrophotometer": ("reflectance", "transmittance", "absorptance", "mean_grain_distance"),
    "goniophotometer": ("brdf", "btdf", "reflectance_factor", "anisotropy_factor", "brdf_dolp"),
    "table": ALL_QUANTITIES,
}
"""Quantities that the figures of an instrument may show."""
MeasuredName = Annotated[
    MeasuredFile | None,
    Quantity(
        "name of a file of `config/measured/` that is drawn with spectra of one panel, with "
        "`wavelength_nm`, the quantity, and optionally its `…_min` and `…_max`",
    ),
]


@cache
def list_figure_inputs() -> dict[str, Input]:
    """Return the inputs of a section `figure` by key: those of `splits.draw` and of all kinds."""
    inputs = dict(list_inputs(draw))
    for one in FIGURES.values():
        inputs |= list_inputs(one.draw) if one.instruments else {}
    meaning = find_quantity(MeasuredName)
    assert meaning is not None
    inputs["measured"] = Input(meaning, TypeAdapter(MeasuredName), None)
    del inputs["dataset"]
    return inputs


def check_figure(content: Any) -> dict[str, Any]:
    """Return the settings of a section `figure` that are given, each in its final form."""
    if content == "none":
        return {"kind": "none"}
    inputs = list_figure_inputs()
    if not isinstance(content, Mapping):
        hint = f"write figure: {{kind: {content}, …}}" if content in FIGURES else ""
        raise invalid("figure", content, MAPPING, hint)
    for key in content:
        if key not in inputs:
            raise unknown_key(f"figure.{key}", inputs)
    if content.get("kind") is not None:
        check_choice("figure.kind", content["kind"], (inputs["kind"].quantity.schema or {})["enum"])
    return {
        key: inputs[key].check(f"figure.{key}", value)
        for key, value in content.items() if value is not None
    }  # fmt: skip


def draw_figure(dataset: xr.Dataset, settings: Mapping[str, Any]) -> Any:
    """Return the figure of an experiment; messages have the keys of its section `figure`."""
    try:
        return draw(dataset, **settings)
    except InvalidValue as error:
        key = re.split(r"\W", error.key, maxsplit=1)[0]
        raise (error.add_prefix("figure") if key in list_figure_inputs() else error) from None


def make_figure_schema() -> dict[str, Any]:
    """Return the JSON schema of a section `figure`."""
    properties = {key: one.make_schema() for key, one in list_figure_inputs().items()}
    name = {"enum": list(dict.fromkeys(itertools.chain(*INSTRUMENT_QUANTITIES.values())))}
    properties["quantity"] |= {"anyOf": [name, {"type": "array", "items": name}]}
    section = {"type": "object", "properties": properties, "additionalProperties": False}
    return {"anyOf": [{"const": "none"}, section]}


# --------------------------------------------------------------------------------------------------
# An experiment.

RESERVED_NAMES = (
    "all", "everything", "archive", "explorer", "explorer_page", "benchmark", "benchmarks",
    "update_docs", "figure", "figure_benchmark", "report", "retrieve",
    "retrieve_return", "natural_grains", "simulate", "table", "table_part",
)  # fmt: skip
"""Names of rules of the workflow, which experiments may not have."""
OWN_GROUP = "own"
"""Group of experiments that name none."""


class ExperimentConfig(SimulationConfig):
    """A simulation with its title, caption, figure and retrieval."""

    group: Name = OWN_GROUP
    """group with which the experiment is selected, see `experiments` in the main file; a name that
    no experiment, study or rule has"""
    reproduces: ReproducesSection | None = None
    """published figure or table that the experiment reproduces"""
    title: Title = ""
    """title in the report of the workflow and in the explorer; plain text"""
    caption: Caption = ""
    """caption of the figure in the report; plain text, an empty line begins a paragraph"""
    figure: Annotated[
        dict[str, Any], PlainValidator(check_figure), WithJsonSchema(make_figure_schema())
    ] = Field(default_factory=dict)
    """settings of the figure, or `none` for no figure"""
    retrieve: RetrieveSection | None = None
    """retrieves parameters from measured spectra with the table of the experiment"""
    retrieve_return: RetrieveReturnSection | None = None
    """retrieves parameters from returns of a pulse with the table of returns of the experiment"""

    @field_validator("name", "group")
    @classmethod
    def _check_name_is_free(cls, value: str, info: ValidationInfo) -> str:
        # The experiments of the explorer may be a group.
        field = str(info.field_name)
        if value in RESERVED_NAMES and (field, value) != ("group", "explorer"):
            allowed = "none of the workflow's rules " + ", ".join(RESERVED_NAMES)
            raise invalid(field, value, allowed)
        return value

    @model_validator(mode="after")
    def _check_sections(self) -> ExperimentConfig:
        """Reject a figure or a retrieval of what the experiment does not have."""
        given, hint = self.figure.keys(), "the figure shows the retrieved parameters"
        for name in ("retrieve", "retrieve_return"):
            if section := getattr(self, name):
                check_retrieval(self, section, name)
                allowed = f"left out with a section {name}"
                check_relations((not given, "figure", sorted(given), allowed, hint))
        self.resolve_figure()
        return self

    @property
    def retrieval(self) -> RetrieveSection | RetrieveReturnSection | None:
        """The section of the retrieval, if there is one."""
        return self.retrieve or self.retrieve_return

    @property
    def has_figure(self) -> bool:
        """Whether a figure shows the results; instruments without figures need no setting."""
        return self.resolve_figure()["kind"] != "none"

    def list_measured_names(self) -> dict[str, str | None]:
        """Return the names of measured files of the sections that may have one."""
        return {
            "figure": self.figure.get("measured"),
            "retrieve": getattr(self.retrieve, "measured", None),
            "retrieve_return": getattr(self.retrieve_return, "measured", None),
        }

    def list_product_paths(self) -> list[str]:
        """Return the files of the experiment, relative to the results folder."""
        figure = f"figures/{self.name}"
        return [
            f"data/{self.name}.nc",
            *(figure + suffix for suffix in FIGURE_SUFFIXES if self.has_figure),
            *([f"tables/{self.name}_retrieved.csv"] if self.retrieval else []),
        ]

    def check_targets(
        self, targets: Iterable[str | Path], inputs: Iterable[str | Path], hint: str = "set name"
    ) -> None:
        """Reject files of results that are a table of the medium, or another input.

        Parameters
        ----------
        targets, inputs : iterable of path
            They need not exist.
        hint : str

        Raises
        ------
        ValueError
            For a result that would replace an input.
        """
        written = [path for path in map(Path, targets) if path.exists()]
        for one in map(expand_path, (*self.list_table_paths(), *inputs)):
            if one.exists() and any(path.samefile(one) for path in written):
                allowed = f"another name: the result would replace the input {one}"
                raise invalid("name", self.name, allowed, hint)

    def resolve_figure(self) -> dict[str, Any]:
        """Return the section `figure` for `splits.draw`, with its kind resolved.

        The selected values are those of the dataset's coordinates.  Kinds, quantities and values
        that the experiment does not have are rejected.
        """
        instrument, grid = self.instrument, self.grid
        kinds = ["season"]
        if not self.has_packs:
            of_instrument = list_instrument_figures(instrument.kind)
            kinds = [kind for kind in of_instrument if kind != "season"] or ["none"]
        is_single = kinds[0] == "spectra" and grid and instrument.get_wavelengths().size == 1
        figure = {"kind": "points" if is_single else kinds[0], **self.figure}
        kind = figure.pop("kind")
        if kind not in (*kinds, "none"):
            allowed = f"one of {', '.join(kinds)} or none for instrument.kind = {instrument.kind!r}"
            raise invalid("figure.kind", kind, allowed)
        with key_prefix("figure"):
            check_settings(kind, {key: one for key, one in figure.items() if key != "note"})
        quantities = instrument.get("quantities") or INSTRUMENT_QUANTITIES.get(instrument.kind, ())
        for quantity in figure.get("quantity", ()):
            check_choice("figure.quantity", quantity, quantities)
        fixed = {}
        for dimension, label in figure.get("select", {}).items():
            if not grid:
                raise invalid("figure.select", dimension, "left out where there is no grid")
            check_choice("figure.select", dimension, grid)
            values = grid[dimension]
            index = list(values).index(find_label(dimension, values, label))
            fixed[dimension] = to_coordinate_values(values)[index].item()
        return {**figure, "kind": kind, **({"select": fixed} if fixed else {})}
