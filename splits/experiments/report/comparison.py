"""Statements of the papers with verdicts, by paper and by figure."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from splits.experiments.config.reproduces import PAPERS, parse_place
from splits.experiments.report.contents import ReportSection
from splits.experiments.report.tables import Cell, make_cell

VERDICTS = ("agrees", "outside", "at the bar", "not resolved", "not reproducible")
"""Beginnings of the verdicts in the tables."""
MEASURED_ID = "measured"
"""Identifier of comparisons with measured spectra in the tables."""
MEASURED_TITLE = "Measured spectra"


class Statement(NamedTuple):
    """A statement of a paper and the simulated number.

    Attributes
    ----------
    quantity : str
    remark : str
        Place in the paper if it is more than a figure, table or section, and the reason why a
        number is not reproducible.
    published, simulated : Cell
    criterion : str
        Range of the simulated number for which the statement is reproduced.
    verdict : str
        One of `VERDICTS`.
    """

    quantity: str
    remark: str
    published: Cell
    simulated: Cell
    criterion: str
    verdict: str


class PlaceComparison(NamedTuple):
    """Statements at one place of a paper; `figure` is the anchor of the reproduced figure."""

    label: str
    anchor: str
    figure: str
    statements: list[Statement]

    @property
    def counts(self) -> Counter[str]:
        """Number of statements by verdict."""
        return Counter(one.verdict for one in self.statements)


class PaperComparison(NamedTuple):
    """All statements of a paper, or all comparisons with measured spectra."""

    key: str
    title: str
    places: list[PlaceComparison]

    @property
    def counts(self) -> Counter[str]:
        """Number of statements by verdict."""
        return sum((place.counts for place in self.places), Counter())


def compare_papers(sections: Iterable[ReportSection], folder: Path) -> list[PaperComparison]:
    """Return the statements of each paper, in the order of its figures.

    Parameters
    ----------
    sections : iterable of ReportSection
    folder : Path
        Folder of the results.
    """
    rows: dict[str, list[Mapping[str, str]]] = {key: [] for key in [*PAPERS, MEASURED_ID]}
    figures: dict[str, dict[str, str]] = {key: {} for key in rows}
    for section in sections:
        for item in section.items:
            if item.place and section.key in figures:
                label = parse_place(item.place).label
                figures[section.key].setdefault(label, item.anchor)
            for table in item.tables if item.is_comparison else ():
                with open(folder / table.path, encoding="utf-8", newline="") as file:
                    for row in csv.DictReader(file):
                        rows[_get_paper(row, section.key)].append(row)
    titles = {key: paper.title for key, paper in PAPERS.items()} | {MEASURED_ID: MEASURED_TITLE}
    return [
        PaperComparison(key, titles[key], _group_by_place(key, rows[key], figures[key]))
        for key in rows
        if rows[key]
    ]


def _get_paper(row: Mapping[str, str], key: str) -> str:
    """Return the key of the paper that a row concerns; its place may begin with another's name."""
    if row["id"] == MEASURED_ID:
        return MEASURED_ID
    named = [other for other, paper in PAPERS.items() if row["place"].startswith(f"{paper.name} ")]
    return named[0] if named else key


def _group_by_place(
    key: str, rows: Iterable[Mapping[str, str]], figures: Mapping[str, str]
) -> list[PlaceComparison]:
    """Return the rows of a paper by place, in the order of places."""
    groups: dict[str, PlaceComparison] = {}
    for row in sorted(rows, key=lambda row: parse_place(row["place"])[:3]):
        label = parse_place(row["place"]).label
        anchor = f"compare-{key}-{len(groups)}"
        group = groups.setdefault(label, PlaceComparison(label, anchor, figures.get(label, ""), []))
        group.statements.append(_make_statement(row))
    return list(groups.values())


def _make_statement(row: Mapping[str, str]) -> Statement:
    place, published = row["place"], row.get("published") or ""
    verdict, _, reason = row["verdict"].partition(": ")
    short = place.replace("Fig ", "Figure ").replace("section ", "Section ")
    is_plain = short.replace("Eq ", "Equation ") == parse_place(place).label
    in_words = Cell("" if row["id"] == MEASURED_ID else "in words")
    return Statement(
        quantity=row["quantity"],
        remark="; ".join(filter(None, ["" if is_plain else place, reason])),
        published=make_cell(published) if published else in_words,
        simulated=make_cell(row["ours"], row["stderr"]),
        criterion=row["bar"],
        verdict=next((one for one in VERDICTS if verdict.startswith(one)), verdict),
    )
