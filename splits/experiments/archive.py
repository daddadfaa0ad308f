"""Packing results for deposit: an RO-Crate of data, figures and the configuration in force."""

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

from splits.core.atomic import atomic_write
from splits.core.escaping import escape_markdown
from splits.core.paths import expand_path
from splits.core.validation import invalid
from splits.core.yaml import dump_yaml, read_yaml
from splits.experiments.config.medium import list_table_paths, replace_table_paths
from splits.experiments.config.settings import DEFAULT_LICENCE, FOLDER_KEYS, Settings
from splits.io.citation import make_software_info, read_software_files
from splits.io.ro_crate import (
    METADATA_FILE,
    RO_CRATE_VERSION,
    ArchiveError,
    ArchiveInfo,
    Author,
    make_metadata,
)
from splits.io.unarchive import (
    MAX_COMPRESSION_RATIO,
    MIN_RATIO_CHECK_BYTES,
    find_name_collision,
    find_name_problem,
    verify_archive,
)

LOCK_FILE = "requirements.txt"
DATE_VARIABLE = "SOURCE_DATE_EPOCH"
"""Environment variable: seconds since 1970 that count as now, so that archives can be the same."""
README_TEMPLATE = """# Results of splits {version}

Packed on {date} from commit {commit}. Licence of the results: {licence}. Authors: {authors}.

| file or folder | what |
|---|---|
| `data/` | datasets, netCDF with CF attributes; all inputs stand in their attributes |
| `figures/` | figures of these datasets, PNG, SVG and PDF |
| `tables/` | tables, CSV |
| `config/` | what made them: settings in force (those of the command line, too), experiments, \
media, measured and published tables, refractive indices of one's own |
| `ro-crate-metadata.json` | the list of all files with sizes, types and SHA-256; what made them, \
authors and licences (RO-Crate {crate}) |
| `versions.json` | versions of all Python packages in use |
| `requirements.txt` | the lock: packages with hashes that the repository pins (if it had one) |
| `LICENSE`, `CITATION.cff` | licence of the software, and how to cite it |
| `SHA256SUMS` | checksums; `sha256sum -c SHA256SUMS` verifies them |

To repeat: install splits {version} (commit {commit}) and run

```
splits unpack {archive} again
snakemake --snakefile REPOSITORY/Snakefile --directory again --cores 2
```

The first command verifies every file and unpacks into the new folder `again`, or refuses. The
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
    """Write a zip file of results, an RO-Crate that appears whole or not at all.

    The same arguments give the same bytes at the same time, for which `DATE_VARIABLE` can stand.

    Parameters
    ----------
    results : iterable of path
        Files below the folder that holds the target's; they keep their place relative to it.
    configuration : mapping
        Contents of further members by name, see `make_configuration_members`.
    target : path
        The zip file, RESULTS/FOLDER/NAME.zip.
    repository : path, optional
        Folder with LICENSE, CITATION.cff and the lock, a file that pins the versions of packages.
        The first two are made from the installed package if they are not there.
    licence : str
        Of the results: an SPDX identifier or a URL.
    authors : iterable of Author
        Of the results; those of the software if there are none.

    Raises
    ------
    ValueError
        For a member that `splits.io.unarchive` would refuse, or a `DATE_VARIABLE` that is none.
    OSError
        If a result cannot be read, or the archive does not hold what was packed.
    """
    target = expand_path(target, "target")
    place = expand_path(repository, "repository") if repository else None
    root = target.parent.parent
    members = {_get_member_name(root, Path(f)): Path(f).read_bytes() for f in results} | dict(
        configuration
    )
    members |= read_software_files(place)
    if place and (place / LOCK_FILE).is_file():
        members[LOCK_FILE] = (place / LOCK_FILE).read_bytes()
    versions = {d.metadata["Name"]: d.version for d in distributions()}
    members["versions.json"] = json.dumps(versions, indent=2, sort_keys=True).encode()

    now, program = get_packing_time(), make_software_info(place)
    about = ArchiveInfo(now.date().isoformat(), licence, tuple(authors) or program.authors, program)
    members["README.md"] = _format_readme(about, target.name).encode()
    _check_member_names(members)
    sums = [f"{hashlib.sha256(c).hexdigest()}  {n}" for n, c in sorted(members.items())]
    members["SHA256SUMS"] = ("\n".join(sums) + "\n").encode()
    members[METADATA_FILE] = make_metadata(members, about)

    with atomic_write(target) as aside:
        with zipfile.ZipFile(aside, "w") as file:
            for name, content in sorted(members.items()):
                member = zipfile.ZipInfo(name, now.timetuple()[:6])
                member.compress_type = _choose_compression(content)
                member.create_system = 3  # Unix, wherever it is written
                member.external_attr = (stat.S_IFREG | 0o644) << 16
                file.writestr(member, content)
        try:
            verify_archive(aside)
        except ArchiveError as error:
            raise OSError(f"{target} could not be unpacked ({error})") from None


def _choose_compression(content: bytes) -> int:
    """Return how a member is packed: as it is, where packed it would be refused as a bomb."""
    if len(content) <= MIN_RATIO_CHECK_BYTES or len(content) <= MAX_COMPRESSION_RATIO / 2 * len(
        zlib.compress(content, 1)
    ):
        return zipfile.ZIP_DEFLATED
    return zipfile.ZIP_STORED


def get_packing_time() -> datetime:
    """Return the time that counts as now, see `DATE_VARIABLE`.

    Raises
    ------
    ValueError
        If it is none.
    """
    given = os.environ.get(DATE_VARIABLE)
    if given is None:
        return datetime.now(UTC)
    allowed = "seconds from 1980 to 2107, as zip files have them"
    if not (given.isascii() and given.isdigit() and 315532800 <= int(given[:20]) < 4354819200):
        raise invalid(DATE_VARIABLE, given, allowed)
    return datetime.fromtimestamp(int(given), UTC)


def _format_readme(info: ArchiveInfo, archive: str) -> str:
    """Return README.md."""
    return README_TEMPLATE.format(
        version=info.software.version, commit=info.software.commit, date=info.date,
        licence=f"<{info.licence}>" if "://" in info.licence else info.licence,
        authors=", ".join(escape_markdown(author.name) for author in info.authors),
        crate=RO_CRATE_VERSION, archive=shlex.quote(archive),
    )  # fmt: skip


def _check_member_names(members: Iterable[str]) -> None:
    """Refuse names of members that would not be unpacked."""
    for name in members:
        wrong = find_name_problem(name)
        if wrong:
            allowed = "of members that can be unpacked everywhere"
            raise invalid("archive", name, allowed, f"this is {wrong}")
    twice = find_name_collision(members)
    if twice:
        hint = "another one differs in case only"
        raise invalid("archive", twice, "of members that differ on all systems", hint)


def list_configuration_files(settings: Settings) -> dict[str, Path]:
    """Return the files that a run with these settings reads, by their place in an archive.

    The experiments in force, all media, measured and published tables, but no hidden files;
    wherever their folders are, they get the usual places below ``config/``.

    Raises
    ------
    ValueError
        For a file that `splits.io.unarchive` would refuse.
    """
    found = {}
    experiments = Path(settings.experiments_folder)
    for path in sorted(experiments.rglob("*.y*ml")):
        name = read_yaml(path).get("name", path.stem)
        if settings.experiments == "all" or name in settings.experiments:
            found[f"config/experiments/{path.relative_to(experiments).as_posix()}"] = path
    for path in sorted(Path(settings.media_folder).glob("*.yaml")):
        found[f"config/media/{path.name}"] = path
    for name, folder in settings.table_folders.items():
        for path in sorted(folder.rglob("*")):
            place = path.relative_to(folder)
            if path.is_file() and not any(part.startswith(".") for part in place.parts):
                found[f"config/{name}/{place.as_posix()}"] = path
    _check_member_names(found)
    return found


def make_configuration_members(settings: Settings) -> dict[str, bytes]:
    """Return the members of an archive from which what it holds can be made again.

    Users' own tables are packed, too: in their place if that is below ``config/``, otherwise under
    ``config/tables/``, and the files that name them are written anew with the new paths.

    Parameters
    ----------
    settings : Settings
        In force: those of the configuration file and of the command line.

    Returns
    -------
    dict
        Contents by name of member.
    """
    settings = settings.select_archived()
    members: dict[str, bytes] = {}
    for name, path in list_configuration_files(settings).items():
        is_yaml = path.suffix in (".yaml", ".yml")
        members |= _make_members_with_tables(name, path) if is_yaml else {name: path.read_bytes()}
    moved = {key: Settings.model_fields[key].default for key in FOLDER_KEYS}
    members["config/config.yaml"] = dump_yaml(settings.model_dump(mode="json") | moved).encode()
    return members


def _make_members_with_tables(name: str, path: Path) -> dict[str, bytes]:
    """Return an experiment's or medium's file as a member, and the users' tables it names."""
    content = read_yaml(path)
    files = {table: expand_path(table) for table in list_table_paths(content)}
    places = {
        table: _get_table_member_name(table) for table, file in files.items() if file.is_file()
    }
    members = {place: files[table].read_bytes() for table, place in places.items()}
    if all(place == table for table, place in places.items()):
        return members | {name: path.read_bytes()}
    moved = replace_table_paths(content, lambda table: places.get(table, table))
    return members | {name: dump_yaml(moved).encode()}


def _get_member_name(root: Path, path: Path) -> str:
    """Return a result's place in the archive."""
    if not path.is_relative_to(root):
        raise invalid("archive", str(path), f"of results below {root}")
    return path.relative_to(root).as_posix()


def _get_table_member_name(table: str) -> str:
    """Return where a user's table goes: its name stays, datasets are labelled with it."""
    path = PurePosixPath(table)
    if path.parts[0] == "config" and ".." not in path.parts:
        return str(path)
    digest = hashlib.sha256(expand_path(table).read_bytes()).hexdigest()
    return f"config/tables/{digest[:16]}/{path.name}"
