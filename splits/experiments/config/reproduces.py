"""Section `reproduces` of an experiment file: the published figure or table that it reproduces."""

from __future__ import annotations

import re
from typing import Annotated, Literal, NamedTuple

from pydantic import WithJsonSchema

from splits.experiments.config.sections import ConfigSection, match_pattern


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
_PLACE_KINDS = {"Fig": "Figure", "Table": "Table", "section": "Section", "Eq": "Equation"}
_MENTION_PATTERN = re.compile(r"\b(Fig|Table|section|Eq)s? (\d+(?:\.\d+)*)([a-z]?)\b")


class ReproducesSection(ConfigSection):
    """Published paper, and the figure, table, section or equation in it."""

    paper: PaperKey
    """paper with which the report lists the experiment"""
    place: Annotated[
        str,
        match_pattern(PLACE_PATTERN, PLACE_RULE),
        WithJsonSchema({"type": "string", "pattern": f"^{PLACE_PATTERN.pattern}$"}),
    ] = ""
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
