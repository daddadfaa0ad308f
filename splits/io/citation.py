"""Authors, version and licence of this software, from the repository or the installed package."""

from __future__ import annotations

from email.utils import getaddresses
from importlib.metadata import distribution, distributions
from pathlib import Path
from typing import Any

from splits.core.optional import DISTRIBUTION_NAME
from splits.core.provenance import get_git_commit, get_package_version
from splits.core.yaml import dump_yaml, read_yaml
from splits.io.ro_crate import ORCID_URL, Author, SoftwareInfo

LICENCE_FILE = "LICENSE"
CITATION_FILE = "CITATION.cff"


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
        files[LICENCE_FILE] = _read_licence().encode()
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


def _read_licence() -> str:
    """Return the text of the licence from the installed package.

    A source tree on the path also has package metadata, but without the licence.
    """
    records = distributions(name=DISTRIBUTION_NAME)
    return next(
        filter(None, (record.read_text(f"licenses/{LICENCE_FILE}") for record in records)), ""
    )


def _parse_author(entry: dict[str, str]) -> Author:
    """Return an author of CITATION.cff: a person with two names, or an organization with one."""
    orcid, affiliation = (
        entry.get("orcid", "").removeprefix(ORCID_URL),
        entry.get("affiliation", ""),
    )
    if "name" in entry:
        return Author(entry["name"], "", affiliation, is_person=False)
    name = f"{entry.get('given-names', '')} {entry.get('family-names', '')}".strip()
    return Author(name, orcid, affiliation)
