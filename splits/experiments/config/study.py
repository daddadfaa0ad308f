"""Studies: tables and figures made from several experiments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

from pydantic import Field

from splits.core.validation import suggest_name
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.sections import ConfigSection
from splits.experiments.config.study_kinds import STUDY_PRODUCTS


class SensitivityPair(ConfigSection):
    """Two values of a parameter between which the sensitivity of a spectrum is computed.

    `experiment` varies the parameter, and the experiment `interpretation` the interpretation of the
    papers as well.  `source` is the origin of the two values: the paper, or our choice.
    """

    parameter: str
    experiment: str
    interpretation: str | None = None
    low: float | str
    high: float | str
    source: Literal["paper", "ours"] = "ours"


class Study(ConfigSection):
    """An analysis of several experiments."""

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
        """Return the names of the experiments of the study, without repetition."""
        names = list(self.inputs.values())
        for pair in self.pairs.values():
            names += [pair.experiment, *([pair.interpretation] if pair.interpretation else [])]
        return list(dict.fromkeys(names))

    def list_product_names(self, study: str) -> dict[str, str]:
        """Return the names of all products, without folder and suffix, by key."""
        products = STUDY_PRODUCTS[self.kind]
        return {
            key: self.outputs.get(key, products[key].name.format(study=study)) for key in products
        }

    def list_product_paths(self, study: str) -> dict[str, list[str]]:
        """Return the files of all products by key, relative to the results folder."""
        products = STUDY_PRODUCTS[self.kind]
        return {
            key: [f"{products[key].folder}/{name}{suffix}" for suffix in products[key].suffixes]
            for key, name in self.list_product_names(study).items()
        }


def describe_missing(
    required: Iterable[str],
    selected: Mapping[str, ExperimentConfig],
    available: Mapping[str, ExperimentConfig],
) -> list[str]:
    """Return messages about required experiments that are not selected or do not exist."""
    required = [name for name in dict.fromkeys(required) if name not in selected]
    unselected = [name for name in required if name in available]
    messages = [f"not selected: {', '.join(unselected)}"] if unselected else []
    for name in required:
        if name not in available:
            hint = suggest_name(name, available)
            messages.append(f"no such experiment: {name}" + (f" ({hint})" if hint else ""))
    return messages


def find_incomplete_studies(
    studies: Mapping[str, Study],
    selected: Mapping[str, ExperimentConfig],
    available: Mapping[str, ExperimentConfig],
) -> dict[str, str]:
    """Return a message for each study of which not all experiments are selected."""
    messages = {}
    for name, study in studies.items():
        required = study.list_experiments()
        if study.sensitivity:
            required += studies[study.sensitivity].list_experiments()
        missing = describe_missing(required, selected, available)
        sands = [
            experiment
            for experiment in selected.values()
            if experiment.medium.get("kind") == "sand"
        ]
        if study.kind == "sand_compositions" and not sands:
            missing = ["no experiment with sand is selected"]
        if missing:
            messages[name] = f"study {name} is left out: {'; '.join(missing)}"
    return messages
