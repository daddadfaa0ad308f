"""Reading of user CSV tables, with one-line errors for ambiguous content."""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from splits.core.arrays import check_increasing, read_columns
from splits.core.inputs import check_table_wavelengths
from splits.core.labels import TIME_EXAMPLE, parse_time
from splits.core.validation import (
    InvalidValue,
    expand_path,
    format_key,
    invalid,
    join_names,
    suggest_name,
)

MAX_TABLE_BYTES = 2**25
"""Largest size of a file."""
GAP_MARKERS = ("", "na", "n/a", "nan", "null")
"""Content of table cells without a value, in lower case."""
_NUMBER_PATTERN = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?")


class CsvTable(NamedTuple):
    """Content of a CSV file as text.

    Attributes
    ----------
    key : str
        Key named in error messages.
    path : Path
    allowed : str
        Requirement on the file, for error messages.
    column_names : list of str
        Names of the columns, without duplicates.
    rows : list of list of str
        Fields of each row, one per column.
    line_numbers : list of int
        Line number of each row in the file, counted from 1.
    sha256 : str
        SHA-256 of the content of the file.
    """

    key: str
    path: Path
    allowed: str
    column_names: list[str]
    rows: list[list[str]]
    line_numbers: list[int]
    sha256: str

    def invalid(self, hint: str) -> InvalidValue:
        """Return the error for an invalid file."""
        return invalid(self.key, str(self.path), self.allowed, hint)

    def get_texts(self, name: str) -> list[str]:
        """Return the fields of a column; raise ValueError if the file does not have it."""
        if name not in self.column_names:
            hint = suggest_name(name, self.column_names)
            detail = (
                f"; {hint}" if hint else f" among {join_names(map(format_key, self.column_names))}"
            )
            raise self.invalid(f"no column {name}{detail}")
        column = self.column_names.index(name)
        return [row[column] for row in self.rows]

    def get_times(self, name: str) -> pd.DatetimeIndex:
        """Return a column of times of ISO 8601 in UTC; raise ValueError for any other field."""
        texts = self.get_texts(name)
        # Most rows repeat the time of the row before.
        times = {text: parse_time(text) for text in dict.fromkeys(texts)}
        for field, line in zip(texts, self.line_numbers, strict=True):
            if times[field] is None:
                hint = f"write ISO 8601, such as {TIME_EXAMPLE}"
                raise self.invalid(f"line {line}: {name} is {format_key(field) or 'a gap'}; {hint}")
        return pd.DatetimeIndex([times[text] for text in texts])

    def get_numbers(self, name: str, allow_gaps: bool = False) -> np.ndarray:
        """Return a column of finite numbers; raise ValueError for any other field.

        Parameters
        ----------
        name : str
        allow_gaps : bool
            Whether fields may be empty; gaps are returned as NaN.
        """
        numbers = []
        for field, line in zip(self.get_texts(name), self.line_numbers, strict=True):
            is_gap = field.lower() in GAP_MARKERS
            value = float(field) if _NUMBER_PATTERN.fullmatch(field) else np.nan
            if not math.isfinite(value) and not (is_gap and allow_gaps):
                content = "a gap" if is_gap else format_key(field)
                if field.endswith("%"):
                    content += "; write a fraction, 0.95 for 95 %"
                elif "," in field:
                    content += "; write decimals with a point, thousands without commas"
                raise self.invalid(f"line {line}: {format_key(name)} is {content}")
            numbers.append(value)
        return np.array(numbers)


def is_csv_path(text: str) -> bool:
    """Return whether a text in place of a name is the path of a CSV file."""
    return text.lower().endswith(".csv")


def read_csv(key: str, path: str | Path, required: Sequence[str] = ()) -> CsvTable:
    """Return the content of a CSV file with comments after ``#``.

    Parameters
    ----------
    key : str
        Key named in error messages.
    path : path
    required : sequence of str
        Required columns, named in error messages.

    Raises
    ------
    ValueError
        If the file does not exist, is too large, has no header or no rows, or has a line with more
        or fewer fields than the header.
    """
    path = expand_path(path, key)
    try:
        if path.is_file() and path.stat().st_size > MAX_TABLE_BYTES:
            raise invalid(key, str(path), f"a CSV file of at most {MAX_TABLE_BYTES // 2**20} MiB")
        content = path.read_bytes()
    except OSError:
        raise invalid(key, str(path), "an existing CSV file", f"looked in {Path.cwd()}") from None
    columns = f"{'columns' if len(required) != 1 else 'column'} {', '.join(required)}".rstrip()
    allowed = f"a CSV file with {columns} of finite numbers"
    table = CsvTable(key, path, allowed, [], [], [], hashlib.sha256(content).hexdigest())
    # Comments may be in any encoding.
    text = content.decode("utf-8-sig", errors="replace")
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        # A row may end with a comment.
        row = line.partition("#")[0]
        if table.column_names and '"' not in row:
            line = row
        try:
            # Bytes that are not UTF-8 were replaced by the second character.
            if {"\0", "\ufffd"} & {*line}:
                raise csv.Error("it is not text in UTF-8")
            fields = [field.strip() for field in next(csv.reader([line], strict=True))]
        except csv.Error as error:
            raise table.invalid(f"line {number}: {error}") from None
        if not table.column_names:
            if "" in fields:
                hint = "a comma too many, or numbers of rows? write it with index=False"
                raise table.invalid(f"a column without a name; {hint}")
            duplicates = [name for name in fields if fields.count(name) > 1]
            if duplicates:
                raise table.invalid(f"two columns {format_key(duplicates[0])}")
            table.column_names.extend(fields)
            continue
        if len(fields) != len(table.column_names):
            hint = "commas separate columns, points decimals" if fields[-1] else "a comma too many"
            counts = (
                f"fields in line {number}: {len(fields)}, in the header: {len(table.column_names)}"
            )
            raise table.invalid(f"{counts}; {hint}")
        table.rows.append(fields)
        table.line_numbers.append(number)
    if not table.rows:
        raise table.invalid("it has no rows")
    return table


def read_numeric_csv(key: str, path: str | Path, required: Sequence[str] = ()) -> pd.DataFrame:
    """Return a CSV file of numbers; columns that are not required may have gaps (NaN)."""
    table = read_csv(key, path, required)
    for name in required:
        table.get_numbers(name)
    return pd.DataFrame(
        {name: table.get_numbers(name, allow_gaps=True) for name in table.column_names}
    )


def to_columns(value: Any) -> Any:
    """Return the columns of a DataFrame, with a named index, as a mapping of lists.

    Other values are returned unchanged.
    """
    if not isinstance(value, pd.DataFrame):
        return value
    frame = value if value.index.name is None else value.reset_index()
    return frame.to_dict("list")


def read_user_table(
    key: str, path: str | Path, column_names: Sequence[str]
) -> tuple[list[np.ndarray], str]:
    """Return numeric columns of a CSV file, and the SHA-256 of its content; see `read_csv`.

    The digest identifies the content on any machine; the path does not.

    Parameters
    ----------
    key : str
        Key named in error messages.
    path : path
    column_names : sequence of str
        Columns to read; others are ignored.
    """
    table = read_csv(key, path, column_names)
    return [table.get_numbers(name) for name in column_names], table.sha256


def read_tabulated_function(
    key: str, value: Any, column_names: Sequence[str], alternative: str = ""
) -> tuple[list[np.ndarray], str]:
    """Return the columns of a function that a user tabulates, and the SHA-256 of its file or "".

    Parameters
    ----------
    key : str
        Key named in error messages.
    value : mapping or path
        Two lists or more by name, or the path of a CSV file with these columns.
    column_names : sequence of str
        Names of the columns; the first one, such as wavelength, increases strictly.
    alternative : str
        What else is allowed, for error messages.

    Raises
    ------
    ValueError
        For other names, fewer than two rows, lists of different length, or a first one that does
        not increase.
    """
    digest, columns = "", value
    if isinstance(value, str | Path):
        arrays, digest = read_user_table(key, value, column_names)
        columns = dict(zip(column_names, arrays, strict=True))
    elif not isinstance(value, Mapping) or set(value) != {*column_names}:
        given = sorted(map(str, value)) if isinstance(value, Mapping) else value
        names = ", ".join(column_names)
        raise invalid(key, given, f"{alternative}a mapping of {names}, lists of the same length")
    arrays = read_columns(key, {name: columns[name] for name in column_names})
    check_increasing(f"{key}.{column_names[0]}", arrays[0])
    if column_names[0] == "wavelength_nm":
        check_table_wavelengths(key, arrays[0])
    sizes = [array.size for array in arrays]
    if min(sizes) < max(*sizes, 2):
        counts = [f"{size} {name}" for size, name in zip(sizes, column_names, strict=True)]
        raise invalid(key, ", ".join(counts), "lists of the same length, at least 2")
    return arrays, digest
