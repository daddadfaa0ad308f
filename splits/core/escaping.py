"""Text of users on its way to programs that read more in it than words.

Titles, captions, labels and names of samples are words.  Each function here makes them stay words
for one interpreter, and is called where text is handed to it, nowhere before.
"""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

_FORMULA_PATTERN = re.compile(r"[=@＝＠\t\r\n]|[+\-＋－](?=.)", re.DOTALL)
"""How cells begin that spreadsheets compute; numbers with a sign are no such cells."""
_MARKDOWN_PATTERN = re.compile(r"[\\`*_\[\]<>&~|$]")
_RST_LESS_THAN = "&lt;"
"""Stands for "<" after `escape_rst`; "&" in a text of its own is escaped, so that none is lost."""


def escape_json(value: Any) -> str:
    """Return a value as JSON that may stand in an element ``script`` of HTML.

    HTML ends such an element at ``</script``, and reads on beyond its end after ``<!-- <script``.
    Any reader of JSON restores the same value.
    """
    return json.dumps(value, ensure_ascii=False).replace("<", "\\u003c")


def escape_rst(text: str) -> str:
    """Return the reStructuredText that shows a text: paragraphs of words, no markup.

    Parameters
    ----------
    text : str
        Empty lines separate paragraphs.

    Returns
    -------
    str
        Without "<": the report of Snakemake also puts parameters of rules into a script as they
        are.  The template of the caption, ``workflow/report/figure.rst``, restores it.
    """
    paragraphs = (" ".join(part.split()) for part in re.split(r"\n\s*\n", text.strip()))
    return "\n\n".join(re.sub(r"[^\w\s]|_", _escape_rst_character, part) for part in paragraphs)


def _escape_rst_character(match: re.Match[str]) -> str:
    """Return one character other than a letter, digit or space in reStructuredText."""
    return _RST_LESS_THAN if match[0] == "<" else "\\" + match[0]


def escape_mathtext(text: str) -> str:
    """Return the text that matplotlib shows as it was given: dollar signs begin no formula."""
    return text.replace("$", r"\$")


def escape_markdown(text: str) -> str:
    """Return the Markdown that shows a text of one line, within a line."""
    return _MARKDOWN_PATTERN.sub(r"\\\g<0>", text)


def escape_cell(value: Any) -> Any:
    """Return a cell of a CSV file that a spreadsheet takes for text, not for a formula.

    Texts that begin as formulas do get an apostrophe in front; numbers remain as they are.
    """
    if not isinstance(value, str) or not _FORMULA_PATTERN.match(value):
        return value
    try:
        float(value)
    except ValueError:
        return "'" + value
    return value if value.isprintable() else "'" + value


def escape_cells(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose texts and column names a spreadsheet does not compute."""
    escaped = table.rename(columns=escape_cell)
    for place, kind in enumerate(table.dtypes):
        if kind.kind == "O":
            escaped.isetitem(place, table.iloc[:, place].map(escape_cell))
    return escaped
