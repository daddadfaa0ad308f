"""Tables that users give as CSV files."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from splits.checks import refuse
from splits.paths import expand_path


class UserTable(NamedTuple):
    """Columns of a user's file, and the SHA-256 of its content.

    The path says nothing on another machine; the content does.
    """

    columns: list[np.ndarray]
    sha256: str


def columns_of(given: Any) -> Any:
    """Return the columns of a DataFrame as a mapping of lists, with an index that has a name.

    Whatever else a user gives is returned as it is.
    """
    if not isinstance(given, pd.DataFrame):
        return given
    frame = given if given.index.name is None else given.reset_index()
    return frame.to_dict("list")


def user_table(key: str, path: str | Path, names: tuple[str, ...]) -> UserTable:
    """Return columns of numbers of a CSV file with comments after ``#``, or refuse it.

    Parameters
    ----------
    key : str
        What is refused.
    path : path
    names : tuple of str
        Of the columns.

    Raises
    ------
    ValueError
        If the file does not exist, or has not these columns of numbers.
    """
    path = expand_path(path, key)
    try:
        content = path.read_bytes()
    except OSError:
        raise refuse(key, str(path), "an existing CSV file", f"looked in {Path.cwd()}") from None
    try:
        table = pd.read_csv(io.BytesIO(content), comment="#", skipinitialspace=True)
        columns = [table[name].to_numpy(dtype=float) for name in names]
    except (KeyError, ValueError) as error:
        missing = isinstance(error, KeyError)
        hint = f"no column {error}" if missing else " ".join(str(error).split())
        allowed = f"a CSV file with columns {', '.join(names)} of numbers"
        raise refuse(key, str(path), allowed, hint) from None
    return UserTable(columns, hashlib.sha256(content).hexdigest())
