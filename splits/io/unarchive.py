"""Verification and unpacking of archives from untrusted sources.

An archive is a zip file with an RO-Crate (`splits.experiments.archive`).  All of it is verified:
names, types and sizes of its members, then every byte against the SHA-256 in its metadata.  An
archive is unpacked completely or not at all.  The verification shows that the files are those
listed, not who made the list: compare the SHA-256 of the archive in `ArchiveReport` with a trusted
value.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
import unicodedata
import warnings
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from splits.core.atomic import atomic_write
from splits.core.optional import import_optional
from splits.core.validation import check_relations, expand_path, format_key, invalid, short_repr
from splits.io.ro_crate import METADATA_FILE

ROOT_MEMBERS = (
    METADATA_FILE, "README.md", "LICENSE", "CITATION.cff", "requirements.txt", "versions.json",
    "SHA256SUMS",
)  # fmt: skip
"""Members of the root folder."""
FOLDER_SUFFIXES = {
    "config": (
        ".csv", ".dat", ".md", ".tsv", ".txt", ".yaml", ".yml", ".nc", ".nc4", ".netcdf", ".cdf",
        ".caaml", ".xml",
    ),
    "data": (".nc",),
    "figures": (".pdf", ".png", ".svg"),
    "tables": (".csv",),
}  # fmt: skip
"""Allowed suffixes of all other members, by folder.

A file of another name could influence programs that run beside it, or be executed when opened.
"""
MAX_NAME_LENGTH = 1000
MAX_NAME_PART_BYTES = 255
"""Largest number of bytes of a file or folder name."""
_UNSAFE_PART_PATTERN = re.compile(
    r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?|\..*|.*[. ]|", re.IGNORECASE
)
"""Names of devices, hidden names, and names that not all systems can write."""
MAX_MEMBERS = 20_000
MAX_UNPACKED_BYTES = 2**35
"""Largest total size after unpacking."""
MAX_METADATA_BYTES = 2**26
"""Largest size of the metadata."""
MAX_COMPRESSION_RATIO = 300
"""Largest ratio of the size after unpacking to that of an archive of more than
`MIN_RATIO_CHECK_BYTES` bytes."""
MIN_RATIO_CHECK_BYTES = 2**20
_CHUNK_BYTES = 2**20


class ArchiveError(ValueError):
    """Invalid archive; the message is one line."""


@dataclass(frozen=True)
class ArchiveReport:
    """Summary of a verified archive.

    Attributes
    ----------
    archive : Path
    sha256 : str
        SHA-256 of the archive, for comparison with a trusted value.
    n_files : int
        Number of files, including the metadata.
    n_bytes : int
        Total size of the files in bytes.
    name, date, license : str
        Properties of the root dataset in the metadata.
    """

    archive: Path
    sha256: str
    n_files: int
    n_bytes: int
    name: str
    date: str
    license: str

    def __str__(self) -> str:
        """Return the report in three lines."""
        properties = ", ".join(map(format_key, (self.name, self.date, self.license)))
        counts = f"{self.n_files} files, {self.n_bytes} bytes, every one as listed"
        return f"{self.archive}: {counts}\n{properties}\nSHA-256 of the archive: {self.sha256}"


def verify_archive(archive: str | Path) -> ArchiveReport:
    """Verify an archive completely without unpacking it.

    Parameters
    ----------
    archive : path

    Raises
    ------
    ArchiveError
        A ValueError: if the archive is not a valid zip file or RO-Crate, if its files differ from
        those listed in its metadata, or if a member would be unsafe to unpack.
    OSError
        If the file cannot be read.
    """
    return _read_archive(expand_path(archive, "archive"), None)


def unpack_archive(archive: str | Path, folder: str | Path) -> ArchiveReport:
    """Verify an archive and unpack it into a new folder, atomically.

    Parameters
    ----------
    archive : path
    folder : path
        Must not exist or be empty; its parent folder must exist.

    Raises
    ------
    ArchiveError
        As for `verify_archive`.
    ValueError
        If the folder is not new or empty.
    OSError
        If files cannot be read or written.
    """
    folder = expand_path(folder, "folder").resolve()
    is_new = not folder.exists() or (folder.is_dir() and not any(folder.iterdir()))
    check_relations(
        (folder.parent.is_dir(), "folder", str(folder), "in a folder that exists"),
        (is_new, "folder", str(folder), "a new or an empty folder"),
    )
    with atomic_write(folder) as temporary:
        temporary.mkdir()
        return _read_archive(expand_path(archive, "archive"), temporary)


def _read_archive(archive: Path, target: Path | None) -> ArchiveReport:
    """Verify an archive, and write its files to the target folder if given."""
    if archive.exists() and not archive.is_file():
        raise invalid("archive", str(archive), "a zip file")
    import_optional("rocrate", "workflow", "archives need")
    with open(archive, "rb") as raw:
        sha256 = hashlib.file_digest(raw, "sha256").hexdigest()
        try:
            with zipfile.ZipFile(raw) as file:
                members = _check_members(file.infolist(), archive.stat().st_size)
                properties, listed = _read_metadata(file)
                present = set(members) - {METADATA_FILE}
                for names, problem in (
                    (set(listed) - present, "listed, but missing"),
                    (present - set(listed), "not listed"),
                ):
                    if names:
                        count = f"({len(names)} files)"
                        raise ArchiveError(f"{short_repr(min(names))} is {problem} {count}")
                for name, info in members.items():
                    digest = _copy_member(file, info, target)
                    if listed.get(name, digest) != digest:
                        raise ArchiveError(f"{name} is not the file that {METADATA_FILE} lists")
        except OSError:
            raise
        except ArchiveError as error:
            raise ArchiveError(f"{archive}: rejected, {error}") from None
        # The libraries raise errors of almost any type.
        except Exception as error:
            problem = format_key(" ".join(str(error).split()) or type(error).__name__)
            raise ArchiveError(f"{archive}: rejected, not a valid zip file ({problem})") from None
    size = sum(info.file_size for info in members.values())
    return ArchiveReport(archive, sha256, len(members), size, *properties)


def _check_members(infos: list[zipfile.ZipInfo], archive_size: int) -> dict[str, zipfile.ZipInfo]:
    """Return the members by name after checking that all are safe to unpack."""
    if len(infos) > MAX_MEMBERS:
        raise ArchiveError(f"more than {MAX_MEMBERS} members")
    for info in infos:
        # zipfile cuts names at a null byte.
        if problem := find_name_problem(info.orig_filename) or _find_kind_problem(info):
            raise ArchiveError(f"{short_repr(info.orig_filename)} is {problem}")
    members = {info.filename: info for info in infos}
    if collision := find_name_collision(info.filename for info in infos):
        raise ArchiveError(
            f"{short_repr(collision)} occurs twice, or its name differs in case only"
        )
    if METADATA_FILE not in members:
        raise ArchiveError(f"no RO-Crate, {METADATA_FILE} is missing")
    if members[METADATA_FILE].file_size > MAX_METADATA_BYTES:
        raise ArchiveError(f"{METADATA_FILE} has more than {MAX_METADATA_BYTES // 2**20} MiB")
    size = sum(info.file_size for info in infos)
    if size > MAX_UNPACKED_BYTES:
        raise ArchiveError(f"it would unpack to more than {MAX_UNPACKED_BYTES // 2**30} GiB")
    # The sum also limits members that share bytes.
    if size > max(MIN_RATIO_CHECK_BYTES, MAX_COMPRESSION_RATIO * archive_size):
        raise ArchiveError("it would unpack to too many times its size")
    if min(info.header_offset for info in infos) != 0:
        raise ArchiveError("not a valid zip file (its first member is not at its beginning)")
    return members


def find_name_problem(name: str) -> str:
    """Return the reason why a member name is not allowed, or an empty text."""
    parts = name.split("/")
    if name.startswith("/") or ".." in parts:
        return "a path out of the folder"
    if not all(c.isprintable() and c not in '\\:*?"<>|' for c in name):
        return "a name with characters that not all systems have"
    if any(map(_UNSAFE_PART_PATTERN.fullmatch, parts)):
        return "a hidden name, or one that not all systems have"
    if len(name) > MAX_NAME_LENGTH or max(len(p.encode()) for p in parts) > MAX_NAME_PART_BYTES:
        return "too long a name"
    if len(parts) > 1 and parts[0] in FOLDER_SUFFIXES:
        is_allowed = name.lower().endswith(FOLDER_SUFFIXES[parts[0]])
        return "" if is_allowed else f"not a file type of {parts[0]}/ in an archive"
    return "" if name in ROOT_MEMBERS else "not a file of an archive"


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


def _find_kind_problem(info: zipfile.ZipInfo) -> str:
    """Return the type of a member that is not a regular file, or an empty text."""
    mode = info.external_attr >> 16
    executable = stat.S_ISUID | stat.S_ISGID | stat.S_IXUSR | stat.S_IXGRP | stat.S_IXOTH
    problems = {
        "a symbolic link": stat.S_ISLNK(mode),
        "no plain file": (stat.S_IFMT(mode) not in (0, stat.S_IFREG) or info.external_attr & 0x10),
        "an executable file": mode & executable,
        "encrypted": info.flag_bits & 0x1,
        "compressed in an unusual way": (
            info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        ),
    }
    return next((problem for problem, is_found in problems.items() if is_found), "")


def _read_metadata(file: zipfile.ZipFile) -> tuple[list[str], dict[str, str]]:
    """Return name, date and licence of the results, and the SHA-256 of the files by name."""
    # Imported here: it is an optional dependency and slow to import.
    from rocrate.rocrate import ROCrate

    content = file.read(METADATA_FILE)
    try:
        metadata = json.loads(content)
        # Other types would be paths of a crate, or an empty one.
        if not isinstance(metadata, dict) or not metadata:
            raise ValueError("no mapping")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            crate = ROCrate(metadata)
        properties = [crate.root_dataset[key] for key in ("name", "datePublished", "license")]
    except Exception as error:
        problem = format_key(" ".join(str(error).split()) or type(error).__name__)
        raise ArchiveError(f"no RO-Crate, {METADATA_FILE} is invalid ({problem})") from None
    listed = {
        unquote(entity.id): str(entity.get("sha256"))
        for entity in crate.data_entities
        if "File" in entity.type
    }
    return [str(getattr(value, "id", value)) for value in properties], listed


def _copy_member(file: zipfile.ZipFile, info: zipfile.ZipInfo, target: Path | None) -> str:
    """Read a member, write it to the target folder if given, and return its SHA-256."""
    path = target / info.filename if target else Path(os.devnull)
    if target:
        path.parent.mkdir(parents=True, exist_ok=True)
    digest, size = hashlib.sha256(), 0
    with file.open(info) as source, open(path, "xb" if target else "wb") as copy:
        while chunk := source.read(_CHUNK_BYTES):
            digest.update(chunk)
            size += copy.write(chunk)
    if size != info.file_size:
        raise ArchiveError(f"{info.filename} has a size that differs from its header")
    return digest.hexdigest()
