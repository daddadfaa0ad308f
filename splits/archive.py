"""Packing results for deposit: data, figures, configuration, versions and checksums."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib.metadata import distributions
from pathlib import Path

from splits.dataset import commit, package_version

README = """# Results of splits {version}

Packed on {date} from commit {commit}.

| folder | what |
|---|---|
| `data/` | datasets, netCDF with CF attributes; all inputs stand in their attributes |
| `figures/` | figures of these datasets, PNG and SVG |
| `tables/` | tables, CSV |
| `config/` | the configuration that made them |
| `versions.json` | versions of all Python packages in use |
| `SHA256SUMS` | checksums; `sha256sum -c SHA256SUMS` verifies them |

To repeat: install splits {version} (commit {commit}), put `config/` in place of its own and run
`snakemake --cores 2`. The same seed gives the same numbers bit for bit on the same versions.
"""


def pack(
    results: Iterable[str | Path],
    configuration: Iterable[str | Path],
    target: str | Path,
) -> None:
    """Write a zip file of results that appears whole or not at all.

    Parameters
    ----------
    results : iterable of path
        Files below the folder that holds the target's; they keep their place relative to it.
    configuration : iterable of path
        Files and folders, packed under their own relative paths.
    target : path
        The zip file, RESULTS/FOLDER/NAME.zip.
    """
    target = Path(target)
    root = target.parent.parent
    members = {Path(f).relative_to(root).as_posix(): Path(f).read_bytes() for f in results}
    for entry in map(Path, configuration):
        files = sorted(entry.rglob("*")) if entry.is_dir() else [entry]
        members |= {f.as_posix(): f.read_bytes() for f in files if f.is_file()}
    facts = {
        "version": package_version(),
        "commit": commit(),
        "date": datetime.now(UTC).date().isoformat(),
    }
    members["README.md"] = README.format(**facts).encode()
    versions = {d.metadata["Name"]: d.version for d in distributions()}
    members["versions.json"] = json.dumps(versions, indent=2, sort_keys=True).encode()
    sums = [f"{hashlib.sha256(c).hexdigest()}  {n}" for n, c in sorted(members.items())]
    members["SHA256SUMS"] = ("\n".join(sums) + "\n").encode()

    target.parent.mkdir(parents=True, exist_ok=True)
    aside = target.with_name(f".{target.name}")
    with zipfile.ZipFile(aside, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in sorted(members.items()):
            file.writestr(name, content)
    with zipfile.ZipFile(aside) as file:
        broken = file.testzip()
    if broken:
        raise OSError(f"{target}: {broken} was not written correctly")
    os.replace(aside, target)
