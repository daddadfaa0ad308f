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

from splits.checks import refuse

NUMBER = r"[+−]?\d+(?:\.\d+)?(?:e-?\d+|[⁰¹²³⁴⁵⁶⁷⁸⁹]+)?"
MARKED = re.compile(
    rf"(?<![\d.])({NUMBER}(?: ± {NUMBER})?(?: \([a-z][a-z0-9 -]*\))?)<!--([a-z0-9_.]+)-->"
)
"""A marked number, its text and its key."""
COMMENT = "<!--"


def marked(document: str) -> list[tuple[str, str]]:
    """Return key and text of every marked number of a document, in their order.

    Raises
    ------
    ValueError
        For a comment that is no mark, or that no number stands before.
    """
    for line in document.splitlines():
        if len(MARKED.findall(line)) < line.count(COMMENT):
            allowed = "a number before each comment, which holds its key (0.56 ± 0.01<!--key-->)"
            raise refuse("mark", line, allowed)
    return [(key, text) for text, key in MARKED.findall(document)]


def rewritten(document: str, texts: Mapping[str, str]) -> str:
    """Return a document with new texts before its marks.

    Raises
    ------
    ValueError
        For a key without a text, and as `marked`.
    """
    for key, _ in marked(document):
        if key not in texts:
            raise refuse("mark", key, "a key of splits/analysis/quoted.py with a text of a run")
    return MARKED.sub(lambda found: f"{texts[found[2]]}<!--{found[2]}-->", document)


def write_marked(
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
        As `rewritten`, before anything is written.
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
            new[path] = rewritten(document, texts)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        used |= {key: texts[key] for key, _ in marked(document)}
    old[record] = record.read_text(encoding="utf-8") if record.exists() else ""
    new[record] = json.dumps(dict(sorted(used.items())), ensure_ascii=False, indent=1) + "\n"
    changed = [path for path in new if new[path] != old[path]]
    for path in changed:
        _aside(path).write_text(new[path], encoding="utf-8")
    for path in changed:
        os.replace(_aside(path), path)
    return changed


def _aside(path: Path) -> Path:
    """Return where a file is written before it takes its place."""
    return path.with_name(f".{path.name}.new")
