"""CSV tables of the results as cells of an HTML table.

A value and its standard error share a cell.  Numbers are rounded for reading; each cell also holds
the text of the CSV file.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

MAX_ROWS = 500
"""Number of rows that the page shows of a table."""
STDERR_COLUMN = "stderr"
"""Column with the standard errors of the column before it."""
_UNIT_SUFFIXES = {
    "_nm": "nm", "_um": "µm", "_deg": "°", "_kg_m3": "kg/m³", "_percent": "%", "_m": "m",
}  # fmt: skip
_COLOUR_PATTERN = re.compile(r"#[0-9a-f]{6}")
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Part(NamedTuple):
    """A number of a cell as it is shown, and as the file contains it."""

    shown: str
    value: str


class Cell(NamedTuple):
    """A cell of a table.

    Attributes
    ----------
    text : str
        Text of a cell without numbers.
    parts : tuple of Part
        Number, and its standard error.
    exponent : str
        Common power of ten in superscripts, or an empty text.
    colour : str
        Colour that the text denotes, or an empty text.
    """

    text: str = ""
    parts: tuple[Part, ...] = ()
    exponent: str = ""
    colour: str = ""


class HtmlTable(NamedTuple):
    """A table of the page: names of columns, cells, and the number of rows of the file."""

    columns: list[str]
    rows: list[list[Cell]]
    n_rows: int


def read_table(path: Path) -> HtmlTable:
    """Return a CSV table, with at most `MAX_ROWS` rows."""
    with open(path, encoding="utf-8", newline="") as file:
        header, *lines = [*csv.reader(file)] or [[]]
    error_of = _pair_errors(header)
    shown = [i for i in range(len(header)) if i not in error_of.values()]
    rows = [
        [make_cell(line[i], line[error_of[i]] if i in error_of else "") for i in shown]
        for line in lines[:MAX_ROWS]
    ]
    return HtmlTable([_format_column(header[i]) for i in shown], rows, len(lines))


def make_cell(value: str, stderr: str = "") -> Cell:
    """Return the cell of a text of a CSV file, or of a number with its standard error if not 0."""
    if _to_number(value) is None:
        return Cell(value, colour=value if _COLOUR_PATTERN.fullmatch(value) else "")
    number, error = float(value), _to_number(stderr)
    if not error:
        return Cell(parts=(Part(_format_number(value), value),))
    power = math.floor(math.log10(max(abs(number), error)))
    power = 0 if -4 <= power <= 5 else power
    scale = 10.0**-power
    decimals = max(0, 1 - math.floor(math.log10(error * scale)))
    parts = [
        Part(f"{x * scale:.{decimals}f}".replace("-", "−"), text)
        for x, text in ((number, value), (error, stderr))
    ]
    return Cell(parts=tuple(parts), exponent=str(power).translate(_SUPERSCRIPTS) if power else "")


def _pair_errors(header: Sequence[str]) -> dict[int, int]:
    """Return the columns of standard errors by the columns of values."""
    pairs = {}
    for i, name in enumerate(header):
        if name == STDERR_COLUMN and i:
            pairs[i - 1] = i
        elif name.endswith(f"_{STDERR_COLUMN}"):
            value = name.removesuffix(f"_{STDERR_COLUMN}")
            if value in header:
                pairs[header.index(value)] = i
    return pairs


def _to_number(text: str) -> float | None:
    """Return a finite number, or None for any other text."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _format_number(text: str) -> str:
    """Return a number with at most four significant digits, or more if it is above 100."""
    number = float(text)
    short = text if abs(number) >= 100.0 or len(text) <= 6 else f"{number:.4g}"
    mantissa, _, power = short.partition("e")
    exponent = f"·10{str(int(power)).translate(_SUPERSCRIPTS)}" if power else ""
    return mantissa.replace("-", "−") + exponent


def _format_column(name: str) -> str:
    """Return the name of a column in words, with its unit."""
    for suffix, unit in _UNIT_SUFFIXES.items():
        if name.endswith(suffix) and name != suffix:
            return f"{name.removesuffix(suffix).replace('_', ' ')} ({unit})"
    return name.replace("_", " ")
