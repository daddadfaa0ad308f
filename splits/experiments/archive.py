"""Archives of results for deposit: RO-Crates of data, figures and the configuration in force."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import stat
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib.metadata import distributions
from pathlib import Path, PurePosixPath
from typing import Any

from splits.core.atomic import atomic_write
from splits.core.escaping import escape_markdown
from splits.core.validation import expand_path, invalid
from splits.core.yaml import dump_yaml, read_yaml
from splits.experiments.config.load import list_media_files
from splits.experiments.config.media import list_table_paths
from splits.experiments.config.settings import DEFAULT_LICENCE, FOLDER_KEYS, Settings
from splits.io.ro_crate import (
    CITATION_FILE,
    LICENCE_FILE,
    METADATA_FILE,
    RO_CRATE_VERSION,
    Author,
    make_metadata,
    make_software_info,
    read_software_files,
)
from splits.io.unarchive import (
    FOLDER_SUFFIXES,
    MAX_COMPRESSION_RATIO,
    MIN_RATIO_CHECK_BYTES,
    ArchiveError,
    find_name_collision,
    find_name_problem,
    verify_archive,
)

LOCK_FILE = "requirements.txt"
REPOSITORY_FILES = (LICENCE_FILE, CITATION_FILE, LOCK_FILE)
"""Files of the repository in an archive."""
DATE_VARIABLE = "SOURCE_DATE_EPOCH"
"""Environment variable that replaces the current time (seconds since 1970)."""
README_TEMPLATE = """# Results of splits {version}

Archived on {date} from commit {commit}. Licence of the results: {licence}. Authors: {authors}.

| file or folder | content |
|---|---|
| `data/` | datasets, netCDF with CF attributes, which contain all inputs |
| `figures/` | figures of these datasets, PNG, SVG and PDF |
| `tables/` | tables, CSV |
| `config/` | configuration of the run: settings (with those of the command line), experiments, \
own media, measured and published tables, and all files that media read |
| `ro-crate-metadata.json` | list of all files with sizes, types and SHA-256, software, authors \
and licences (RO-Crate {crate}) |
| `versions.json` | versions of all Python packages in use |
| `requirements.txt` | packages with versions and hashes that the repository pins (if it does) |
| `LICENSE`, `CITATION.cff` | licence of the software, and how to cite it |
| `SHA256SUMS` | checksums; `sha256sum -c SHA256SUMS` verifies them |

To repeat the run, install splits {version} (commit {commit}) and run

```
splits unpack {archive} again
snakemake --snakefile REPOSITORY/Snakefile --directory again --cores 2
```

The first command verifies every file and unpacks into the new folder `again`, or stops. The
second writes into `again/results/`. The same seed gives the same numbers bit for bit on the same
versions.
"""


def pack_archive(
    results: Iterable[str | Path],
    configuration: Mapping[str, bytes],
    target: str | Path,
    repository: str | Path | None = None,
    licence: str = DEFAULT_LICENCE,
    authors: Iterable[Author] = (),
) -> None:
    """Write a zip file of results, a RO-Crate, atomically.

    The same arguments at the same time give the same bytes; `DATE_VARIABLE` sets that time.

    Parameters
    ----------
    results : iterable of path
        Files below the parent of the target's folder; their paths relative to it are kept.
    configuration : mapping
        Contents of additional members by name, see `make_configuration_members`.
    target : path
        The zip file, RESULTS/FOLDER/NAME.zip.
    repository : path, optional
        Folder with LICENSE, CITATION.cff and the lock file that pins the versions of packages.
        The first two are generated from the installed package if they are missing.
    licence : str
        Licence of the results: an SPDX identifier or a URL.
    authors : iterable of Author
        Authors of the results; by default those of the software.

    Raises
    ------
    ValueError
        For a member that `splits.io.unarchive` would reject, or an invalid `DATE_VARIABLE`.
    OSError
        If a result cannot be read, or the verification of the archive fails.
    """
    target = expand_path(target, "target")
    repository_folder = expand_path(repository, "repository") if repository else None
    root = target.parent.parent
    members = {}
    for path in map(Path, results):
        if not path.is_relative_to(root):
            raise invalid("archive", str(path), f"of results below {root}")
        members[path.relative_to(root).as_posix()] = path.read_bytes()
    members |= {**configuration, **read_software_files(repository_folder)}
    if repository_folder and (repository_folder / LOCK_FILE).is_file():
        members[LOCK_FILE] = (repository_folder / LOCK_FILE).read_bytes()
    versions = {d.metadata["Name"]: d.version for d in distributions()}
    members["versions.json"] = json.dumps(versions, indent=2, sort_keys=True).encode()

    now, software = get_packing_time(), make_software_info(repository_folder)
    date, authors = now.date().isoformat(), tuple(authors) or software.authors
    members["README.md"] = README_TEMPLATE.format(
        version=software.version, commit=software.commit, date=date,
        licence=f"<{licence}>" if "://" in licence else escape_markdown(licence),
        authors=", ".join(escape_markdown(author.name) for author in authors),
        crate=RO_CRATE_VERSION, archive=shlex.quote(target.name),
    ).encode()  # fmt: skip
    _check_member_names(members)
    checksums = [f"{hashlib.sha256(c).hexdigest()}  {n}" for n, c in sorted(members.items())]
    members["SHA256SUMS"] = ("\n".join(checksums) + "\n").encode()
    members[METADATA_FILE] = make_metadata(members, date, licence, authors, software)

    with atomic_write(target) as temporary_path:
        with zipfile.ZipFile(temporary_path, "w") as file:
            for name, content in sorted(members.items()):
                member = zipfile.ZipInfo(name, now.timetuple()[:6])
                member.compress_type = _choose_compression(content)
                member.create_system = 3  # Unix, wherever it is written
                member.external_attr = (stat.S_IFREG | 0o644) << 16
                file.writestr(member, content)
        try:
            verify_archive(temporary_path)
        except ArchiveError as error:
            raise OSError(f"{target} could not be unpacked ({error})") from None


def _choose_compression(content: bytes) -> int:
    """Return the compression of a member: none where its ratio would exceed the limit."""
    if len(content) <= MIN_RATIO_CHECK_BYTES:
        return zipfile.ZIP_DEFLATED
    is_allowed = len(content) <= MAX_COMPRESSION_RATIO / 2 * len(zlib.compress(content, 1))
    return zipfile.ZIP_DEFLATED if is_allowed else zipfile.ZIP_STORED


def get_packing_time() -> datetime:
    """Return the current time, or the time that `DATE_VARIABLE` sets, valid in zip files."""
    text = os.environ.get(DATE_VARIABLE)
    if text is None:
        return datetime.now(UTC)
    allowed = "seconds from 1980 to 2107, the range of zip files"
    if not (text.isascii() and text.isdigit() and 315532800 <= int(text[:20]) < 4354819200):
        raise invalid(DATE_VARIABLE, text, allowed)
    return datetime.fromtimestamp(int(text), UTC)


def _check_member_names(members: Iterable[str]) -> None:
    """Reject names of members that cannot be unpacked everywhere."""
    for name in members:
        if problem := find_name_problem(name):
            allowed = "of members that can be unpacked everywhere"
            raise invalid("archive", name, allowed, f"this is {problem}")
    if collision := find_name_collision(members):
        hint = "another one differs in case only"
        raise invalid("archive", collision, "of members that differ on all systems", hint)


def list_configuration_files(settings: Settings) -> dict[str, Path]:
    """Return the files that a run with these settings reads, by their name in an archive.

    These are the selected experiments, own media, and all measured and published tables, without
    hidden files.  The named media are part of the package.  Names in the archive start with
    ``config/`` wherever the folders are.  Files that `splits.io.unarchive` would reject are errors.
    """
    files = {}
    experiments = Path(settings.experiments_folder)
    for path in sorted(experiments.rglob("*.y*ml")):
        name = read_yaml(path).get("name", path.stem)
        if name in settings.experiments:
            files[f"config/experiments/{path.relative_to(experiments).as_posix()}"] = path
    for path in list_media_files(Path(settings.media_folder)):
        files[f"config/media/{path.name}"] = path
    for name, folder in settings.table_folders.items():
        for path in sorted(folder.rglob("*")):
            relative_path = path.relative_to(folder)
            if path.is_file() and not any(part.startswith(".") for part in relative_path.parts):
                files[f"config/{name}/{relative_path.as_posix()}"] = path
    _check_member_names(files)
    return files


def list_table_files(settings: Settings) -> list[Path]:
    """Return the users' own tables in an archive: those that its experiments and media name."""
    names: dict[str, str] = {}
    for path in list_configuration_files(settings).values():
        names |= _read_settings(path)[1]
    _check_member_names(names.values())
    return sorted(map(expand_path, names))


def make_configuration_members(settings: Settings) -> dict[str, bytes]:
    """Return the contents of the files that reproduce an archive, by name of member.

    Users' own tables are included: under their own path if that is below ``config/``, otherwise
    under ``config/tables/``, with the paths in the files that name them replaced.  The settings are
    those of the archive, see `Settings.select_archived`.
    """
    members: dict[str, bytes] = {}
    for name, path in list_configuration_files(settings).items():
        members[name] = path.read_bytes()
        content, tables = _read_settings(path)
        members |= {member: expand_path(table).read_bytes() for table, member in tables.items()}
        if any(member != table for table, member in tables.items()):
            members[name] = dump_yaml(_replace_texts(content, tables)).encode()
    folders = {key: Settings.model_fields[key].default for key in FOLDER_KEYS}
    members["config/config.yaml"] = dump_yaml(settings.model_dump(mode="json") | folders).encode()
    return members


def _read_settings(path: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the content of a file of an experiment or medium, and the tables that it names.

    The latter are names of members by path: members keep their file name, and files that are read
    whatever their suffix are text tables.  Other files have neither.
    """
    content = read_yaml(path) if path.suffix in (".yaml", ".yml") else {}
    names = {}
    for table in list_table_paths(content):
        if not expand_path(table).is_file():
            continue
        member = PurePosixPath(table)
        is_allowed = member.suffix.lower() in FOLDER_SUFFIXES["config"]
        if not is_allowed or member.parts[0] != "config" or ".." in member.parts:
            digest = hashlib.sha256(expand_path(table).read_bytes()).hexdigest()
            suffix = "" if is_allowed else ".txt"
            member = PurePosixPath(f"config/tables/{digest[:16]}/{member.name}{suffix}")
        names[table] = str(member)
    return content, names


def _replace_texts(content: Any, names: Mapping[str, str]) -> Any:
    """Return content with texts replaced, wherever they are: figures also name values of a grid."""
    if isinstance(content, dict):
        return {key: _replace_texts(value, names) for key, value in content.items()}
    if isinstance(content, list):
        return [_replace_texts(value, names) for value in content]
    return names.get(content, content) if isinstance(content, str) else content
