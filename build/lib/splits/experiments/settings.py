"""What the main configuration file may say: which experiments run, how far, and where to."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from splits.checks import one_of, suggestion
from splits.experiments.model import Experiment
from splits.experiments.sections import Section
from splits.experiments.studies import Study, check_studies
from splits.experiments.yaml_files import ConfigError


class Accuracy(Section):
    """How far simulations run."""

    max_stderr: float = Field(ge=1e-6, le=0.5)
    relative_stderr: float = Field(default=0.02, ge=1e-4, le=0.5)
    max_rays: int | None = Field(default=None, ge=1, lt=2**63)


class Settings(Section):
    """The main configuration file."""

    experiments: Literal["all"] | tuple[str, ...] = "all"
    accuracy: str = "standard"
    accuracies: dict[str, Accuracy]
    seed: int = Field(default=1, ge=0, lt=2**63)
    experiments_folder: str = "config/experiments"
    media_folder: str = "config/media"
    measured_folder: str = "config/measured"
    published_folder: str = "config/published"
    results: str = "results"
    archive: tuple[str, ...] | Literal["all"] = "all"
    studies: dict[str, Study] = Field(default_factory=dict)

    @field_validator("experiments", mode="before")
    @classmethod
    def _names(cls, value: Any) -> Any:
        # On the command line a list is written with commas.
        if isinstance(value, str) and value != "all":
            return tuple(value.split(","))
        return value

    @model_validator(mode="after")
    def _known_accuracy(self) -> Settings:
        one_of("accuracy", self.accuracy, self.accuracies)
        return self

    @property
    def results_folder(self) -> str:
        """Where results go: `results`, with a subfolder for accuracies other than standard."""
        return self.results if self.accuracy == "standard" else f"{self.results}/{self.accuracy}"

    @property
    def tables(self) -> dict[str, Path]:
        """Where tables of measured and of published numbers are."""
        return {"measured": Path(self.measured_folder), "published": Path(self.published_folder)}

    def select(self, available: Mapping[str, Experiment]) -> dict[str, Experiment]:
        """Return the experiments chosen among those available.

        Raises
        ------
        ConfigError
            For a name that is not available or taken twice, or a study that cannot be made.
        """
        for key, names in (("experiments", self.experiments), ("archive", self.archive)):
            for name in () if names == "all" else names:
                if name not in available:
                    hint = suggestion(name, available) or "known: " + ", ".join(available)
                    raise ConfigError(f"{key} = {name!r}: no such experiment ({hint})")
        check_studies(self.studies, available, self.tables)
        chosen = available if self.experiments == "all" else self.experiments
        return {name: available[name] for name in chosen}
