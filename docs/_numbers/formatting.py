"""Selection of numbers from tables and datasets of a run, and their format in documents."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pandas as pd
import xarray as xr

from splits.core.validation import invalid

QuotedValue = tuple[float, float | None, str]
"""A number, its standard error or None, and a name or an empty string."""
RowFilter = dict[str, Any]
"""Values by column or coordinate."""


@dataclass(frozen=True)
class QuotedNumber:
    """A number quoted in documents.

    Attributes
    ----------
    source : str
        Table or dataset below the results folder; empty for constants of the code.
    select : callable
        From the source to a `QuotedValue`.
    format_spec : str
        Format of the number and its error; an error that would be 0 has one digit.
    """

    source: str
    select: Callable[[Any], QuotedValue]
    format_spec: str = ".3f"

    def format_text(self, source: Any) -> str:
        """Return the text of the number in documents."""
        value, stderr, name = self.select(source)
        text = _format_number(value, self.format_spec)
        if stderr is not None:
            error = _format_number(stderr, self.format_spec.lstrip("+"))
            text += f" ± {error if float(error) > 0.0 else _format_number(stderr, '.1g')}"
        return f"{text} ({name.replace('_', ' ')})" if name else text


SUPERSCRIPT_DIGITS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def _format_number(value: float, format_spec: str) -> str:
    """Return a number with a minus sign; 0 is exact, 0.000 is rounded and has no sign."""
    if value == 0.0:
        return "0"
    if format_spec == "power":
        return "10" + f"{value:.0e}".partition("e+")[2].lstrip("0").translate(SUPERSCRIPT_DIGITS)
    text = format(value, format_spec).rstrip(".")
    if float(text) == 0.0:
        text = text.lstrip("+-")
    text = re.sub(r"e([+-])0*(\d)", lambda e: f"e{e[1].lstrip('+')}{e[2]}", text)
    return "−" + text[1:] if text.startswith("-") else text


def filter_rows(table: pd.DataFrame, **where: Any) -> pd.DataFrame:
    """Return the rows with given values; `quantity` matches by prefix."""
    for column, value in where.items():
        if column == "quantity":
            table = table[table[column].str.startswith(value)]
        else:
            table = table[table[column] == value]
    return table


def select_cell(
    column: str, error: str = "", scale: float = 1.0, **where: Any
) -> Callable[[pd.DataFrame], QuotedValue]:
    """Return a selector of a number in the only matching row, with its error."""

    def select(table: pd.DataFrame) -> QuotedValue:
        rows = filter_rows(table, **where)
        if len(rows) != 1:
            raise invalid("rows", len(rows), f"1 of {where}")
        row = rows.iloc[0]
        return scale * row[column], scale * row[error] if error else None, ""

    return select


def select_extreme(
    column: str, error: str = "", largest: bool = True, name: str = "", **where: Any
) -> Callable[[pd.DataFrame], QuotedValue]:
    """Return a selector of the largest or smallest number of matching rows, with its name."""

    def select(table: pd.DataFrame) -> QuotedValue:
        rows = filter_rows(table, **where).reset_index()
        row = rows.loc[rows[column].idxmax() if largest else rows[column].idxmin()]
        return row[column], row[error] if error else None, row[name] if name else ""

    return select


def select_max_magnitude(column: str, **where: Any) -> Callable[[pd.DataFrame], QuotedValue]:
    """Return a selector of the largest absolute value of matching rows."""
    return lambda table: (filter_rows(table, **where)[column].abs().max(), None, "")


def select_row_count(**where: Any) -> Callable[[pd.DataFrame], QuotedValue]:
    """Return a selector of the number of matching rows."""
    return lambda table: (float(len(filter_rows(table, **where))), None, "")


def select_point(
    variable: str, scale: float = 1.0, error: bool = True, attribute: bool = False, **at: Any
) -> Callable[[xr.Dataset], QuotedValue]:
    """Return a selector of a dataset's value at coordinates with its error, or of an attribute."""

    def select(dataset: xr.Dataset) -> QuotedValue:
        if attribute:
            return scale * float(dataset.attrs[variable]), None, ""
        part = dataset.sel(at).squeeze()
        stderr = scale * float(part[f"{variable}_stderr"]) if error else None
        return scale * float(part[variable]), stderr, ""

    return select
