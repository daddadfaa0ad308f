"""What studies must be: every name that they use, and every name that they take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from splits.analysis.measured import read_measured, read_spectra
from splits.core.validation import check_choice, check_range, invalid, unknown_key
from splits.core.yaml import ConfigError
from splits.experiments.config.experiment import RESERVED_NAMES, ExperimentConfig
from splits.experiments.config.retrieve_checks import check_within_axis
from splits.experiments.config.sections import check_path
from splits.experiments.config.simulation import NAME_PATTERN, NAME_RULE
from splits.experiments.config.study import SensitivityPair, Study
from splits.experiments.config.study_inputs import SENSITIVITY_DEPTHS_M, StudyInput
from splits.experiments.config.study_kinds import (
    PARTIAL_KINDS,
    STUDY_FILES,
    STUDY_INPUTS,
    STUDY_PRODUCTS,
    TABLE_KINDS,
)
from splits.experiments.papers.agreement import read_published
from splits.experiments.papers.interpretation_ranking import BOUNDARIES_KEY, OVERLAP_CHOICES
from splits.illumination.bands import SENSORS
from splits.media.interpretations import INTERPRETATION_CHOICES, Interpretation
from splits.simulation.arguments import check_integer

TABLE_READERS = {"published": read_published, "directions": read_measured}
"""What reads tables of studies that do not hold spectra."""


def check_studies(
    studies: Mapping[str, Study],
    available: Mapping[str, ExperimentConfig],
    tables: Mapping[str, Path],
) -> None:
    """Refuse studies that cannot be made, and names that two things would have.

    Parameters
    ----------
    studies, available : mapping
        By name.
    tables : mapping
        Folders of ``published`` and ``measured`` numbers.

    Raises
    ------
    ConfigError
        With one line that names the study, the key, the value and what is allowed.
    """
    for study, about in studies.items():
        try:
            _check_keys(about)
            _check_study_names(study, about, studies)
            _check_files(about, tables)
            _check_fixed_values(about, available)
            for role, name in about.inputs.items():
                if name in available and about.kind in TABLE_KINDS:
                    _check_table(f"inputs.{role}", available[name])
                elif name in available:
                    _check_input(f"inputs.{role}", available[name], STUDY_INPUTS[about.kind][role])
            for pair, given in about.pairs.items():
                _check_pair(f"pairs.{pair}", given, available)
        except ValueError as error:
            raise ConfigError(f"studies.{study}.{error}") from None
    check_unique_names(studies, available)


def _check_keys(study: Study) -> None:
    """Refuse keys that a kind of study does not know, or the lack of those that it needs."""
    roles = STUDY_INPUTS.get(study.kind, {})
    if study.kind in TABLE_KINDS:
        if not study.inputs:
            raise invalid("inputs", study.inputs, "at least one experiment by name")
        if len({role.replace("_", " ") for role in study.inputs}) < len(study.inputs):
            hint = "underscores are shown as spaces"
            raise invalid("inputs", list(study.inputs), "names that differ", hint)
        roles = dict.fromkeys(study.inputs, StudyInput(()))
    for key, known in (
        ("inputs", roles), ("files", STUDY_FILES.get(study.kind, {})),
        ("outputs", STUDY_PRODUCTS[study.kind]),
    ):  # fmt: skip
        for name in getattr(study, key):
            if not known:
                raise invalid(key, getattr(study, key), f"left out for kind = {study.kind!r}")
            if name not in known:
                raise unknown_key(f"{key}.{name}", known)
    missing = [role for role in roles if role not in study.inputs]
    if missing and (study.kind not in PARTIAL_KINDS or not study.inputs):
        needed = "one of" if study.kind in PARTIAL_KINDS else "the roles"
        raise invalid("inputs", study.inputs, f"with {needed} {', '.join(missing)}")
    if (study.kind == "sensitivity") != bool(study.pairs):
        allowed = "at least one pair" if study.kind == "sensitivity" else "left out"
        raise invalid("pairs", study.pairs, f"{allowed} for kind = {study.kind!r}")
    if (study.kind in ("agreement", "interpretation")) != (study.sensitivity is not None):
        allowed = "the name of a study" if study.sensitivity is None else "left out"
        raise invalid("sensitivity", study.sensitivity, f"{allowed} for kind = {study.kind!r}")
    _check_interpretations(study)
    _check_bands(study)
    wanted = STUDY_FILES.get(study.kind, {}) if study.kind != "sensitivity" else {}
    for key in wanted:
        if key not in study.files:
            raise invalid("files", study.files, f"with {', '.join(wanted)}")
    for key, name in study.outputs.items():
        if not NAME_PATTERN.fullmatch(name):
            raise invalid(f"outputs.{key}", name, NAME_RULE)


def _check_interpretations(study: Study) -> None:
    """Refuse readings that there are not, and their lack or presence where it is wrong."""
    if (study.kind == "interpretation") != bool(study.interpretation):
        allowed = "choices by reading" if study.kind == "interpretation" else "left out"
        raise invalid(
            "interpretation", study.interpretation, f"{allowed} for kind = {study.kind!r}"
        )
    known = {f.name: INTERPRETATION_CHOICES[f.name] for f in fields(Interpretation)} | {
        BOUNDARIES_KEY: tuple(OVERLAP_CHOICES)
    }
    for key, choices in study.interpretation.items():
        if key not in known:
            raise unknown_key(f"interpretation.{key}", known)
        for choice in choices:
            check_choice(f"interpretation.{key}", choice, known[key])
    for key, choice in study.stated.items():
        if key not in study.interpretation:
            raise unknown_key(f"stated.{key}", study.interpretation)
        check_choice(f"stated.{key}", choice, study.interpretation[key])


def _check_bands(study: Study) -> None:
    """Refuse a choice of bands that cannot be, and its keys for another kind of study."""
    if study.kind != "bands":
        # Archives say all keys, as they are by default.
        for key in ("bands", "noise", "n_bands", "fixed"):
            usual = Study.model_fields[key].get_default(call_default_factory=True)
            if getattr(study, key) != usual:
                raise invalid(key, getattr(study, key), "left out but for kind = 'bands'")
        return
    if study.bands is not None:
        check_choice("bands", study.bands, SENSORS)
    check_range("noise", study.noise, 0.0, 1.0, open_low=True)
    check_integer("n_bands", study.n_bands, 1)


def _check_study_names(study: str, definition: Study, studies: Mapping[str, Study]) -> None:
    if not NAME_PATTERN.fullmatch(study) or study in RESERVED_NAMES:
        raise invalid("name", study, f"{NAME_RULE}, no rule's name")
    if definition.sensitivity is not None:
        kinds = {name: one.kind for name, one in studies.items()}
        known = [name for name, kind in kinds.items() if kind == "sensitivity"]
        check_choice("sensitivity", definition.sensitivity, known)


def _check_files(definition: Study, tables: Mapping[str, Path]) -> None:
    for key, file in definition.files.items():
        check_path(f"files.{key}", file)
        place = tables[STUDY_FILES[definition.kind][key]]
        if not (place / file).is_file():
            check_choice(f"files.{key}", file, [path.name for path in place.glob("*.csv")])
        TABLE_READERS.get(key, read_spectra)(place / file, f"files.{key}")


def _check_table(key: str, experiment: ExperimentConfig) -> None:
    """Refuse an experiment that makes no table of reflectance over two numbers or more."""
    axes = experiment.make_axes().values if experiment.instrument.kind == "table" else ()
    several = [row for row in axes if len(row) > 1 and not isinstance(row[0], str)]
    if len(several) < 2:
        raise invalid(key, experiment.name, "a table over two parameters or more")


def _check_fixed_values(definition: Study, available: Mapping[str, ExperimentConfig]) -> None:
    """Refuse values of axes that no table has or reaches, and texts that are left open."""
    if definition.kind != "bands":
        return
    tables = [available[n] for n in definition.inputs.values() if n in available]
    rows = {name: row for one in tables for name, row in zip(*one.make_axes(), strict=True)}
    for name, value in definition.fixed.items() if tables else ():
        if name not in rows:
            raise unknown_key(f"fixed.{name}", rows)
        check_within_axis(f"fixed.{name}", value, rows[name])
    for name, row in rows.items():
        if isinstance(row[0], str) and len(row) > 1 and name not in definition.fixed:
            raise invalid(f"fixed.{name}", "nothing", f"one of {', '.join(map(str, row))}")


def _check_input(place: str, experiment: ExperimentConfig, required: StudyInput) -> None:
    """Refuse an experiment that cannot play a role."""
    instrument, grid = experiment.instrument, experiment.grid

    def wrong(allowed: str) -> ValueError:
        return invalid(place, experiment.name, allowed)

    if instrument.kind != required.instrument or experiment.fit:
        raise wrong(f"an experiment with a {required.instrument}")
    if set(grid) != set(required.axes) or any(len(grid[key]) < 2 for key in required.axes):
        several = f"over {' and '.join(required.axes)}, two values or more each"
        raise wrong(f"an experiment {several if required.axes else 'without a grid'}")
    for key, labels in required.labels.items():
        for label in labels:
            if not _has_value(grid[key], label):
                raise wrong(f"an experiment with {key} = {label} on its grid")
    given = instrument.get_wavelengths()
    for wavelength in required.at_nm:
        if not np.isclose(given, wavelength).any():
            raise wrong(f"an experiment with wavelength {wavelength:g} nm")
    if required.band_nm and (given[0] > required.band_nm[0] or given[-1] < required.band_nm[-1]):
        low, high = required.band_nm
        raise wrong(f"an experiment over wavelengths from {low:g} to {high:g} nm")
    turned = instrument.polar_deg or instrument.estimator == "bins"
    if required.instrument == "goniophotometer" and turned:
        raise wrong("an experiment with the usual polar_deg")


def _check_pair(key: str, pair: SensitivityPair, available: Mapping[str, ExperimentConfig]) -> None:
    over = (pair.parameter, "depth_m")
    ends: dict[str, tuple[float | str, ...]] = {pair.parameter: (pair.low, pair.high)}
    band = (400.0, 2500.0)
    if pair.experiment in available:
        role = StudyInput(over, {**ends, **SENSITIVITY_DEPTHS_M}, band_nm=band)
        _check_input(f"{key}.experiment", available[pair.experiment], role)
    if pair.interpretation in available:
        role = StudyInput((*over, "interpretation"), SENSITIVITY_DEPTHS_M, band_nm=band)
        _check_input(f"{key}.interpretation", available[str(pair.interpretation)], role)


def _has_value(values: Mapping[str, Any], wanted: float | str) -> bool:
    """Tell whether a grid's values hold one, by its label or as a number."""
    if isinstance(wanted, str):
        return wanted in values
    numbers = [value for value in values.values() if isinstance(value, (int, float))]
    return f"{wanted:g}" in values or bool(np.isclose(numbers, wanted).any())


def check_unique_names(
    studies: Mapping[str, Study], available: Mapping[str, ExperimentConfig]
) -> None:
    """Refuse names of experiments and studies under which something else is made.

    Raises
    ------
    ConfigError
        With one line for the first of them.
    """
    taken: dict[str, str] = {}
    for study, about in studies.items():
        owner = f"the study {study}"
        for name in dict.fromkeys([study, *about.list_product_names(study).values()]):
            if taken.setdefault(name, owner) != owner:
                raise ConfigError(_describe_name_conflict(f"studies.{study}", name, taken[name]))
    made_by_studies = set(taken)
    for name, experiment in available.items():
        for end, section in (("parameters", experiment.fit), ("retrieved", experiment.retrieve)):
            table = f"{name}_{end}"
            if table in made_by_studies:
                raise ConfigError(
                    _describe_name_conflict(f"experiment {name}", table, taken[table])
                )
            if section:
                taken[table] = f"the table of the experiment {name}"
    for name in available:
        if name in taken:
            raise ConfigError(_describe_name_conflict(f"experiment {name}", name, taken[name]))


def _describe_name_conflict(key: str, name: str, owner: str) -> str:
    allowed = "one that nothing else has"
    return f"{key}: {invalid('name', name, allowed, f'{owner} has it')}"
