"""RO-Crate metadata of an archive: files, software, authors and licences.

An RO-Crate (https://w3id.org/ro/crate/1.2) is a folder or a zip file that describes its files and
their relations as linked data (JSON-LD) in ``ro-crate-metadata.json``.  Authors, version and
licence of this software are those of the repository or of the installed package.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from email.utils import getaddresses
from importlib.metadata import distribution, distributions
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

from splits.core.optional import DISTRIBUTION_NAME
from splits.core.provenance import get_git_commit, get_package_version
from splits.core.yaml import dump_yaml, read_yaml

METADATA_FILE = "ro-crate-metadata.json"
LICENCE_FILE = "LICENSE"
CITATION_FILE = "CITATION.cff"
ORCID_URL = "https://orcid.org/"
RO_CRATE_VERSION = "1.2"
MEDIA_TYPES = {
    **dict.fromkeys((".nc", ".nc4", ".netcdf", ".cdf"), "application/netcdf"),
    **dict.fromkeys((".caaml", ".xml"), "application/xml"),
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".csv": "text/csv",
    ".yaml": "application/yaml",
    ".yml": "application/yaml",
    ".cff": "application/yaml",
    ".json": "application/json",
    ".md": "text/markdown",
    ".txt": "text/plain",
    "": "text/plain",
}
"""Media types by suffix."""
FILE_DESCRIPTIONS = {
    "README.md": "Content of the archive, and how to reproduce it",
    "LICENSE": "Licence of the software",
    "CITATION.cff": "How to cite the software",
    "requirements.txt": "Lock file: required packages with versions and hashes",
    "versions.json": "Versions of all Python packages installed when the archive was made",
    "SHA256SUMS": f"Checksums of all other files except {METADATA_FILE}",
    "data": "Dataset: netCDF with CF attributes, including all inputs",
    "figures": "Figure of a dataset",
    "tables": "Table of numbers",
    "config": "Configuration: settings, experiments, media and the tables that they name",
}
"""Descriptions by file name or by folder."""


@dataclass(frozen=True)
class Author:
    """Author: a person or an organization.

    Attributes
    ----------
    name : str
    orcid : str
        ORCID such as "0000-0002-1825-0097", also as a URL; may be empty.
    affiliation : str
        May be empty.
    is_person : bool
    """

    name: str
    orcid: str = ""
    affiliation: str = ""
    is_person: bool = True


@dataclass(frozen=True)
class SoftwareInfo:
    """Version, commit, licence (SPDX identifier) and authors of this software."""

    version: str
    commit: str
    licence: str
    authors: tuple[Author, ...]


def make_software_info(repository: Path | None = None) -> SoftwareInfo:
    """Return version, commit, licence and authors of this software.

    Parameters
    ----------
    repository : Path, optional
        Folder with CITATION.cff.  If it is missing, the authors are those in the metadata of the
        installed package.
    """
    citation = _read_citation(repository)
    authors = tuple(map(_parse_author, citation["authors"]))
    return SoftwareInfo(get_package_version(), get_git_commit(), citation["license"], authors)


def read_software_files(repository: Path | None = None) -> dict[str, bytes]:
    """Return LICENSE and CITATION.cff by name.

    Parameters
    ----------
    repository : Path, optional
        Folder with the files.  If they are missing, the licence is that of the installed package,
        and CITATION.cff is generated from its metadata.
    """
    files = {
        name: (repository / name).read_bytes()
        for name in (LICENCE_FILE, CITATION_FILE)
        if repository and (repository / name).is_file()
    }
    if LICENCE_FILE not in files:
        # A source tree on the path also has package metadata, but without the licence.
        records = distributions(name=DISTRIBUTION_NAME)
        texts = (record.read_text(f"licenses/{LICENCE_FILE}") for record in records)
        files[LICENCE_FILE] = next(filter(None, texts), "").encode()
    if CITATION_FILE not in files:
        files[CITATION_FILE] = dump_yaml(_read_citation(None)).encode()
    return files


def _read_citation(repository: Path | None) -> dict[str, Any]:
    """Return the content of CITATION.cff, or its equivalent from the package metadata."""
    if repository and (repository / CITATION_FILE).is_file():
        return read_yaml(repository / CITATION_FILE)
    fields = distribution(DISTRIBUTION_NAME).metadata
    names = fields.get_all("Author") or []
    names += [name for name, _ in getaddresses(fields.get_all("Author-email") or []) if name]
    return {
        "cff-version": "1.2.0",
        "title": f"splits: {fields['Summary']}",
        "message": "If you use this software, please cite it and the papers of the models you use.",
        "type": "software",
        "authors": [{"name": name} for name in names],
        "version": fields["Version"],
        "license": fields["License-Expression"],
    }


def _parse_author(entry: dict[str, str]) -> Author:
    """Return an author of CITATION.cff: a person with two names, or an organization with one."""
    affiliation = entry.get("affiliation", "")
    if "name" in entry:
        return Author(entry["name"], "", affiliation, is_person=False)
    name = f"{entry.get('given-names', '')} {entry.get('family-names', '')}".strip()
    return Author(name, entry.get("orcid", ""), affiliation)


def make_metadata(
    members: Mapping[str, bytes],
    date: str,
    licence: str,
    authors: tuple[Author, ...],
    software: SoftwareInfo,
) -> bytes:
    """Return the content of ``ro-crate-metadata.json``.

    Parameters
    ----------
    members : mapping
        Contents of all other files by name.
    date : str
        Date of the archive in ISO 8601: 2026-01-31.
    licence : str
        Licence of the results: an SPDX identifier or a URL.
    authors : tuple of Author
        Authors of the results.
    software : SoftwareInfo
        Software that made the results.

    Returns
    -------
    bytes
        Deterministic for given arguments.
    """
    # Imported here: it is an optional dependency and slow to import.
    from rocrate.model import ContextEntity
    from rocrate.rocrate import ROCrate

    crate = ROCrate(version=RO_CRATE_VERSION)

    def add(url: str, kind: str, properties: dict[str, Any]) -> Any:
        """Return a contextual entity, added to the crate if missing."""
        entity = ContextEntity(crate, url, {"@type": kind, **properties})
        return crate.get(url) or crate.add(entity)

    def add_licence(licence: str) -> Any:
        url = licence if "://" in licence else f"https://spdx.org/licenses/{quote(licence)}"
        return add(url, "CreativeWork", {"name": licence, "url": url})

    def add_author(author: Author) -> Any:
        url = f"#{quote(author.name.replace(' ', '-'))}"
        if author.orcid:
            url = ORCID_URL + quote(author.orcid.removeprefix(ORCID_URL))
        properties: dict[str, Any] = {"name": author.name}
        if author.affiliation:
            properties["affiliation"] = add_author(Author(author.affiliation, is_person=False))
        return add(url, "Person" if author.is_person else "Organization", properties)

    folders = {name: PurePosixPath(name).parts[0] for name in sorted(members)}
    files = {
        name: crate.add_file(
            dest_path=name,
            properties={
                "name": PurePosixPath(name).name,
                "description": FILE_DESCRIPTIONS[folder],
                "encodingFormat": MEDIA_TYPES.get(
                    PurePosixPath(name).suffix.lower(), "application/octet-stream"
                ),
                "contentSize": str(len(members[name])),
                "sha256": hashlib.sha256(members[name]).hexdigest(),
            },
        )
        for name, folder in folders.items()
    }
    root = crate.root_dataset
    root["name"] = f"Results of splits {software.version}"
    root["description"] = (
        "Simulated reflectance and transmittance of snow, sand and rough layers: datasets, their "
        "figures and tables, and the configuration that they were made from."
    )
    root["datePublished"] = date
    root["license"] = add_licence(licence)
    root["author"] = [add_author(author) for author in authors]
    program = add("#splits", "SoftwareApplication", {
        "name": "splits, its Snakemake workflow (Snakefile)",
        "version": software.version,
        "softwareVersion": f"{software.version}, commit {software.commit}",
        "identifier": add(
            "#commit", "PropertyValue", {"name": "git commit", "value": software.commit}
        ),
        "license": add_licence(software.licence),
        "author": [add_author(author) for author in software.authors],
    })  # fmt: skip
    results, inputs = (
        [file for name, file in files.items() if folders[name] in kinds]
        for kinds in (("data", "figures", "tables"), ("config", "requirements.txt"))
    )
    root["mentions"] = crate.add_action(
        program, "#run", object=inputs, result=results,
        properties={"name": "Run of the workflow with this configuration"},
    )  # fmt: skip
    text = json.dumps(crate.metadata.generate(), indent=2, sort_keys=True, ensure_ascii=False)
    return (text + "\n").encode()
