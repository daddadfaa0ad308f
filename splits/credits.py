"""Who made this software, under which licence: from the repository or the installed package."""

from __future__ import annotations

from email.utils import getaddresses
from importlib.metadata import distribution, distributions
from pathlib import Path
from typing import Any

from splits.crate import ORCID, Author, Software
from splits.experiments.yaml_files import read_yaml, yaml_of
from splits.extras import DISTRIBUTION
from splits.versions import commit, package_version

LICENCE = "LICENSE"
CITATION = "CITATION.cff"


def software(repository: Path | None = None) -> Software:
    """Return version, commit, licence and authors of this software.

    Parameters
    ----------
    repository : Path, optional
        Where CITATION.cff may be; if it is not there, the metadata of the installed package say
        who the authors are.
    """
    citation = _citation(repository)
    authors = tuple(map(_author, citation["authors"]))
    return Software(package_version(), commit(), citation["license"], authors)


def software_files(repository: Path | None = None) -> dict[str, bytes]:
    """Return LICENSE and CITATION.cff by name.

    Parameters
    ----------
    repository : Path, optional
        Where they may be.  If they are not there, the installed package has the text of the
        licence, and CITATION.cff is written from its metadata.
    """
    found = {
        name: (repository / name).read_bytes()
        for name in (LICENCE, CITATION)
        if repository and (repository / name).is_file()
    }
    if LICENCE not in found:
        found[LICENCE] = _licence().encode()
    if CITATION not in found:
        found[CITATION] = yaml_of(_citation(None)).encode()
    return found


def _citation(repository: Path | None) -> dict[str, Any]:
    """Return what CITATION.cff says, or would say if it were there."""
    if repository and (repository / CITATION).is_file():
        return read_yaml(repository / CITATION)
    fields = distribution(DISTRIBUTION).metadata
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


def _licence() -> str:
    """Return the text of the licence, from whichever record of the installed package has it.

    A source tree on the path has a record, too, which does not.
    """
    records = distributions(name=DISTRIBUTION)
    return next(filter(None, (one.read_text(f"licenses/{LICENCE}") for one in records)), "")


def _author(entry: dict[str, str]) -> Author:
    """Return an author of CITATION.cff: a group has a name, a person has two."""
    orcid, affiliation = entry.get("orcid", "").removeprefix(ORCID), entry.get("affiliation", "")
    if "name" in entry:
        return Author(entry["name"], "", affiliation, is_person=False)
    name = f"{entry.get('given-names', '')} {entry.get('family-names', '')}".strip()
    return Author(name, orcid, affiliation)
