"""Marked numbers in Markdown: finding them, and writing them anew from a run.

A number that a run makes stands before an invisible mark, a comment that holds its key::

    0.56 ± 0.01<!--msi.r.grain_size-->

What the run writes is the number, its sign and its exponent, " ± " and its standard error where it
has one, and a name in round brackets where it has one (``0.48 ± 0.01 (facets any)``).  Units and
everything else around it are the author's.
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
    "<!--([a-z0-9_.]+)-->"
)
"""A marked number, its text and its key."""
COMMENT_START = "<!--"


def list_documents(root: str | Path = ".") -> list[Path]:
    """Return the documents of a clone that may hold marks: README and the pages of docs/."""
    root = Path(root)
    pages = sorted((root / "docs").rglob("*.md"))
    return [root / "README.md", *(p for p in pages if "_build" not in p.parts)]


def find_marks(document: str) -> list[tuple[str, str]]:
    """Return key and text of every marked number of a document, in their order.

    Raises
    ------
    ValueError
        For a comment that is no mark, or that no number stands before.
    """
    for line in document.splitlines():
        if len(MARK_PATTERN.findall(line)) < line.count(COMMENT_START):
            allowed = "a number before each comment, which holds its key (0.56 ± 0.01<!--key-->)"
            raise invalid("mark", line, allowed)
    return [(key, text) for text, key in MARK_PATTERN.findall(document)]


def replace_marked_numbers(document: str, texts: Mapping[str, str]) -> str:
    """Return a document with new texts before its marks.

    Raises
    ------
    ValueError
        For a key without a text, and as `find_marks`.
    """
    for key, _ in find_marks(document):
        if key not in texts:
            raise invalid("mark", key, "a key of docs/_numbers/values.py with a text of a run")
    return MARK_PATTERN.sub(lambda found: f"{texts[found[2]]}<!--{found[2]}-->", document)


def update_documents(
    texts: Mapping[str, str], documents: Iterable[str | Path], record: str | Path
) -> list[Path]:
    """Write new texts into documents and into the record of all texts, or change nothing.

    Parameters
    ----------
    texts : mapping
        Text of every key that the run has made; other marks keep what the record says.
    documents : iterable of path
        Markdown files.
    record : path
        JSON file from the keys of all marks to their texts; need not exist.

    Returns
    -------
    list of Path
        The files that have changed; others are not touched.

    Raises
    ------
    ValueError
        As `replace_marked_numbers`, before anything is written.
    OSError
        If a file cannot be read or written.
    """
    record = Path(record)
    old = {Path(path): Path(path).read_text(encoding="utf-8") for path in documents}
    known = json.loads(record.read_text(encoding="utf-8")) if record.exists() else {}
    texts = {**known, **texts}
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
    """Return where a file is written before it takes its place."""
    return path.with_name(f".{path.name}.new")
