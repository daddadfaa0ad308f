"""Validation of studies: their settings, experiments and files, and unique names of products."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from splits.analysis.measured import read_measured, read_published, read_spectra
from splits.core.validation import check_choice, check_integer, check_range, invalid, unknown_key
from splits.core.yaml import ConfigError
from splits.experiments.config.experiment import RESERVED_NAMES, ExperimentConfig
from splits.experiments.config.retrieve_checks import check_on_grid
from splits.experiments.config.sections import check_path
from splits.experiments.config.simulation import NAME_PATTERN, NAME_RULE
from splits.experiments.config.study import SensitivityPair, Study
from splits.experiments.config.study_inputs import (
    OVERLAP_CHOICES,
    OVERLAPS_KEY,
    SENSITIVITY_DEPTHS_M,
    StudyInput,
)
from splits.experiments.config.study_kinds import (
    PARTIAL_KINDS,
    STUDY_FILES,
    STUDY_INPUTS,
    STUDY_PRODUCTS,
    TABLE_KINDS,
)
from splits.illumination.bands import SENSORS
from splits.media.interpretations import INTERPRETATION_CHOICES, Interpretation

TABLE_READERS = {"published": read_published, "directions": read_measured}
"""Functions that read tables of studies other than spectra."""


def check_studies(
    studies: Mapping[str, Study],
    available: Mapping[str, ExperimentConfig],
    tables: Mapping[str, Path],
) -> None:
    """Reject invalid studies, and names that are used twice.

    Parameters
    ----------
    studies, available : mapping
        Studies, and all experiments, by name.
    tables : mapping
        Folders of ``published`` and ``measured`` tables.

    Raises
    ------
    ConfigError
        With one line that names the study, the key, the value and the allowed values.
    """
    for study, definition in studies.items():
        try:
            _check_keys(definition)
            _check_study_names(study, definition, studies)
            _check_files(definition, tables)
            _check_fixed_values(definition, available)
            for role, name in definition.inputs.items():
                if name in available and definition.kind in TABLE_KINDS:
                    _check_table(f"inputs.{role}", available[name])
                elif name in available:
                    _check_input(
                        f"inputs.{role}", available[name], STUDY_INPUTS[definition.kind][role]
                    )
            for pair, sensitivity_pair in definition.pairs.items():
                _check_pair(f"pairs.{pair}", sensitivity_pair, available)
        except ValueError as error:
            raise ConfigError(f"studies.{study}.{error}") from None
    check_unique_names(studies, available)


def _check_keys(study: Study) -> None:
    """Reject keys that a kind of study does not have, and missing required ones."""
    roles = STUDY_INPUTS.get(study.kind, {})
    if study.kind in TABLE_KINDS:
        if not study.inputs:
            raise invalid("inputs", study.inputs, "at least one experiment by name")
        if len({role.replace("_", " ") for role in study.inputs}) < len(study.inputs):
            hint = "underscores are shown as spaces"
            raise invalid("inputs", list(study.inputs), "names that differ", hint)
        roles = dict.fromkeys(study.inputs, StudyInput(()))
    for key, allowed_names in (
        ("inputs", roles), ("files", STUDY_FILES.get(study.kind, {})),
        ("outputs", STUDY_PRODUCTS[study.kind]),
    ):  # fmt: skip
        for name in getattr(study, key):
            if not allowed_names:
                raise invalid(key, getattr(study, key), f"left out for kind = {study.kind!r}")
            if name not in allowed_names:
                raise unknown_key(f"{key}.{name}", allowed_names)
    missing = [role for role in roles if role not in study.inputs]
    if missing and (study.kind not in PARTIAL_KINDS or not study.inputs):
        which = "one of" if study.kind in PARTIAL_KINDS else "the roles"
        raise invalid("inputs", study.inputs, f"with {which} {', '.join(missing)}")
    if (study.kind == "sensitivity") != bool(study.pairs):
        allowed = "at least one pair" if study.kind == "sensitivity" else "left out"
        raise invalid("pairs", study.pairs, f"{allowed} for kind = {study.kind!r}")
    if (study.kind in ("agreement", "interpretation")) != (study.sensitivity is not None):
        allowed = "the name of a study" if study.sensitivity is None else "left out"
        raise invalid("sensitivity", study.sensitivity, f"{allowed} for kind = {study.kind!r}")
    _check_interpretations(study)
    _check_bands(study)
    required_files = STUDY_FILES.get(study.kind, {}) if study.kind != "sensitivity" else {}
    for key in required_files:
        if key not in study.files:
            raise invalid("files", study.files, f"with {', '.join(required_files)}")
    for key, name in study.outputs.items():
        if not NAME_PATTERN.fullmatch(name):
            raise invalid(f"outputs.{key}", name, NAME_RULE)


def _check_interpretations(study: Study) -> None:
    """Reject unknown interpretations, and a section that is missing or not allowed."""
    if (study.kind == "interpretation") != bool(study.interpretation):
        allowed = "choices by keyword" if study.kind == "interpretation" else "left out"
        raise invalid(
            "interpretation", study.interpretation, f"{allowed} for kind = {study.kind!r}"
        )
    known_choices = {f.name: INTERPRETATION_CHOICES[f.name] for f in fields(Interpretation)} | {
        OVERLAPS_KEY: tuple(OVERLAP_CHOICES)
    }
    for key, choices in study.interpretation.items():
        if key not in known_choices:
            raise unknown_key(f"interpretation.{key}", known_choices)
        for choice in choices:
            check_choice(f"interpretation.{key}", choice, known_choices[key])
    for key, choice in study.stated.items():
        if key not in study.interpretation:
            raise unknown_key(f"stated.{key}", study.interpretation)
        check_choice(f"stated.{key}", choice, study.interpretation[key])


def _check_bands(study: Study) -> None:
    """Reject an invalid selection of bands, and its keys for another kind of study."""
    if study.kind != "bands":
        # Archives contain all keys with their defaults.
        for key in ("bands", "noise", "n_bands", "fixed"):
            default = Study.model_fields[key].get_default(call_default_factory=True)
            if getattr(study, key) != default:
                raise invalid(key, getattr(study, key), "left out unless kind = 'bands'")
        return
    if study.bands is not None:
        check_choice("bands", study.bands, SENSORS)
    check_range("noise", study.noise, 0.0, 1.0, open_low=True)
    check_integer("n_bands", study.n_bands, 1)


def _check_study_names(study: str, definition: Study, studies: Mapping[str, Study]) -> None:
    if not NAME_PATTERN.fullmatch(study) or study in RESERVED_NAMES:
        raise invalid("name", study, f"{NAME_RULE}, none of the workflow's rules")
    if definition.sensitivity is not None:
        kinds = {name: other.kind for name, other in studies.items()}
        sensitivity_studies = [name for name, kind in kinds.items() if kind == "sensitivity"]
        check_choice("sensitivity", definition.sensitivity, sensitivity_studies)


def _check_files(definition: Study, tables: Mapping[str, Path]) -> None:
    for key, file in definition.files.items():
        check_path(f"files.{key}", file)
        folder = tables[STUDY_FILES[definition.kind][key]]
        if not (folder / file).is_file():
            check_choice(f"files.{key}", file, [path.name for path in folder.glob("*.csv")])
        TABLE_READERS.get(key, read_spectra)(folder / file, f"files.{key}")


def _check_table(key: str, experiment: ExperimentConfig) -> None:
    """Reject an experiment that is no table over two numeric parameters or more."""
    axes = experiment.make_axes().values if experiment.instrument.kind == "table" else ()
    numeric_axes = [row for row in axes if len(row) > 1 and not isinstance(row[0], str)]
    if len(numeric_axes) < 2:
        raise invalid(key, experiment.name, "a table over two parameters or more")


def _check_fixed_values(definition: Study, available: Mapping[str, ExperimentConfig]) -> None:
    """Reject fixed values outside the axes of all tables, and text axes that are not fixed."""
    if definition.kind != "bands":
        return
    tables = [available[n] for n in definition.inputs.values() if n in available]
    rows = {
        name: row
        for experiment in tables
        for name, row in zip(*experiment.make_axes(), strict=True)
    }
    for name, value in definition.fixed.items() if tables else ():
        if name not in rows:
            raise unknown_key(f"fixed.{name}", rows)
        check_on_grid(f"fixed.{name}", value, rows[name])
    for name, row in rows.items():
        if isinstance(row[0], str) and len(row) > 1 and name not in definition.fixed:
            raise invalid(f"fixed.{name}", "nothing", f"one of {', '.join(map(str, row))}")


def _check_input(name: str, experiment: ExperimentConfig, required: StudyInput) -> None:
    """Reject an experiment that does not meet the requirements of an input."""
    instrument, grid = experiment.instrument, experiment.grid

    def make_error(allowed: str) -> ValueError:
        return invalid(name, experiment.name, allowed)

    if instrument.kind != required.instrument or experiment.fit:
        raise make_error(f"an experiment with a {required.instrument}")
    if set(grid) != set(required.axes) or any(len(grid[key]) < 2 for key in required.axes):
        grid_rule = f"over {' and '.join(required.axes)}, two values or more each"
        raise make_error(f"an experiment {grid_rule if required.axes else 'without a grid'}")
    for key, labels in required.labels.items():
        for label in labels:
            if not _has_value(grid[key], label):
                raise make_error(f"an experiment with {key} = {label} on its grid")
    wavelengths = instrument.get_wavelengths()
    for wavelength in required.at_nm:
        if not np.isclose(wavelengths, wavelength).any():
            raise make_error(f"an experiment with wavelength {wavelength:g} nm")
    if required.band_nm and (
        wavelengths[0] > required.band_nm[0] or wavelengths[-1] < required.band_nm[-1]
    ):
        low, high = required.band_nm
        raise make_error(f"an experiment over wavelengths from {low:g} to {high:g} nm")
    has_own_directions = instrument.polar_deg or instrument.estimator == "bins"
    if required.instrument == "goniophotometer" and has_own_directions:
        raise make_error("an experiment with the usual polar_deg")


def _check_pair(key: str, pair: SensitivityPair, available: Mapping[str, ExperimentConfig]) -> None:
    axes = (pair.parameter, "depth_m")
    extremes: dict[str, tuple[float | str, ...]] = {pair.parameter: (pair.low, pair.high)}
    band = (400.0, 2500.0)
    if pair.experiment in available:
        role = StudyInput(axes, {**extremes, **SENSITIVITY_DEPTHS_M}, band_nm=band)
        _check_input(f"{key}.experiment", available[pair.experiment], role)
    if pair.interpretation in available:
        role = StudyInput((*axes, "interpretation"), SENSITIVITY_DEPTHS_M, band_nm=band)
        _check_input(f"{key}.interpretation", available[str(pair.interpretation)], role)


def _has_value(values: Mapping[str, Any], target: float | str) -> bool:
    """Return whether the values of a grid include one, by its label or as a number."""
    if isinstance(target, str):
        return target in values
    numbers = [value for value in values.values() if isinstance(value, (int, float))]
    return f"{target:g}" in values or bool(np.isclose(numbers, target).any())


def check_unique_names(
    studies: Mapping[str, Study], available: Mapping[str, ExperimentConfig]
) -> None:
    """Reject names of experiments and studies that other products have.

    Raises
    ------
    ConfigError
        With one line for the first conflict.
    """
    owners: dict[str, str] = {}
    for study, definition in studies.items():
        owner = f"the study {study}"
        for name in dict.fromkeys([study, *definition.list_product_names(study).values()]):
            if owners.setdefault(name, owner) != owner:
                raise ConfigError(_describe_name_conflict(f"studies.{study}", name, owners[name]))
    study_names = set(owners)
    for name, experiment in available.items():
        for suffix, section in (("parameters", experiment.fit), ("retrieved", experiment.retrieve)):
            table = f"{name}_{suffix}"
            if table in study_names:
                raise ConfigError(
                    _describe_name_conflict(f"experiment {name}", table, owners[table])
                )
            if section:
                owners[table] = f"the table of the experiment {name}"
    for name in available:
        if name in owners:
            raise ConfigError(_describe_name_conflict(f"experiment {name}", name, owners[name]))


def _describe_name_conflict(key: str, name: str, owner: str) -> str:
    allowed = "unique"
    return f"{key}: {invalid('name', name, allowed, f'{owner} has it')}"
