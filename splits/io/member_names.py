"""Names of archive members: which are allowed, and which denote the same file."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

from splits.io.ro_crate import (
    METADATA_FILE,
)

ROOT_MEMBERS = (
    METADATA_FILE, "README.md", "LICENSE", "CITATION.cff", "requirements.txt", "versions.json",
    "SHA256SUMS",
)  # fmt: skip
"""Members of the root folder."""
FOLDER_SUFFIXES = {
    "config": (
        ".csv",
        ".dat",
        ".md",
        ".tsv",
        ".txt",
        ".yaml",
        ".yml",
        ".nc",
        ".nc4",
        ".netcdf",
        ".cdf",
        ".caaml",
        ".xml",
    ),
    "data": (".nc",),
    "figures": (".pdf", ".png", ".svg"),
    "tables": (".csv",),
}
"""Allowed suffixes of all other members, by folder.

A file of another name could influence programs that run beside it, or be executed when opened.
"""
MAX_NAME_LENGTH = 1000
MAX_NAME_PART_BYTES = 255
"""Largest number of bytes of a file or folder name."""
_DEVICE_NAME_PATTERN = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


def find_name_problem(name: str) -> str:
    """Return the reason why a member name is not allowed, or an empty text."""
    parts = name.split("/")
    if name.startswith("/") or re.match(r"[A-Za-z]:", name):
        return "an absolute path"
    if ".." in parts:
        return "a path with .."
    if "\\" in name:
        return "a path with a backslash"
    if name.endswith("/"):
        return "a folder"
    if not all(c.isprintable() and c not in ':*?"<>|' for c in name):
        return "a name with characters that not all systems have"
    if any(p in ("", ".") or p[-1] in ". " or _DEVICE_NAME_PATTERN.fullmatch(p) for p in parts):
        return "a name that not all systems have"
    if len(name) > MAX_NAME_LENGTH or max(len(p.encode()) for p in parts) > MAX_NAME_PART_BYTES:
        return "too long a name"
    if parts[0] not in FOLDER_SUFFIXES if len(parts) > 1 else name not in ROOT_MEMBERS:
        return "not a file of an archive"
    if any(part.startswith(".") for part in parts):
        return "a hidden name"
    if len(parts) > 1 and not name.lower().endswith(FOLDER_SUFFIXES[parts[0]]):
        return f"not a file type of {parts[0]}/ in an archive"
    return ""


def find_name_collision(names: Iterable[str]) -> str:
    """Return the first name that denotes the same file or folder as another, or an empty text.

    Some file systems treat names as equal that differ in case or in Unicode normalization.
    """
    seen: dict[str, tuple[str, bool]] = {}
    for name in names:
        parts = name.split("/")
        for depth in range(1, len(parts) + 1):
            path, is_file = "/".join(parts[:depth]), depth == len(parts)
            folded = unicodedata.normalize("NFKC", path).casefold()
            # A folder may occur again with the same spelling; a file may not.
            if folded in seen and (is_file or seen[folded] != (path, is_file)):
                return name
            seen[folded] = (path, is_file)
    return ""
