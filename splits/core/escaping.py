"""Escaping of user text for programs that interpret markup or formulas.

Titles, captions, labels and sample names are plain text.  Each function escapes them for one
interpreter, and is called only where the text is passed to that interpreter.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splits.core.atomic import atomic_write

if TYPE_CHECKING:
    import pandas as pd

_FORMULA_PATTERN = re.compile(r"[=@＝＠\t\r\n]|[+\-＋－](?=.)", re.DOTALL)
"""Start of a field that spreadsheets evaluate as a formula; signed numbers are exempt."""
_MARKDOWN_PATTERN = re.compile(r"[\\`*_\[\]<>&~|$]")


def escape_json(value: Any) -> str:
    """Return a value as JSON that is safe in an HTML ``script`` element.

    HTML ends such an element at ``</script`` and continues past its end after ``<!-- <script``.
    Any JSON parser restores the same value.
    """
    return json.dumps(value, ensure_ascii=False).replace("<", "\\u003c")


def escape_mathtext(text: str) -> str:
    """Return the text with dollar signs escaped, so that matplotlib parses no formula."""
    return text.replace("$", r"\$")


def escape_markdown(text: str) -> str:
    """Return the Markdown of a one-line plain text."""
    return _MARKDOWN_PATTERN.sub(r"\\\g<0>", text)


def escape_cell(value: Any) -> Any:
    """Return a CSV field that spreadsheets read as text, not as a formula.

    Text that begins like a formula gets an apostrophe in front; numbers are unchanged.
    """
    if not isinstance(value, str) or not _FORMULA_PATTERN.match(value):
        return value
    try:
        float(value)
    except ValueError:
        return "'" + value
    return value if value.isprintable() else "'" + value


def escape_cells(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with text and column names escaped by `escape_cell`."""
    escaped = table.rename(columns=escape_cell)
    for column, kind in enumerate(table.dtypes):
        if kind.kind == "O":
            escaped.isetitem(column, table.iloc[:, column].map(escape_cell))
    return escaped


def write_data_frame(table: pd.DataFrame, path: str | Path) -> None:
    """Write a table as CSV with six significant digits, atomically and with escaped cells."""
    with atomic_write(path) as temporary_path:
        escape_cells(table).to_csv(temporary_path, index=False, float_format="%.6g")
