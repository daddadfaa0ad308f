"""Model of the main configuration file: selected experiments, accuracy and folders."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from splits.core.paths import expand_path
from splits.core.validation import ConfigError, check_choice, invalid, join_names, suggest_name
from splits.experiments.config.experiment import OWN_GROUP, ExperimentConfig
from splits.experiments.config.sections import (
    Accuracy,
    ConfigSection,
    Label,
    Title,
    Whole,
    check_path,
)
from splits.experiments.config.studies import (
    Study,
    check_studies,
    describe_missing,
    find_incomplete_studies,
)
from splits.io.ro_crate import Author

DEFAULT_LICENCE = "MIT"
"""Default licence of results: that of the software."""
RESULT_FOLDERS = ("archive", "benchmarks", "blocks", "data", "figures", "logs", "tables")
"""Subfolders of the results folder, which the workflow creates."""
_ACCURACY_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


class ArchiveAuthor(ConfigSection):
    """An author of the results in an archive."""

    name: Title
    """name of the author"""
    orcid: Title = ""
    """ORCID"""
    affiliation: Title = ""
    """institution of the author"""


DEFAULT_GROUPS = ("papers", OWN_GROUP)
"""Groups of experiments that are selected by default."""
EXPLORER_AXES = {"optical_radius_um", "incidence_deg"}
"""Grid axes of the experiments that give the explorer's BRDFs."""


FOLDER_KEYS = (
    "experiments_folder",
    "media_folder",
    "measured_folder",
    "published_folder",
    "results",
)
"""Settings that are paths of folders."""


def _split_names(value: Any) -> Any:
    # Lists on the command line are separated by commas.
    if isinstance(value, str) and value not in ("all", "everything"):
        return tuple(name.strip() for name in value.split(","))
    return value


def _check_folder(value: str) -> str:
    # Snakemake compares paths as texts, so each file needs a unique spelling.
    path = posixpath.normpath(str(expand_path(value, ""))) if value else "."
    if path == ".":
        raise invalid("", value, "the path of a folder")
    return check_path("", path)


def _check_accuracy_name(name: str) -> str:
    if not _ACCURACY_PATTERN.fullmatch(name) or name.lower() in RESULT_FOLDERS:
        allowed = "letters, digits, _, - and ., none of " + ", ".join(RESULT_FOLDERS)
        raise invalid("", name, allowed, "it names a folder")
    return name


SPLIT_NAMES = BeforeValidator(_split_names, json_schema_input_type=str | tuple[str, ...])
Folder = Annotated[str, AfterValidator(_check_folder)]


class Settings(ConfigSection):
    """The main configuration file."""

    experiments: Annotated[Literal["everything"] | tuple[str, ...], SPLIT_NAMES] = DEFAULT_GROUPS
    """names of experiments, and of groups of experiments, which a run makes; `everything` selects
    all groups"""
    accuracy: str = "standard"
    """accuracy level of the run, one of the names under `accuracies`"""
    accuracies: dict[Annotated[str, AfterValidator(_check_accuracy_name)], Accuracy]
    """target errors by name"""
    seed: Whole = Field(1, ge=0, lt=2**63)
    """seed of all random numbers; the same seed gives the same results"""
    experiments_folder: Folder = "config/experiments"
    """folder of the experiments; a path without `{ } < >`, like the other folders"""
    media_folder: Folder = "config/media"
    """folder of the media"""
    measured_folder: Folder = "config/measured"
    """folder of the tables of measured numbers"""
    published_folder: Folder = "config/published"
    """folder of the tables of published numbers"""
    results: Folder = "results"
    """folder of the results; accuracies other than `standard` write to a subfolder with their name
    """
    archive: Annotated[tuple[str, ...] | Literal["all"], SPLIT_NAMES] = "all"
    """experiments in the archive of `snakemake archive`, by default all selected ones; on the
    command line with commas"""
    archive_license: Title = DEFAULT_LICENCE
    """licence of the results in an archive: an SPDX identifier such as `CC-BY-4.0`, or a URL"""
    archive_authors: tuple[ArchiveAuthor, ...] = ()
    """authors of the results in an archive, each with `name` and optionally `orcid` and
    `affiliation`"""
    studies: dict[str, Study] = Field(default_factory=dict)
    """tables and figures made from several experiments"""
    explorer: dict[Label, str] = Field(default_factory=dict)
    """experiments of the tables in `explorer.html`, by label"""
    explorer_directions: dict[str, str] = Field(default_factory=dict)
    """goniophotometers over `optical_radius_um` and `incidence_deg` for tables of the explorer, by
    the same labels"""

    @model_validator(mode="after")
    def _check_accuracy(self) -> Settings:
        check_choice("accuracy", self.accuracy, self.accuracies)
        return self

    @property
    def results_folder(self) -> str:
        """Folder of results: `results`, or its subfolder of an accuracy other than standard."""
        return self.results if self.accuracy == "standard" else f"{self.results}/{self.accuracy}"

    @property
    def table_folders(self) -> dict[str, Path]:
        """Folders of the tables of measured and of published numbers."""
        return {"measured": Path(self.measured_folder), "published": Path(self.published_folder)}

    def select_archived(self, selected: Mapping[str, ExperimentConfig]) -> Settings:
        """Return the settings of a run that makes the content of an archive only.

        Experiments of the archive that are not among the selected ones are rejected.
        """
        if self.archive == "all":
            groups = {one.group for one in selected.values()}
            if self.experiments != "everything":
                groups &= {*self.experiments}
            studies = {n: s for n, s in self.studies.items() if s.group in (None, *groups)}
            # The groups of these studies select them, and their experiments.
            named = dict.fromkeys(study.group for study in studies.values() if study.group)
            names = (*selected, *named)
            return self.model_copy(update={"experiments": names, "studies": studies})
        for name in self.archive:
            if name not in selected:
                hint = "add it or its group to experiments"
                raise ConfigError(f"archive = {name!r}: must be a selected experiment ({hint})")
        others: dict[str, Any] = {"studies": {}, "explorer": {}, "explorer_directions": {}}
        return self.model_copy(update={"experiments": self.archive, "archive": "all", **others})

    def list_authors(self) -> tuple[Author, ...]:
        """Return the authors of an archive, if any are given."""
        return tuple(Author(**author.model_dump()) for author in self.archive_authors)

    def _check_explorer(self, available: Mapping[str, ExperimentConfig]) -> None:
        """Reject experiments that the explorer cannot show."""
        for label, name in self.explorer.items():
            if name not in available:
                continue
            key, kind = f"explorer.{label} = {name!r}", available[name].instrument.kind
            if kind != "table":
                raise ConfigError(f"{key}: must be a table (it is a {kind})")
            if "reflectance" not in getattr(available[name].instrument, "quantities", ()):
                raise ConfigError(f"{key}: must be a table of reflectance")
            if getattr(available[name].instrument, "polar_deg", None) is not None:
                raise ConfigError(f"{key}: must be a table without directions")
            for axis, row in zip(*available[name].make_axes(), strict=True):
                if len(row) < 2 or isinstance(row[0], str):
                    raise ConfigError(f"{key}: its axis {axis} must have at least two numbers")
        for label, name in self.explorer_directions.items():
            key, one = f"explorer_directions.{label} = {name!r}", available.get(name)
            if label not in self.explorer:
                labels = ", ".join(self.explorer) or "none"
                raise ConfigError(f"{key}: must have the name of a table in explorer ({labels})")
            if one and (one.instrument.kind, {*one.grid}) != ("goniophotometer", EXPLORER_AXES):
                allowed = "a goniophotometer over optical_radius_um and incidence_deg"
                raise ConfigError(f"{key}: must be {allowed}")

    def list_warnings(self, available: Mapping[str, ExperimentConfig]) -> list[str]:
        """Return a line for each study, and for the explorer, that lacks experiments.

        Studies without any existing experiment, or one of a similar name, share a line.
        """
        messages = find_incomplete_studies(self.studies, available)
        unused = []
        for name in list(messages):
            required = self.studies[name].list_experiments(self.studies)
            if not any(one in available or suggest_name(one, available) for one in required):
                del messages[name]
                unused.append(name)
        names = [*self.explorer.values(), *self.explorer_directions.values()]
        warnings = [
            *messages.values(),
            *(f"explorer: {m}" for m in describe_missing(names, available)),
        ]
        if unused:
            warnings.append(f"none of their experiments exists: studies {join_names(unused)}")
        return warnings

    def select_explorer(
        self, available: Mapping[str, ExperimentConfig]
    ) -> tuple[dict[str, str], dict[str, str]]:
        """Return the experiments of the explorer's tables and directions, by label.

        Without one of the tables there are none; directions are optional.
        """
        is_complete = set(self.explorer.values()) <= set(available)
        directions = {
            label: name for label, name in self.explorer_directions.items() if name in available
        }
        return self.explorer if is_complete else {}, directions

    def select_experiments(
        self, available: Mapping[str, ExperimentConfig]
    ) -> dict[str, ExperimentConfig]:
        """Return the selected experiments; reject unknown or repeated names and invalid studies."""
        groups = dict.fromkeys([*DEFAULT_GROUPS, *(one.group for one in available.values())])
        for key, names, known in (
            ("experiments", self.experiments, [*groups, *available]),
            ("archive", self.archive, list(available)),
        ):
            if not isinstance(names, str) and len(set(names)) < len(names):
                raise ConfigError(str(invalid(key, list(names), "different names")))
            for name in () if isinstance(names, str) else names:
                if name not in known:
                    hint = suggest_name(name, known) or "known: " + ", ".join(known)
                    what = "experiment or group" if key == "experiments" else "experiment"
                    raise ConfigError(f"{key} = {name!r}: no such {what} ({hint})")
        for group in groups:
            if group in available or group in self.studies:
                raise ConfigError(f"group = {group!r}: must differ from experiments and studies")
        chosen = [*groups] if self.experiments == "everything" else self.experiments
        selected = {
            name: one for name, one in available.items() if name in chosen or one.group in chosen
        }
        if not selected:
            given = ", ".join(chosen) or "[]"
            raise ConfigError(f"experiments = {given}: must select at least one experiment")
        self.select_archived(selected)
        check_studies(self.studies, available, self.table_folders)
        self._check_explorer(available)
        return selected
