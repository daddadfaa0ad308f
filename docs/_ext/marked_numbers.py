"""Marks of numbers (`_numbers.marks`) do not reach the site."""

from __future__ import annotations

from _numbers.marks import MARK_PATTERN
from sphinx.application import Sphinx


def without_marks(app: Sphinx, name: str, source: list[str]) -> None:
    """Leave the numbers of a page and drop their marks."""
    source[0] = MARK_PATTERN.sub(r"\1", source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Have every page read without marks."""
    app.connect("source-read", without_marks)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
