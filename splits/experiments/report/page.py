"""Writer of the report: one HTML file with all figures, which loads nothing from elsewhere."""

from __future__ import annotations

import base64
import io
import os
import re
from collections.abc import Iterable
from datetime import date
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from PIL import Image

from splits.core.atomic import atomic_write
from splits.core.provenance import (
    PACKAGE_FOLDER,
    get_commit_date,
    get_git_commit,
    get_package_version,
)
from splits.experiments.config.reproduces import PAPERS, parse_place
from splits.experiments.config.sections import FIGURE_SUFFIXES
from splits.experiments.report.comparison import VERDICTS, compare_papers
from splits.experiments.report.contents import (
    ReportContents,
    ReportItem,
    ReportSection,
    ReportTable,
)
from splits.experiments.report.tables import MAX_ROWS, HtmlTable, read_table

MAX_OPEN_ROWS = 12
"""Largest number of rows of a table that is not folded."""
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

    @property
    def is_narrow(self) -> bool:
        """Whether it has the width of one column in print."""
        return self.width < MIN_WIDE_PX


class TableView(NamedTuple):
    """A table of the page, with a title if it is folded."""

    title: str
    note: str
    content: HtmlTable
    is_folded: bool


class ItemView(NamedTuple):
    """An experiment or a product of a study as the page shows it.

    Attributes
    ----------
    item : ReportItem
    picture : Picture, optional
    tables : list of TableView
    links : list of (str, str)
        Kinds of files, and their paths relative to the page.
    """

    item: ReportItem
    picture: Picture | None
    tables: list[TableView]
    links: list[tuple[str, str]]

    @property
    def place(self) -> str:
        """Place in the paper in words, such as "Figure 8", or an empty text."""
        return parse_place(self.item.place).label

    @property
    def label(self) -> str:
        """Figure of the paper, for the table of contents, or an empty text."""
        return self.place if parse_place(self.item.place).is_figure else ""

    @property
    def is_reproduction(self) -> bool:
        """Whether it is a figure or table of the paper, not a run that serves one."""
        place = parse_place(self.item.place)
        return place.is_figure or (place.is_table and bool(self.item.tables))

    @property
    def heading(self) -> str:
        """Title with the figure or table of the paper."""
        title = self.item.title
        return f"{self.place}: {title}" if self.is_reproduction else title

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
    page = environment.get_template("page.html").render(make_context(contents, path.parent))
    with atomic_write(path) as temporary_path:
        temporary_path.write_text(page, encoding="utf-8", newline="\n")


def make_context(contents: ReportContents, folder: Path) -> dict[str, Any]:
    """Return the variables of the template for the results in a folder."""
    comparisons = compare_papers(contents.sections, folder)
    items = [item for section in contents.sections for item in section.items]
    return {
        "contents": contents,
        "has_papers": any(section.key in PAPERS for section in contents.sections),
        "has_all_papers": {*PAPERS} <= {section.key for section in contents.sections},
        "n_experiments": sum(item.anchor.startswith("experiment-") for item in items),
        "comparisons": comparisons,
        "place_of": {(one.key, p.label): p for one in comparisons for p in one.places},
        "verdicts": VERDICTS,
        "sections": [(section, _make_parts(section, folder)) for section in contents.sections],
        "speed": _make_speed_view(contents.benchmarks, folder),
        "folders": sorted({str(PurePosixPath(p).parent) for p in _list_paths(items)}),
        "version": get_package_version(),
        "commit": get_git_commit(),
        "commit_date": get_commit_date(),
        "today": date.today().isoformat(),
        "documentation": _locate_documentation(folder),
        "style": (_ASSET_FOLDER / "page.css").read_text(encoding="utf-8"),
        "script": (_ASSET_FOLDER / "page.js").read_text(encoding="utf-8"),
        "max_rows": MAX_ROWS,
    }


def _make_parts(section: ReportSection, folder: Path) -> dict[str, list[ItemView]]:
    """Return the items of a section by part: figures and tables of a paper, and the others."""
    views = [_make_item_view(item, folder) for item in section.items]
    if section.key not in PAPERS:
        return {"": views}
    parts: dict[str, list[ItemView]] = {
        "Figures": [view for view in views if view.label],
        "Tables": [view for view in views if view.is_reproduction and not view.label],
        "Supporting runs and tables": [view for view in views if not view.is_reproduction],
    }
    return {title: items for title, items in parts.items() if items}


def _make_item_view(item: ReportItem, folder: Path) -> ItemView:
    tables = []
    for table in () if item.is_comparison else item.tables:
        content = read_table(folder / table.path)
        is_folded = content.n_rows > MAX_OPEN_ROWS
        tables.append(TableView(item.title, table.note, content, is_folded))
    picture = _make_picture(folder / item.figure) if item.figure else None
    links = [(_get_file_kind(path), path) for path in _list_paths([item])]
    return ItemView(item, picture, tables, links)


def _get_file_kind(path: str) -> str:
    suffix = PurePosixPath(path).suffix
    return FILE_KINDS.get(suffix, suffix[1:])


def _list_paths(items: Iterable[ReportItem]) -> list[str]:
    """Return the files of items, relative to the folder of the results."""
    return [
        path
        for item in items
        for path in (
            *(item.figure + suffix for suffix in FIGURE_SUFFIXES if item.figure),
            *(table.path for table in item.tables),
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
        tables=(ReportTable(path=f"{figure}_times.csv"),),
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
