"""RO-Crate metadata of an archive: files, software, authors and licences.

An RO-Crate (https://w3id.org/ro/crate/1.2) is a folder or a zip file that describes its files and
their relations as linked data (JSON-LD) in ``ro-crate-metadata.json``.  The metadata are written
with the package rocrate and read with the standard library alone.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import quote, unquote

from splits.core.validation import format_key, short_repr

METADATA_FILE = "ro-crate-metadata.json"
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

_RO_CRATE_ID_PATTERN = re.compile(r"https://w3id\.org/ro/crate/1\.\d+(-DRAFT)?(/context)?")


class ArchiveError(ValueError):
    """Invalid archive; the message is one line."""


@dataclass(frozen=True)
class Author:
    """Author: a person or an organization.

    Attributes
    ----------
    name : str
    orcid : str
        ORCID such as "0000-0002-1825-0097", may be empty.
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


@dataclass(frozen=True)
class ArchiveInfo:
    """Metadata of an archive.

    Attributes
    ----------
    date : str
        Date of the archive in ISO 8601: 2026-01-31.
    licence : str
        Licence of the results: an SPDX identifier or a URL.
    authors : tuple of Author
        Authors of the results.
    software : SoftwareInfo
        Software that made the results.
    """

    date: str
    licence: str
    authors: tuple[Author, ...]
    software: SoftwareInfo


def make_metadata(members: Mapping[str, bytes], info: ArchiveInfo) -> bytes:
    """Return the content of ``ro-crate-metadata.json``.

    Parameters
    ----------
    members : mapping
        Contents of all other files by name.
    info : ArchiveInfo

    Returns
    -------
    bytes
        Deterministic for given arguments.
    """
    # Imported here: it is an optional dependency and slow to import.
    from rocrate.rocrate import ROCrate

    crate = ROCrate(version=RO_CRATE_VERSION)
    root, software = crate.root_dataset, info.software
    files = {
        name: crate.add_file(dest_path=name, properties=_describe_file(name, content))
        for name, content in sorted(members.items())
    }
    root["name"] = f"Results of splits {software.version}"
    root["description"] = (
        "Simulated reflectance and transmittance of snow, sand and rough layers: datasets, their "
        "figures and tables, and the configuration that they were made from."
    )
    root["datePublished"] = info.date
    root["license"] = _add_licence(crate, info.licence)
    root["author"] = [_add_author(crate, author) for author in info.authors]
    program = _add_entity(crate, "#splits", {
        "@type": "SoftwareApplication",
        "name": "splits, its Snakemake workflow (Snakefile)",
        "version": software.version,
        "softwareVersion": f"{software.version}, commit {software.commit}",
        "identifier": _add_entity(crate, "#commit", {
            "@type": "PropertyValue", "name": "git commit", "value": software.commit,
        }),
        "license": _add_licence(crate, software.licence),
        "author": [_add_author(crate, author) for author in software.authors],
    })  # fmt: skip
    folders = {name: PurePosixPath(name).parts[0] for name in files}
    results = [
        files[name] for name, folder in folders.items() if folder in ("data", "figures", "tables")
    ]
    inputs = [
        files[name] for name, folder in folders.items() if folder in ("config", "requirements.txt")
    ]
    run = crate.add_action(program, "#run", object=inputs, result=results, properties={
        "name": "Run of the workflow with this configuration",
    })  # fmt: skip
    root["mentions"] = run
    text = json.dumps(crate.metadata.generate(), indent=2, sort_keys=True, ensure_ascii=False)
    return (text + "\n").encode()


def _describe_file(name: str, content: bytes) -> dict[str, str]:
    """Return the RO-Crate properties of a file."""
    path = PurePosixPath(name)
    return {
        "name": path.name,
        "description": FILE_DESCRIPTIONS[path.parts[0]],
        "encodingFormat": MEDIA_TYPES.get(path.suffix.lower(), "application/octet-stream"),
        "contentSize": str(len(content)),
        "sha256": hashlib.sha256(content).hexdigest(),
    }


def _add_entity(crate: Any, identifier: str, properties: dict[str, Any]) -> Any:
    """Return a contextual entity, added to the crate if missing."""
    from rocrate.model import ContextEntity

    return crate.get(identifier) or crate.add(ContextEntity(crate, identifier, properties))


def _add_licence(crate: Any, licence: str) -> Any:
    url = licence if "://" in licence else f"https://spdx.org/licenses/{licence}"
    return _add_entity(crate, url, {"@type": "CreativeWork", "name": licence, "url": url})


def _add_author(crate: Any, author: Author) -> Any:
    """Return the entity of an author."""
    name = f"#{quote(author.name.replace(' ', '-'))}"
    identifier = ORCID_URL + author.orcid if author.orcid else name
    kind = "Person" if author.is_person else "Organization"
    properties: dict[str, Any] = {"@type": kind, "name": author.name}
    if author.affiliation:
        properties["affiliation"] = _add_author(crate, Author(author.affiliation, is_person=False))
    return _add_entity(crate, identifier, properties)


def parse_entities(content: bytes) -> dict[str, dict[str, Any]]:
    """Return the entities of the metadata by @id."""

    def reject_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(dict(pairs)) < len(pairs):
            raise ValueError("a key given twice")
        return dict(pairs)

    try:
        crate = json.loads(content.decode(), object_pairs_hook=reject_duplicates)
    except (ValueError, RecursionError) as error:
        raise ArchiveError(f"{METADATA_FILE} is not JSON ({format_key(error)})") from None
    graph = crate.get("@graph") if isinstance(crate, dict) else None
    if not isinstance(graph, list) or not all(isinstance(entity, dict) for entity in graph):
        raise ArchiveError(f"no RO-Crate, {METADATA_FILE} has no @graph")
    if not any(_is_crate_id(context) for context in _as_list(crate.get("@context"))):
        raise ArchiveError(f"no RO-Crate, {METADATA_FILE} has another @context")
    identifiers = [entity.get("@id") for entity in graph]
    if not all(isinstance(identifier, str) for identifier in identifiers) or len(
        set(identifiers)
    ) < len(identifiers):
        raise ArchiveError(f"no RO-Crate, {METADATA_FILE} has entities without an @id of their own")
    return dict(zip(identifiers, graph, strict=True))


def find_root_dataset(entities: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the root dataset of the metadata."""
    descriptor = entities.get(METADATA_FILE, {})
    root = entities.get("./", {})
    describes_root = _get_references(descriptor, "about") == ["./"]
    if not (describes_root and any(map(_is_crate_id, _get_references(descriptor, "conformsTo")))):
        raise ArchiveError(f"no RO-Crate, {METADATA_FILE} does not describe itself as one")
    if "Dataset" not in _as_list(root.get("@type")):
        raise ArchiveError(f"no RO-Crate, {METADATA_FILE} has no root dataset")
    for key in ("name", "description", "datePublished", "license"):
        if not get_text(root, key):
            raise ArchiveError(f"no RO-Crate, its root dataset has no {key}")
    return root


def list_files(
    entities: Mapping[str, dict[str, Any]], root: Mapping[str, Any]
) -> dict[str, tuple[int, str]]:
    """Return size and SHA-256 of the files listed in the metadata, by name."""
    parts = set(_get_references(root, "hasPart"))
    files: dict[str, tuple[int, str]] = {}
    for identifier, entity in entities.items():
        if "File" not in _as_list(entity.get("@type")):
            continue
        name = unquote(identifier)
        size, digest = entity.get("contentSize"), entity.get("sha256")
        if identifier not in parts or name in files:
            raise ArchiveError(
                f"{short_repr(name)} is listed twice, or is no part of the root dataset"
            )
        if not (isinstance(size, str) and re.fullmatch(r"\d{1,15}", size, re.ASCII)):
            raise ArchiveError(f"{short_repr(name)} is listed without contentSize")
        if not (isinstance(digest, str) and re.fullmatch(r"[0-9a-f]{64}", digest)):
            raise ArchiveError(f"{short_repr(name)} is listed without sha256")
        files[name] = int(size), digest
    return files


def _as_list(value: Any) -> list[Any]:
    """Return one or several values as a list."""
    return value if isinstance(value, list) else [value]


def _get_references(entity: Mapping[str, Any], key: str) -> list[str]:
    """Return the identifiers that a property references."""
    values = (v.get("@id") for v in _as_list(entity.get(key)) if isinstance(v, dict))
    return [value for value in values if isinstance(value, str)]


def get_text(entity: Mapping[str, Any], key: str) -> str:
    """Return the text or first reference of a property, or an empty text."""
    value = entity.get(key)
    return value if isinstance(value, str) else next(iter(_get_references(entity, key)), "")


def _is_crate_id(identifier: Any) -> bool:
    """Return whether an identifier is that of RO-Crate or of its context."""
    return isinstance(identifier, str) and bool(_RO_CRATE_ID_PATTERN.fullmatch(identifier))
