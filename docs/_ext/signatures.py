"""Readable signatures: default factories are shown as dots."""

from __future__ import annotations

from sphinx.application import Sphinx


def readable(
    app: Sphinx, what: str, name: str, obj: object, options: object, given: str, returned: str
) -> tuple[str, str] | None:
    """Return a signature with dots for default factories."""
    return (given.replace("<factory>", "..."), returned) if given else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the processing of signatures."""
    app.connect("autodoc-process-signature", readable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
