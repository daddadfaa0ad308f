"""Writer of the report: one HTML file with all figures, which loads nothing from elsewhere."""

from __future__ import annotations

import base64
import csv
import io
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from datetime import date
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from PIL import Image

from splits.core.atomic import atomic_write
from splits.core.provenance import (
    PACKAGE_FOLDER,
    get_commit_date,
    get_git_commit,
    get_package_version,
)
from splits.experiments.config.experiment import PAPERS, Place, parse_place
from splits.experiments.report.contents import ReportContents, ReportItem, ReportSection
from splits.plotting.grammar import FIGURE_SUFFIXES

# --------------------------------------------------------------------------------------------------
# Cells of tables.  A value and its standard error share a cell.  Numbers are rounded for reading;
# each cell also holds the text of the CSV file.

MAX_ROWS = 500
"""Number of rows that the page shows of a table."""
MAX_OPEN_ROWS = 12
"""Largest number of rows of a table that is not folded."""
_UNIT_SUFFIXES = {
    "_nm": "nm", "_um": "µm", "_deg": "°", "_kg_m3": "kg/m³", "_percent": "%", "_m": "m",
}  # fmt: skip
_COLOUR_PATTERN = re.compile(r"#[0-9a-f]{6}")
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class HtmlTable(NamedTuple):
    """A table of the page: names of columns, cells, and the number of rows of the file."""

    columns: list[str]
    rows: list[list[Markup]]
    n_rows: int


def read_table(path: Path) -> HtmlTable:
    """Return a CSV table, with at most `MAX_ROWS` rows."""
    with open(path, encoding="utf-8", newline="") as file:
        header, *lines = [*csv.reader(file)] or [[]]
    # Columns of standard errors by those of their values: "x_stderr", or "stderr" after it.
    error_of = {}
    for i, name in enumerate(header):
        value = header[i - 1] if i and name == "stderr" else name.removesuffix("_stderr")
        if value != name and value in header:
            error_of[header.index(value)] = i
    shown = [i for i in range(len(header)) if i not in error_of.values()]
    rows = [
        [make_cell(line[i], line[error_of[i]] if i in error_of else "") for i in shown]
        for line in lines[:MAX_ROWS]
    ]
    return HtmlTable([_format_column(header[i]) for i in shown], rows, len(lines))


def _format_column(name: str) -> str:
    """Return the name of a column in words, with its unit."""
    for suffix, unit in _UNIT_SUFFIXES.items():
        if name.endswith(suffix) and name != suffix:
            return f"{name.removesuffix(suffix).replace('_', ' ')} ({unit})"
    return name.replace("_", " ")


def make_cell(value: str, stderr: str = "") -> Markup:
    """Return the cell of a text of a CSV file, or of a number with its standard error if not 0."""
    number, error = _to_number(value), _to_number(stderr)
    if number is None:
        swatch = Markup('<span class="swatch" style="background:{}"></span>').format(value)
        return Markup("<td>{}{}</td>").format(
            swatch if _COLOUR_PATTERN.fullmatch(value) else "", value
        )
    if not error:
        # At most four significant digits, or more above 100.
        short = value if abs(number) >= 100.0 or len(value) <= 6 else f"{number:.4g}"
        mantissa, _, power = short.partition("e")
        exponent = f"·10{str(int(power)).translate(_SUPERSCRIPTS)}" if power else ""
        text = mantissa.replace("-", "−") + exponent
        return Markup('<td class="number"><data value="{}">{}</data></td>').format(value, text)
    power_of_ten = math.floor(math.log10(max(abs(number), error)))
    power_of_ten = 0 if -4 <= power_of_ten <= 5 else power_of_ten
    scale = 10.0**-power_of_ten
    decimals = max(0, 1 - math.floor(math.log10(error * scale)))
    shown, shown_error = (f"{x * scale:.{decimals}f}".replace("-", "−") for x in (number, error))
    both = Markup(
        '<data value="{}">{}</data> <span class="error">± <data value="{}">{}</data></span>'
    ).format(value, shown, stderr, shown_error)
    if power_of_ten:
        both = Markup("({})·10{}").format(both, str(power_of_ten).translate(_SUPERSCRIPTS))
    return Markup('<td class="number">{}</td>').format(both)


def _to_number(text: str) -> float | None:
    """Return a finite number, or None for any other text."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


# --------------------------------------------------------------------------------------------------
# Statements of the papers with verdicts, by paper and by figure.

VERDICTS = ("agrees", "outside", "at the bar", "not resolved", "not reproducible")
"""Beginnings of the verdicts in the tables."""
MEASURED_ID = "measured"
"""Identifier of comparisons with measured spectra in the tables."""


class PlaceComparison(NamedTuple):
    """Statements at one place of a paper, as variables of the template.

    `figure` is the anchor of the reproduced figure.
    """

    label: str
    anchor: str
    figure: str
    statements: list[dict[str, str]]

    @property
    def counts(self) -> Counter[str]:
        """Number of statements by verdict."""
        return Counter(one["verdict"] for one in self.statements)


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
                with open(folder / table, encoding="utf-8", newline="") as file:
                    for row in csv.DictReader(file):
                        # A place may begin with the name of another paper.
                        named = (
                            k for k, p in PAPERS.items() if row["place"].startswith(p.name + " ")
                        )
                        paper = (
                            MEASURED_ID if row["id"] == MEASURED_ID else next(named, section.key)
                        )
                        rows[paper].append(row)
    titles = {str(key): paper.title for key, paper in PAPERS.items()}
    titles[MEASURED_ID] = "Measured spectra"
    return [
        PaperComparison(key, titles[key], _group_by_place(key, rows[key], figures[key]))
        for key in rows
        if rows[key]
    ]


def _group_by_place(
    key: str, rows: Iterable[Mapping[str, str]], figures: Mapping[str, str]
) -> list[PlaceComparison]:
    """Return the rows of a paper by place, in the order of places."""
    groups: dict[str, PlaceComparison] = {}
    for row in sorted(rows, key=lambda row: parse_place(row["place"])[:3]):
        place, label = row["place"], parse_place(row["place"]).label
        anchor = f"compare-{key}-{len(groups)}"
        group = groups.setdefault(label, PlaceComparison(label, anchor, figures.get(label, ""), []))
        verdict, _, reason = row["verdict"].partition(": ")
        short = place.replace("Fig ", "Figure ").replace("section ", "Section ")
        is_plain = short.replace("Eq ", "Equation ") == label
        in_words = "" if key == MEASURED_ID else "in words"
        group.statements.append({
            "quantity": row["quantity"],
            # The place if it is more than a figure, table or section; why it is not reproducible.
            "remark": "; ".join(filter(None, ["" if is_plain else place, reason])),
            "published": make_cell(row.get("published") or in_words),
            "simulated": make_cell(row["ours"], row["stderr"]),
            "criterion": row["bar"],
            "verdict": next((one for one in VERDICTS if verdict.startswith(one)), verdict),
        })  # fmt: skip
    return list(groups.values())


# --------------------------------------------------------------------------------------------------
# Items of the page, and the page.

MAX_UNCHANGED_BYTES = 300_000
"""Size of a figure above which it is converted to a smaller format."""
THUMBNAIL_WIDTH_PX = 160
MIN_WIDE_PX = 1500
"""Width of a figure above which its caption is below it, not beside it."""
FILE_KINDS = {".png": "PNG", ".svg": "SVG", ".pdf": "PDF", ".nc": "netCDF", ".csv": "CSV"}
SPEED_CAPTION = (
    "Largest standard error of a spectrum against the time on one core, on logarithmic axes. "
    "Filled markers are measured, open ones scaled from another error. Uniform: the papers' "
    "algorithm with the same number of rays at all wavelengths, as the noisiest wavelength "
    "requires. Adaptive: a separate number of rays for each wavelength. Grey: theories, with "
    "their largest deviation from the reference, which is a difference of models."
)
DOCUMENTATION = Path("docs", "index.md")
_MIME_TYPES = {".png": "image/png", ".svg": "image/svg+xml", ".webp": "image/webp"}
_ASSET_FOLDER = Path(__file__).parent


class Picture(NamedTuple):
    """A figure and its thumbnail as data URIs, and its size in pixels."""

    source: str
    thumbnail: str
    width: int
    height: int


class ItemView(NamedTuple):
    """An experiment or a product of a study as the page shows it.

    Attributes
    ----------
    item : ReportItem
    place : Place
        Place in the paper, whose label is empty without one.
    picture : Picture, optional
    tables : list of HtmlTable
    links : list of (str, str)
        Kinds of files, and their paths relative to the page.
    """

    item: ReportItem
    place: Place
    picture: Picture | None
    tables: list[HtmlTable]
    links: list[tuple[str, str]]

    @property
    def is_reproduction(self) -> bool:
        """Whether it is a figure or table of the paper, not a run that serves one."""
        return self.place.is_figure or (self.place.is_table and bool(self.item.tables))

    @property
    def heading(self) -> str:
        """Title with the figure or table of the paper."""
        return f"{self.place.label}: {self.item.title}" if self.is_reproduction else self.item.title

    @property
    def paragraphs(self) -> list[str]:
        """Paragraphs of the caption, which empty lines separate."""
        parts = re.split(r"\n\s*\n", self.item.caption.strip())
        return [" ".join(part.split()) for part in parts if part]


def write_report(contents: ReportContents, path: str | Path) -> None:
    """Write the report of a run.

    Parameters
    ----------
    contents : ReportContents
    path : path
        File in the folder of the results, written atomically.
    """
    path = Path(path)
    environment = Environment(
        loader=FileSystemLoader(_ASSET_FOLDER, encoding="utf-8"),
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    folder = path.parent
    comparisons = compare_papers(contents.sections, folder)
    items = [item for section in contents.sections for item in section.items]
    keys = {section.key for section in contents.sections}
    page = environment.get_template("page.html").render(
        contents=contents,
        has_papers=not keys.isdisjoint(PAPERS),
        has_all_papers={*PAPERS} <= keys,
        n_experiments=sum(item.anchor.startswith("experiment-") for item in items),
        comparisons=comparisons,
        place_of={(one.key, p.label): p for one in comparisons for p in one.places},
        verdicts=VERDICTS,
        sections=[(section, _make_parts(section, folder)) for section in contents.sections],
        speed=_make_speed_view(contents.benchmarks, folder),
        folders=sorted({str(PurePosixPath(p).parent) for p in _list_paths(items)}),
        version=get_package_version(),
        commit=get_git_commit(),
        commit_date=get_commit_date(),
        today=date.today().isoformat(),
        documentation=_locate_documentation(folder),
        style=(_ASSET_FOLDER / "page.css").read_text(encoding="utf-8"),
        script=(_ASSET_FOLDER / "page.js").read_text(encoding="utf-8"),
        max_rows=MAX_ROWS,
        max_open_rows=MAX_OPEN_ROWS,
        min_wide_px=MIN_WIDE_PX,
    )
    with atomic_write(path) as temporary_path:
        temporary_path.write_text(page, encoding="utf-8", newline="\n")


def _make_parts(section: ReportSection, folder: Path) -> dict[str, list[ItemView]]:
    """Return the items of a section by part: figures and tables of a paper, and the others."""
    views = [_make_item_view(item, folder) for item in section.items]
    if section.key not in PAPERS:
        return {"": views}
    parts: dict[str, list[ItemView]] = {
        "Figures": [view for view in views if view.place.is_figure],
        "Tables": [view for view in views if view.is_reproduction and not view.place.is_figure],
        "Supporting runs and tables": [view for view in views if not view.is_reproduction],
    }
    return {title: items for title, items in parts.items() if items}


def _make_item_view(item: ReportItem, folder: Path) -> ItemView:
    """Return what the page shows of an item; rows of comparisons are listed by figure instead."""
    tables = [] if item.is_comparison else [read_table(folder / path) for path in item.tables]
    picture = _make_picture(folder / item.figure) if item.figure else None
    links = [(FILE_KINDS[PurePosixPath(path).suffix], path) for path in _list_paths([item])]
    return ItemView(item, parse_place(item.place), picture, tables, links)


def _list_paths(items: Iterable[ReportItem]) -> list[str]:
    """Return the files of items, relative to the folder of the results."""
    return [
        path
        for item in items
        for path in (
            *(item.figure + suffix for suffix in FIGURE_SUFFIXES if item.figure),
            *item.tables,
            *item.datasets,
        )
    ]


def _make_picture(stem: Path) -> Picture:
    """Return a figure in the smallest of its formats, with its thumbnail.

    Large figures are also converted to WebP without loss.
    """
    files = {suffix: stem.with_name(stem.name + suffix).read_bytes() for suffix in (".png", ".svg")}
    with Image.open(io.BytesIO(files[".png"])) as image:
        picture = image.convert("RGB")
    if min(map(len, files.values())) > MAX_UNCHANGED_BYTES:
        files[".webp"] = _convert_to_webp(picture, lossless=True, method=2)
    suffix = min(files, key=lambda name: len(files[name]))
    width, height = picture.size
    picture.thumbnail((THUMBNAIL_WIDTH_PX, THUMBNAIL_WIDTH_PX), Image.Resampling.LANCZOS)
    thumbnail = _convert_to_webp(picture, quality=60)
    return Picture(_encode(files[suffix], suffix), _encode(thumbnail, ".webp"), width, height)


def _convert_to_webp(picture: Image.Image, **options: Any) -> bytes:
    buffer = io.BytesIO()
    picture.save(buffer, "WEBP", **options)
    return buffer.getvalue()


def _encode(content: bytes, suffix: str) -> str:
    """Return the data URI of an image."""
    return f"data:{_MIME_TYPES[suffix]};base64,{base64.b64encode(content).decode('ascii')}"


def _make_speed_view(paths: Iterable[str], folder: Path) -> ItemView | None:
    """Return the benchmark of time against error, or None without paths."""
    links = [(PurePosixPath(path).name, path) for path in paths]
    figures = [path for path in paths if path.endswith(FIGURE_SUFFIXES[0])]
    if not figures:
        return None
    figure = figures[0].removesuffix(FIGURE_SUFFIXES[0])
    item = ReportItem(
        anchor="speed-figure",
        name=PurePosixPath(figure).name,
        title="Error against time of all methods",
        caption=SPEED_CAPTION,
        figure=figure,
        tables=(f"{figure}_times.csv",),
    )
    return _make_item_view(item, folder)._replace(links=links)


def _locate_documentation(folder: Path) -> str:
    """Return the path from the results to the folder docs of the repository that contains them."""
    repository = PACKAGE_FOLDER.parent
    is_inside = folder.resolve().is_relative_to(repository.resolve())
    if not is_inside or not (repository / DOCUMENTATION).is_file():
        return ""
    relative = os.path.relpath(repository / DOCUMENTATION.parent, folder)
    return Path(relative).as_posix()
