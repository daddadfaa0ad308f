"""Signatures without what only the program knows: a default that is made anew reads as empty."""

from __future__ import annotations

from sphinx.application import Sphinx


def readable(
    app: Sphinx, what: str, name: str, obj: object, options: object, given: str, returned: str
) -> tuple[str, str] | None:
    """Return a signature whose default factories are dots."""
    return (given.replace("<factory>", "..."), returned) if given else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Have every signature read."""
    app.connect("autodoc-process-signature", readable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
