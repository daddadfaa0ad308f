"""Studies: tables and figures that are made of several experiments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

from pydantic import Field

from splits.core.validation import suggest_name
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.sections import ConfigSection
from splits.experiments.config.study_kinds import STUDY_PRODUCTS


class SensitivityPair(ConfigSection):
    """Two values of a parameter between which a spectrum's sensitivity is taken.

    `experiment` varies the parameter, and `interpretation` besides it the readings of the papers.
    `source` says whether the paper states the two values or they were chosen here.
    """

    parameter: str
    experiment: str
    interpretation: str | None = None
    low: float | str
    high: float | str
    source: Literal["paper", "ours"] = "ours"


class Study(ConfigSection):
    """One analysis of several experiments."""

    kind: Literal[
        "sensitivity", "agreement", "sand_tables", "sand_compositions", "angular_trends",
        "layer_trends", "interpretation", "surface_area", "sobol", "bands",
        "anisotropy",
    ]  # fmt: skip
    inputs: dict[str, str] = Field(default_factory=dict)
    pairs: dict[str, SensitivityPair] = Field(default_factory=dict)
    sensitivity: str | None = None
    interpretation: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    stated: dict[str, str] = Field(default_factory=dict)
    files: dict[str, str] = Field(default_factory=dict)
    outputs: dict[str, str] = Field(default_factory=dict)
    bands: str | None = None
    noise: float = 0.01
    n_bands: int = 5
    fixed: dict[str, float | str] = Field(default_factory=dict)

    def list_experiments(self) -> list[str]:
        """Return the names of the experiments that it is made of, each once."""
        names = list(self.inputs.values())
        for pair in self.pairs.values():
            names += [pair.experiment, *([pair.interpretation] if pair.interpretation else [])]
        return list(dict.fromkeys(names))

    def list_product_names(self, study: str) -> dict[str, str]:
        """Return the name of every product, without folder and suffix, by its key."""
        usual = STUDY_PRODUCTS[self.kind]
        return {key: self.outputs.get(key, usual[key].name.format(study=study)) for key in usual}

    def list_product_paths(self, study: str) -> dict[str, list[str]]:
        """Return the files of every product by its key, relative to the folder of results."""
        usual = STUDY_PRODUCTS[self.kind]
        return {
            key: [f"{usual[key].folder}/{name}{suffix}" for suffix in usual[key].suffixes]
            for key, name in self.list_product_names(study).items()
        }


def describe_missing(
    required: Iterable[str],
    selected: Mapping[str, ExperimentConfig],
    available: Mapping[str, ExperimentConfig],
) -> list[str]:
    """Return which experiments are needed and not selected, in words."""
    required = [one for one in dict.fromkeys(required) if one not in selected]
    idle = [one for one in required if one in available]
    lacking = [f"not selected: {', '.join(idle)}"] if idle else []
    for one in required:
        if one not in available:
            hint = suggest_name(one, available)
            lacking.append(f"no such experiment: {one}" + (f" ({hint})" if hint else ""))
    return lacking


def find_incomplete_studies(
    studies: Mapping[str, Study],
    selected: Mapping[str, ExperimentConfig],
    available: Mapping[str, ExperimentConfig],
) -> dict[str, str]:
    """Return the studies that lack experiments among those selected, each with a line saying so."""
    lines = {}
    for name, study in studies.items():
        needed = study.list_experiments()
        if study.sensitivity:
            needed += studies[study.sensitivity].list_experiments()
        lacking = describe_missing(needed, selected, available)
        sands = [one for one in selected.values() if one.medium.get("kind") == "sand"]
        if study.kind == "sand_compositions" and not sands:
            lacking = ["no experiment with sand is selected"]
        if lacking:
            lines[name] = f"study {name} is left out: {'; '.join(lacking)}"
    return lines
