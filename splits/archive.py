"""Packing results for deposit: data, figures, the configuration in force, versions, checksums."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib.metadata import distributions
from pathlib import Path, PurePosixPath

from splits.checks import refuse
from splits.dataset import commit, package_version
from splits.experiments.settings import Settings
from splits.experiments.user_tables import renamed, tables_in
from splits.experiments.yaml_files import read_yaml, yaml_of
from splits.files import whole

LOCK = "requirements.txt"
README = """# Results of splits {version}

Packed on {date} from commit {commit}.

| file or folder | what |
|---|---|
| `data/` | datasets, netCDF with CF attributes; all inputs stand in their attributes |
| `figures/` | figures of these datasets, PNG, SVG and PDF |
| `tables/` | tables, CSV |
| `config/` | what made them: settings in force (those of the command line, too), experiments, \
media, measured and published tables, refractive indices of one's own |
| `versions.json` | versions of all Python packages in use |
| `requirements.txt` | the lock: packages with hashes that the repository pins (if it had one) |
| `SHA256SUMS` | checksums; `sha256sum -c SHA256SUMS` verifies them |

To repeat: install splits {version} (commit {commit}), unpack this into an empty folder and run
`snakemake --snakefile REPOSITORY/Snakefile --cores 2` there. It writes into `results/`. The same
seed gives the same numbers bit for bit on the same versions.
"""


def pack(
    results: Iterable[str | Path],
    configuration: Mapping[str, bytes],
    target: str | Path,
    lock: str | Path | None = None,
) -> None:
    """Write a zip file of results that appears whole or not at all.

    Parameters
    ----------
    results : iterable of path
        Files below the folder that holds the target's; they keep their place relative to it.
    configuration : mapping
        Contents of further members by name, see `configuration_members`.
    target : path
        The zip file, RESULTS/FOLDER/NAME.zip.
    lock : path, optional
        File that pins the versions of packages, left out if it does not exist.

    Raises
    ------
    ValueError
        For a member that would be unpacked outside of the folder.
    OSError
        If a result cannot be read, or the archive does not hold what was packed.
    """
    target = Path(target)
    root = target.parent.parent
    members = {_below(root, Path(f)): Path(f).read_bytes() for f in results} | dict(configuration)
    facts = {
        "version": package_version(),
        "commit": commit(),
        "date": datetime.now(UTC).date().isoformat(),
    }
    members["README.md"] = README.format(**facts).encode()
    versions = {d.metadata["Name"]: d.version for d in distributions()}
    members["versions.json"] = json.dumps(versions, indent=2, sort_keys=True).encode()
    if lock and Path(lock).is_file():
        members[LOCK] = Path(lock).read_bytes()
    for name in members:
        if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
            raise refuse("archive", name, "of members with relative names without ..")
    sums = [f"{hashlib.sha256(c).hexdigest()}  {n}" for n, c in sorted(members.items())]
    members["SHA256SUMS"] = ("\n".join(sums) + "\n").encode()

    with whole(target) as aside:
        with zipfile.ZipFile(aside, "w", zipfile.ZIP_DEFLATED) as file:
            for name, content in sorted(members.items()):
                file.writestr(name, content)
        with zipfile.ZipFile(aside) as file:
            broken = file.testzip()
        if broken:
            raise OSError(f"{target}: {broken} was not written correctly")


def configuration_files(settings: Settings) -> dict[str, Path]:
    """Return the files that a run with these settings reads, by their place in an archive.

    The experiments in force, all media, measured and published tables; wherever their folders
    are, they get the usual places below ``config/``.
    """
    found = {}
    experiments = Path(settings.experiments_folder)
    for path in sorted(experiments.rglob("*.y*ml")):
        name = read_yaml(path).get("name", path.stem)
        if settings.experiments == "all" or name in settings.experiments:
            found[f"config/experiments/{path.relative_to(experiments).as_posix()}"] = path
    for path in sorted(Path(settings.media_folder).glob("*.yaml")):
        found[f"config/media/{path.name}"] = path
    for name, folder in settings.tables.items():
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                found[f"config/{name}/{path.relative_to(folder).as_posix()}"] = path
    return found


def configuration_members(settings: Settings) -> dict[str, bytes]:
    """Return the members of an archive from which these settings' run can be repeated.

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
    members: dict[str, bytes] = {}
    for name, path in configuration_files(settings).items():
        is_yaml = path.suffix in (".yaml", ".yml")
        members |= _with_tables(name, path) if is_yaml else {name: path.read_bytes()}
    folders = (
        "experiments_folder", "media_folder", "measured_folder", "published_folder", "results",
    )  # fmt: skip
    moved = {key: Settings.model_fields[key].default for key in folders}
    if settings.archive != "all" and settings.experiments != "all":
        # What is not in force is not in the archive, where it could not be archived again.
        moved["archive"] = [n for n in settings.archive if n in settings.experiments] or "all"
    members["config/config.yaml"] = yaml_of(settings.model_dump(mode="json") | moved).encode()
    return members


def _with_tables(name: str, path: Path) -> dict[str, bytes]:
    """Return an experiment's or medium's file as a member, and the users' tables it names."""
    content = read_yaml(path)
    places = {table: _place(table) for table in tables_in(content) if Path(table).is_file()}
    members = {place: Path(table).read_bytes() for table, place in places.items()}
    if all(place == table for table, place in places.items()):
        return members | {name: path.read_bytes()}
    moved = renamed(content, lambda table: places.get(table, table))
    return members | {name: yaml_of(moved).encode()}


def _below(root: Path, path: Path) -> str:
    """Return a result's place in the archive."""
    if not path.is_relative_to(root):
        raise refuse("archive", str(path), f"of results below {root}")
    return path.relative_to(root).as_posix()


def _place(table: str) -> str:
    """Return where a user's table goes: its name stays, datasets are labelled with it."""
    path = PurePosixPath(table)
    if path.parts[0] == "config" and ".." not in path.parts:
        return str(path)
    digest = hashlib.sha256(Path(table).read_bytes()).hexdigest()
    return f"config/tables/{digest[:16]}/{path.name}"
