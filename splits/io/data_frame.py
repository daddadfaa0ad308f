"""Atomic writing of tables as CSV files."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from splits.core.atomic import atomic_write
from splits.core.escaping import escape_cells


def write_data_frame(table: pd.DataFrame, path: str | Path) -> None:
    """Write a table as CSV with six significant digits.

    Texts that a spreadsheet would evaluate are prefixed with an apostrophe.
    """
    with atomic_write(path) as temporary_path:
        escape_cells(table).to_csv(temporary_path, index=False, float_format="%.6g")
