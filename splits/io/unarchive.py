"""Verification and unpacking of archives from untrusted sources.

An archive is a zip file with an RO-Crate (`splits.experiments.archive`).  All of it is verified:
names, types and sizes of its members, then the list of files in its metadata, then every byte.  An
archive is unpacked completely or not at all.  The verification shows that the files are those
listed, not who made the list: compare the SHA-256 of the archive in `ArchiveReport` with a trusted
value.
"""

from __future__ import annotations

import hashlib
import os
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from splits.core.atomic import atomic_folder
from splits.core.paths import expand_path
from splits.core.validation import format_key, invalid, short_repr
from splits.io.member_names import find_name_collision, find_name_problem
from splits.io.ro_crate import (
    METADATA_FILE,
    ArchiveError,
    find_root_dataset,
    get_text,
    list_files,
    parse_entities,
)

MAX_MEMBERS = 20_000
MAX_UNPACKED_BYTES = 2**35
"""Largest total size after unpacking."""
MAX_METADATA_BYTES = 2**26
"""Largest size of the metadata."""
MAX_COMPRESSION_RATIO = 300
"""Largest compression ratio of a member of more than `MIN_RATIO_CHECK_BYTES` bytes."""
MIN_RATIO_CHECK_BYTES = 2**20

_CHUNK_BYTES = 2**20
_LOCAL_HEADER_BYTES = 30
"""Size of the local header of a member without its name."""


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
    if not folder.parent.is_dir():
        raise invalid("folder", str(folder), "in a folder that exists")
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise invalid("folder", str(folder), "a new or an empty folder")
    with atomic_folder(folder) as temporary:
        return _read_archive(expand_path(archive, "archive"), temporary)


def _read_archive(archive: Path, target: Path | None) -> ArchiveReport:
    """Verify an archive, and write its files to the target folder if given."""
    if archive.exists() and not archive.is_file():
        raise invalid("archive", str(archive), "a zip file")
    with open(archive, "rb") as raw, _convert_errors(archive):
        digest = hashlib.file_digest(raw, "sha256").hexdigest()
        with zipfile.ZipFile(raw) as file:
            members = _list_members(file)
            entities = parse_entities(_read_metadata(file, members))
            root = find_root_dataset(entities)
            listed = list_files(entities, root)
            _check_listing(set(members) - {METADATA_FILE}, set(listed))
            for name, info in members.items():
                size, member_digest = _copy_member(file, info, target)
                if name in listed and listed[name] != (size, member_digest):
                    raise ArchiveError(f"{name} is not the file that {METADATA_FILE} lists")
    size = sum(info.file_size for info in members.values())
    properties = (get_text(root, key) for key in ("name", "datePublished", "license"))
    return ArchiveReport(archive, digest, len(members), size, *properties)


@contextmanager
def _convert_errors(archive: Path) -> Iterator[None]:
    """Convert exceptions of the zip libraries into one-line archive errors."""
    try:
        yield
    except ArchiveError as error:
        raise ArchiveError(f"{archive}: rejected, {error}") from None
    except (
        zipfile.BadZipFile, zlib.error, struct.error, EOFError, RuntimeError, ValueError,
        LookupError, OverflowError,
    ) as error:  # fmt: skip
        problem = " ".join(str(error).split()) or type(error).__name__
        raise ArchiveError(
            f"{archive}: rejected, not a valid zip file ({format_key(problem)})"
        ) from None


def _list_members(file: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Return the members by name after checking that all are safe to unpack."""
    infos = file.infolist()
    if len(infos) > MAX_MEMBERS:
        raise ArchiveError(f"more than {MAX_MEMBERS} members")
    for info in infos:
        # zipfile truncates names at a zero byte and normalizes separators.
        name = info.orig_filename
        problem = find_name_problem(name) or (
            name != info.filename and "a name with a null byte or a backslash"
        )
        problem = problem or _find_kind_problem(info)
        if problem:
            raise ArchiveError(f"{short_repr(name)} is {problem}")
    collision = find_name_collision(info.filename for info in infos)
    if collision:
        raise ArchiveError(
            f"{short_repr(collision)} occurs twice, or its name differs in case only"
        )
    _check_sizes(file, infos)
    if METADATA_FILE not in file.NameToInfo:
        raise ArchiveError(f"no RO-Crate, {METADATA_FILE} is missing")
    return {info.filename: info for info in infos}


def _find_kind_problem(info: zipfile.ZipInfo) -> str:
    """Return the type of a member that is not a regular file, or an empty text."""
    mode = info.external_attr >> 16
    if stat.S_ISLNK(mode):
        return "a symbolic link"
    if stat.S_IFMT(mode) not in (0, stat.S_IFREG) or info.external_attr & 0x10:
        return "no plain file"
    if mode & (stat.S_ISUID | stat.S_ISGID | stat.S_IXUSR | stat.S_IXGRP | stat.S_IXOTH):
        return "an executable file"
    if info.flag_bits & 0x1:
        return "encrypted"
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        return "compressed in an unusual way"
    return ""


def _check_sizes(file: zipfile.ZipFile, infos: list[zipfile.ZipInfo]) -> None:
    """Check total size and compression ratios, and that members do not overlap."""
    if sum(info.file_size for info in infos) > MAX_UNPACKED_BYTES:
        raise ArchiveError(f"it would unpack to more than {MAX_UNPACKED_BYTES // 2**30} GiB")
    end_of_previous = 0
    if infos and min(info.header_offset for info in infos) != 0:
        raise ArchiveError("not a valid zip file (its first member is not at its beginning)")
    for info in sorted(infos, key=lambda info: info.header_offset):
        if info.file_size > max(MIN_RATIO_CHECK_BYTES, MAX_COMPRESSION_RATIO * info.compress_size):
            raise ArchiveError(f"{info.filename} would unpack to too many times its size")
        if info.header_offset < end_of_previous:
            raise ArchiveError(f"{info.filename} shares bytes with another member")
        name = len(info.orig_filename)
        end_of_previous = info.header_offset + _LOCAL_HEADER_BYTES + name + info.compress_size
    if end_of_previous > (file.start_dir or 0):
        raise ArchiveError("not a valid zip file (a member is longer than the file)")


def _read_metadata(file: zipfile.ZipFile, members: Mapping[str, zipfile.ZipInfo]) -> bytes:
    """Return the content of the metadata file."""
    if members[METADATA_FILE].file_size > MAX_METADATA_BYTES:
        raise ArchiveError(f"{METADATA_FILE} has more than {MAX_METADATA_BYTES // 2**20} MiB")
    return file.read(METADATA_FILE)


def _copy_member(
    file: zipfile.ZipFile, info: zipfile.ZipInfo, target: Path | None
) -> tuple[int, str]:
    """Read a member, write it to the target folder if given, and return its size and SHA-256."""
    digest, size = hashlib.sha256(), 0
    path = os.devnull if target is None else target / info.filename
    if target is not None:
        (target / info.filename).parent.mkdir(parents=True, exist_ok=True)
    with file.open(info) as source, open(path, "wb" if target is None else "xb") as copy:
        while chunk := source.read(_CHUNK_BYTES):
            size += len(chunk)
            if size > info.file_size:
                break
            digest.update(chunk)
            copy.write(chunk)
    if size != info.file_size:
        raise ArchiveError(f"{info.filename} has a size that differs from its header")
    return size, digest.hexdigest()


def _check_listing(present: set[str], listed: set[str]) -> None:
    """Check that the files present are exactly those listed."""
    for names, problem in (
        (listed - present, "listed, but missing"),
        (present - listed, "not listed"),
    ):
        if names:
            raise ArchiveError(f"{short_repr(min(names))} is {problem} ({len(names)} files)")
