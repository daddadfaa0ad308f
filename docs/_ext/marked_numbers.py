"""Removal of the marks of numbers (`_numbers.marks`) from the pages of the site."""

from __future__ import annotations

from _numbers.marks import MARK_PATTERN
from sphinx.application import Sphinx


def without_marks(app: Sphinx, name: str, source: list[str]) -> None:
    """Remove the marks of the numbers of a page."""
    source[0] = MARK_PATTERN.sub(r"\1", source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the removal of marks from every page."""
    app.connect("source-read", without_marks)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
