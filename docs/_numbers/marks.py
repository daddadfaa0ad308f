"""Marked numbers in Markdown documents, and their update from a run.

A number from a run precedes an invisible mark, a comment with its key::

    0.56 ± 0.01<!--msi.r.grain_size-->

An update replaces the number with its sign and exponent, " ± " and its standard error if it has
one, and a name in brackets if it has one (``0.48 ± 0.01 (facets any)``).  Units and all other text
remain.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from splits.core.validation import invalid

NUMBER_PATTERN = r"[+−]?\d+(?:\.\d+)?(?:e-?\d+|[⁰¹²³⁴⁵⁶⁷⁸⁹]+)?"
MARK_PATTERN = re.compile(
    rf"(?<![\d.])({NUMBER_PATTERN}(?: ± {NUMBER_PATTERN})?(?: \([a-z][a-z0-9 -]*\))?)"
    r"<!--([a-z0-9_.]+)-->"
)
"""Pattern of a marked number with the groups text and key."""
COMMENT_START = "<!--"


def list_documents(root: str | Path = ".") -> list[Path]:
    """Return the documents that may contain marks: README and the pages of docs/."""
    root = Path(root)
    pages = sorted((root / "docs").rglob("*.md"))
    return [root / "README.md", *(page for page in pages if "_build" not in page.parts)]


def find_marks(document: str) -> list[tuple[str, str]]:
    """Return the key and text of every marked number of a document, in order.

    Raises
    ------
    ValueError
        For a comment that is no mark, or that no number precedes.
    """
    for line in document.splitlines():
        if len(MARK_PATTERN.findall(line)) < line.count(COMMENT_START):
            allowed = "a number before each comment with its key (0.56 ± 0.01<!--key-->)"
            raise invalid("mark", line, allowed)
    return [(key, text) for text, key in MARK_PATTERN.findall(document)]


def replace_marked_numbers(document: str, texts: Mapping[str, str]) -> str:
    """Return a document with the marked numbers replaced.

    Raises
    ------
    ValueError
        For a key without a text, and for errors of `find_marks`.
    """
    for key, _ in find_marks(document):
        if key not in texts:
            raise invalid("mark", key, "a key of docs/_numbers/values.py with a text of a run")
    return MARK_PATTERN.sub(lambda match: f"{texts[match[2]]}<!--{match[2]}-->", document)


def update_documents(
    texts: Mapping[str, str], documents: Iterable[str | Path], record: str | Path
) -> list[Path]:
    """Write new texts into documents and into the record of all texts; on errors, change nothing.

    Parameters
    ----------
    texts : mapping
        Texts by key from the run; other marks keep the text of the record.
    documents : iterable of path
        Markdown files.
    record : path
        JSON file of the texts of all marks by key; it need not exist.

    Returns
    -------
    list of Path
        The changed files; others are not written.

    Raises
    ------
    ValueError
        For errors of `replace_marked_numbers`, before anything is written.
    OSError
        If a file cannot be read or written.
    """
    record = Path(record)
    old = {Path(path): Path(path).read_text(encoding="utf-8") for path in documents}
    recorded = json.loads(record.read_text(encoding="utf-8")) if record.exists() else {}
    texts = {**recorded, **texts}
    new: dict[Path, str] = {}
    used: dict[str, str] = {}
    for path, document in old.items():
        try:
            new[path] = replace_marked_numbers(document, texts)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        used |= {key: texts[key] for key, _ in find_marks(document)}
    old[record] = record.read_text(encoding="utf-8") if record.exists() else ""
    new[record] = json.dumps(dict(sorted(used.items())), ensure_ascii=False, indent=1) + "\n"
    changed = [path for path in new if new[path] != old[path]]
    for path in changed:
        _make_temporary_path(path).write_text(new[path], encoding="utf-8")
    for path in changed:
        os.replace(_make_temporary_path(path), path)
    return changed


def _make_temporary_path(path: Path) -> Path:
    """Return the temporary path of a file."""
    return path.with_name(f".{path.name}.new")
