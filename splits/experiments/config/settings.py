"""Model of the main configuration file: selected experiments, accuracy and folders."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from splits.core.paths import expand_path
from splits.core.validation import check_choice, invalid, suggest_name
from splits.core.yaml import ConfigError
from splits.experiments.config.experiment import OWN_GROUP, ExperimentConfig
from splits.experiments.config.sections import (
    MAX_LABEL_CHARS,
    MAX_TITLE_CHARS,
    ConfigSection,
    check_path,
    check_text,
)
from splits.experiments.studies import AnyStudy
from splits.experiments.studies.checks import check_studies
from splits.io.ro_crate import ORCID_URL, Author

DEFAULT_LICENCE = "MIT"
"""Default licence of results: that of the software."""
RESULT_FOLDERS = ("archive", "benchmarks", "blocks", "data", "figures", "logs", "tables")
"""Subfolders of the results folder, which the workflow creates."""
_ACCURACY_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_LICENCE_PATTERN = re.compile(
    r"[A-Za-z0-9][A-Za-z0-9.+-]{0,99}|https?://[\w.~:/?#@!$&'()*+,;=%-]{1,300}", re.ASCII
)


class Accuracy(ConfigSection):
    """Target standard errors and the limit of rays of simulations."""

    max_stderr: float = Field(ge=1e-6, le=0.5)
    relative_stderr: float = Field(default=0.02, ge=1e-4, le=0.5)
    max_rays: int | None = Field(default=None, ge=1, lt=2**63)


class ArchiveAuthor(ConfigSection):
    """An author of the results in an archive."""

    name: str
    orcid: str = ""
    affiliation: str = ""

    @field_validator("name", "affiliation")
    @classmethod
    def _check_text(cls, value: str) -> str:
        return check_text("archive_authors", value, MAX_TITLE_CHARS)

    @field_validator("orcid")
    @classmethod
    def _check_orcid(cls, value: str) -> str:
        digits = value.removeprefix(ORCID_URL)
        if not value or _is_orcid(digits):
            return digits
        allowed = "an ORCID such as 0000-0002-1825-0097, with a valid check digit"
        raise invalid("archive_authors.orcid", value, allowed)


def _is_orcid(digits: str) -> bool:
    """Return whether a text is an ORCID with a valid check digit (ISO 7064, MOD 11-2)."""
    if not re.fullmatch(r"(\d{4}-){3}\d{3}[\dX]", digits, re.ASCII):
        return False
    total = 0
    for digit in digits.replace("-", "")[:-1]:
        total = 2 * (total + int(digit))
    return digits[-1] == "0123456789X"[(12 - total) % 11]


DEFAULT_GROUPS = ("papers", OWN_GROUP)
"""Groups of experiments that are selected by default."""
EXPLORER_DIRECTION_AXES = ("optical_radius_um", "incidence_deg")
"""Grid axes of the experiments that give the explorer's BRDFs."""


FOLDER_KEYS = (
    "experiments_folder",
    "media_folder",
    "measured_folder",
    "published_folder",
    "results",
)
"""Settings that are paths of folders."""


class Settings(ConfigSection):
    """The main configuration file."""

    experiments: Literal["everything"] | tuple[str, ...] = DEFAULT_GROUPS
    accuracy: str = "standard"
    accuracies: dict[str, Accuracy]
    seed: int = Field(default=1, ge=0, lt=2**63)
    experiments_folder: str = "config/experiments"
    media_folder: str = "config/media"
    measured_folder: str = "config/measured"
    published_folder: str = "config/published"
    results: str = "results"
    archive: tuple[str, ...] | Literal["all"] = "all"
    archive_license: str = DEFAULT_LICENCE
    archive_authors: tuple[ArchiveAuthor, ...] = ()
    studies: dict[str, AnyStudy] = Field(default_factory=dict)
    explorer: dict[str, str] = Field(default_factory=dict)
    explorer_directions: dict[str, str] = Field(default_factory=dict)

    @field_validator("experiments", "archive", mode="before")
    @classmethod
    def _split_names(cls, value: Any) -> Any:
        # Lists on the command line are separated by commas.
        if isinstance(value, str) and value not in ("all", "everything"):
            return tuple(name.strip() for name in value.split(","))
        return value

    @field_validator(*FOLDER_KEYS)
    @classmethod
    def _check_folder(cls, value: str, info: ValidationInfo) -> str:
        key = str(info.field_name)
        # Snakemake compares paths as texts, so each file needs a unique spelling.
        path = posixpath.normpath(str(expand_path(value, key))) if value else "."
        if path == ".":
            raise invalid(key, value, "the path of a folder")
        return check_path(key, path)

    @field_validator("archive_license")
    @classmethod
    def _check_licence(cls, value: str) -> str:
        if not _LICENCE_PATTERN.fullmatch(value):
            allowed = "an SPDX identifier such as MIT or CC-BY-4.0, or a URL"
            raise invalid("archive_license", value, allowed)
        return value

    @field_validator("explorer")
    @classmethod
    def _check_labels(cls, value: dict[str, str]) -> dict[str, str]:
        for label in value:
            check_text("explorer (label)", label, MAX_LABEL_CHARS)
        return value

    @field_validator("accuracies")
    @classmethod
    def _check_accuracy_names(cls, value: dict[str, Accuracy]) -> dict[str, Accuracy]:
        for name in value:
            if not _ACCURACY_PATTERN.fullmatch(name) or name.lower() in RESULT_FOLDERS:
                allowed = "letters, digits, _, - and ., none of " + ", ".join(RESULT_FOLDERS)
                raise invalid("accuracies", name, allowed, "it names a folder")
        return value

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

    def select_archived(self, selected: Iterable[str]) -> Settings:
        """Return the settings of a run that makes the content of an archive only.

        Parameters
        ----------
        selected : iterable of str
            Names of the selected experiments.

        Raises
        ------
        ConfigError
            If no experiment of the archive is selected.
        """
        if self.archive == "all":
            return self.model_copy(update={"experiments": tuple(selected)})
        names = tuple(name for name in self.archive if name in selected)
        if not names:
            allowed = "one or more of the experiments selected"
            raise ConfigError(f"archive = {', '.join(self.archive)}: must be {allowed}")
        others: dict[str, Any] = {"studies": {}, "explorer": {}, "explorer_directions": {}}
        return self.model_copy(update={"experiments": names, "archive": "all", **others})

    def list_authors(self) -> tuple[Author, ...]:
        """Return the authors of an archive, if any are given."""
        return tuple(Author(**author.model_dump()) for author in self.archive_authors)

    def _check_explorer(self, available: Mapping[str, ExperimentConfig]) -> None:
        """Reject experiments that the explorer cannot show."""
        for label, name in self.explorer.items():
            if name in available and available[name].instrument.kind != "table":
                kind = available[name].instrument.kind
                raise ConfigError(f"explorer.{label} = {name!r}: must be a table (it is a {kind})")
            rows = dict(zip(*available[name].make_axes(), strict=True)) if name in available else {}
            for axis, row in rows.items():
                if len(row) < 2 or isinstance(row[0], str):
                    key = f"explorer.{label} = {name!r}"
                    raise ConfigError(f"{key}: its axis {axis} must have at least two numbers")
        for label, name in self.explorer_directions.items():
            key = f"explorer_directions.{label} = {name!r}"
            if label not in self.explorer:
                labels = ", ".join(self.explorer) or "none"
                raise ConfigError(f"{key}: must have the name of a table in explorer ({labels})")
            if name not in available:
                continue
            experiment = available[name]
            if experiment.instrument.kind != "goniophotometer" or {*experiment.grid} != {
                *EXPLORER_DIRECTION_AXES
            }:
                allowed = f"a goniophotometer over {' and '.join(EXPLORER_DIRECTION_AXES)}"
                raise ConfigError(f"{key}: must be {allowed}")

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
        """Return the selected experiments.

        Raises
        ------
        ConfigError
            For an unknown or repeated name, or an invalid study.
        """
        groups = dict.fromkeys([*DEFAULT_GROUPS, *(one.group for one in available.values())])
        for key, names, known in (
            ("experiments", self.experiments, [*groups, *available]),
            ("archive", self.archive, list(available)),
        ):
            for name in () if isinstance(names, str) else names:
                if name not in known:
                    hint = suggest_name(name, known) or "known: " + ", ".join(known)
                    raise ConfigError(f"{key} = {name!r}: no such experiment ({hint})")
        for group in dict.fromkeys(one.group for one in available.values()):
            if group in available or group in self.studies:
                raise ConfigError(f"group = {group!r}: must differ from experiments and studies")
        chosen = [*groups] if self.experiments == "everything" else self.experiments
        selected = {
            name: one for name, one in available.items() if name in chosen or one.group in chosen
        }
        if not selected:
            raise ConfigError(f"experiments = {', '.join(chosen)}: no experiment is in this group")
        self.select_archived(selected)
        check_studies(self.studies, available, self.table_folders)
        self._check_explorer(available)
        return selected
