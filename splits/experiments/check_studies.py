"""What studies must be: every name that they use, and every name that they take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from splits.analysis.agreement import read_published
from splits.analysis.measured import read_measured, read_spectra
from splits.analysis.roles import SENSITIVITY_DEPTHS, Role
from splits.checks import in_range, one_of, refuse, unknown_key
from splits.experiments.check_retrieve import check_within
from splits.experiments.model import RULES, Experiment
from splits.experiments.rank_readings import BOUNDARIES, FATES
from splits.experiments.simulation import NAME, NAMES
from splits.experiments.studies import SensitivityPair, Study
from splits.experiments.study_kinds import FILES, OF_TABLES, PRODUCTS, ROLES, SOME
from splits.experiments.texts import check_path
from splits.experiments.yaml_files import ConfigError
from splits.instruments.arguments import check_whole
from splits.media.readings import CHOICES, Readings
from splits.skies.bands import SENSORS

READERS = {"published": read_published, "directions": read_measured}
"""What reads tables of studies that do not hold spectra."""


def check_studies(
    studies: Mapping[str, Study], available: Mapping[str, Experiment], tables: Mapping[str, Path]
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
            _check_names(study, about, studies)
            _check_files(about, tables)
            _check_at(about, available)
            for role, name in about.experiments.items():
                if name in available and about.kind in OF_TABLES:
                    _check_table(f"experiments.{role}", available[name])
                elif name in available:
                    _check_role(f"experiments.{role}", available[name], ROLES[about.kind][role])
            for pair, given in about.pairs.items():
                _check_pair(f"pairs.{pair}", given, available)
        except ValueError as error:
            raise ConfigError(f"studies.{study}.{error}") from None
    check_free(studies, available)


def _check_keys(study: Study) -> None:
    """Refuse keys that a kind of study does not know, or the lack of those that it needs."""
    roles = ROLES.get(study.kind, {})
    if study.kind in OF_TABLES:
        if not study.experiments:
            raise refuse("experiments", study.experiments, "at least one experiment by name")
        if len({role.replace("_", " ") for role in study.experiments}) < len(study.experiments):
            hint = "underscores are shown as spaces"
            raise refuse("experiments", list(study.experiments), "names that differ", hint)
        roles = dict.fromkeys(study.experiments, Role(()))
    for key, known in (
        ("experiments", roles), ("files", FILES.get(study.kind, {})),
        ("products", PRODUCTS[study.kind]),
    ):  # fmt: skip
        for name in getattr(study, key):
            if not known:
                raise refuse(key, getattr(study, key), f"left out for kind = {study.kind!r}")
            if name not in known:
                raise unknown_key(f"{key}.{name}", known)
    missing = [role for role in roles if role not in study.experiments]
    if missing and (study.kind not in SOME or not study.experiments):
        needed = "one of" if study.kind in SOME else "the roles"
        raise refuse("experiments", study.experiments, f"with {needed} {', '.join(missing)}")
    if (study.kind == "sensitivity") != bool(study.pairs):
        allowed = "at least one pair" if study.kind == "sensitivity" else "left out"
        raise refuse("pairs", study.pairs, f"{allowed} for kind = {study.kind!r}")
    if (study.kind in ("agreement", "readings")) != (study.sensitivity is not None):
        allowed = "the name of a study" if study.sensitivity is None else "left out"
        raise refuse("sensitivity", study.sensitivity, f"{allowed} for kind = {study.kind!r}")
    _check_readings(study)
    _check_bands(study)
    wanted = FILES.get(study.kind, {}) if study.kind != "sensitivity" else {}
    for key in wanted:
        if key not in study.files:
            raise refuse("files", study.files, f"with {', '.join(wanted)}")
    for key, name in study.products.items():
        if not NAME.fullmatch(name):
            raise refuse(f"products.{key}", name, NAMES)


def _check_readings(study: Study) -> None:
    """Refuse readings that there are not, and their lack or presence where it is wrong."""
    if (study.kind == "readings") != bool(study.readings):
        allowed = "choices by reading" if study.kind == "readings" else "left out"
        raise refuse("readings", study.readings, f"{allowed} for kind = {study.kind!r}")
    known = {f.name: CHOICES[f.name] for f in fields(Readings)} | {BOUNDARIES: tuple(FATES)}
    for key, choices in study.readings.items():
        if key not in known:
            raise unknown_key(f"readings.{key}", known)
        for choice in choices:
            one_of(f"readings.{key}", choice, known[key])
    for key, choice in study.text.items():
        if key not in study.readings:
            raise unknown_key(f"text.{key}", study.readings)
        one_of(f"text.{key}", choice, study.readings[key])


def _check_bands(study: Study) -> None:
    """Refuse a choice of bands that cannot be, and its keys for another kind of study."""
    if study.kind != "bands":
        # Archives say all keys, as they are by default.
        for key in ("bands", "noise", "most", "at"):
            usual = Study.model_fields[key].get_default(call_default_factory=True)
            if getattr(study, key) != usual:
                raise refuse(key, getattr(study, key), "left out but for kind = 'bands'")
        return
    if study.bands is not None:
        one_of("bands", study.bands, SENSORS)
    in_range("noise", study.noise, 0.0, 1.0, open_low=True)
    check_whole("most", study.most, 1)


def _check_names(study: str, definition: Study, studies: Mapping[str, Study]) -> None:
    if not NAME.fullmatch(study) or study in RULES:
        raise refuse("name", study, f"{NAMES}, no rule's name")
    if definition.sensitivity is not None:
        kinds = {name: one.kind for name, one in studies.items()}
        known = [name for name, kind in kinds.items() if kind == "sensitivity"]
        one_of("sensitivity", definition.sensitivity, known)


def _check_files(definition: Study, tables: Mapping[str, Path]) -> None:
    for key, file in definition.files.items():
        check_path(f"files.{key}", file)
        place = tables[FILES[definition.kind][key]]
        if not (place / file).is_file():
            one_of(f"files.{key}", file, [path.name for path in place.glob("*.csv")])
        READERS.get(key, read_spectra)(place / file, f"files.{key}")


def _check_table(key: str, experiment: Experiment) -> None:
    """Refuse an experiment that makes no table of reflectance over two numbers or more."""
    axes = experiment.make_axes().values if experiment.instrument.kind == "table" else ()
    several = [row for row in axes if len(row) > 1 and not isinstance(row[0], str)]
    if len(several) < 2:
        raise refuse(key, experiment.name, "a table over two parameters or more")


def _check_at(definition: Study, available: Mapping[str, Experiment]) -> None:
    """Refuse values of axes that no table has or reaches, and texts that are left open."""
    if definition.kind != "bands":
        return
    tables = [available[n] for n in definition.experiments.values() if n in available]
    rows = {name: row for one in tables for name, row in zip(*one.make_axes(), strict=True)}
    for name, value in definition.at.items() if tables else ():
        if name not in rows:
            raise unknown_key(f"at.{name}", rows)
        check_within(f"at.{name}", value, rows[name])
    for name, row in rows.items():
        if isinstance(row[0], str) and len(row) > 1 and name not in definition.at:
            raise refuse(f"at.{name}", "nothing", f"one of {', '.join(map(str, row))}")


def _check_role(place: str, experiment: Experiment, required: Role) -> None:
    """Refuse an experiment that cannot play a role."""
    instrument, grid = experiment.instrument, experiment.grid

    def wrong(allowed: str) -> ValueError:
        return refuse(place, experiment.name, allowed)

    if instrument.kind != required.instrument or experiment.fit:
        raise wrong(f"an experiment with a {required.instrument}")
    if set(grid) != set(required.axes) or any(len(grid[key]) < 2 for key in required.axes):
        several = f"over {' and '.join(required.axes)}, two values or more each"
        raise wrong(f"an experiment {several if required.axes else 'without a grid'}")
    for key, labels in required.labels.items():
        for label in labels:
            if not _has(grid[key], label):
                raise wrong(f"an experiment with {key} = {label} on its grid")
    given = instrument.get_wavelengths()
    for wavelength in required.at_nm:
        if not np.isclose(given, wavelength).any():
            raise wrong(f"an experiment with wavelength {wavelength:g} nm")
    if required.band_nm and (given[0] > required.band_nm[0] or given[-1] < required.band_nm[-1]):
        low, high = required.band_nm
        raise wrong(f"an experiment over wavelengths from {low:g} to {high:g} nm")
    turned = instrument.polar_deg or instrument.estimator == "cells"
    if required.instrument == "goniophotometer" and turned:
        raise wrong("an experiment with the usual polar_deg")


def _check_pair(key: str, pair: SensitivityPair, available: Mapping[str, Experiment]) -> None:
    over = (pair.parameter, "depth_m")
    ends: dict[str, tuple[float | str, ...]] = {pair.parameter: (pair.low, pair.high)}
    band = (400.0, 2500.0)
    if pair.experiment in available:
        role = Role(over, {**ends, **SENSITIVITY_DEPTHS}, band_nm=band)
        _check_role(f"{key}.experiment", available[pair.experiment], role)
    if pair.readings in available:
        role = Role((*over, "readings"), SENSITIVITY_DEPTHS, band_nm=band)
        _check_role(f"{key}.readings", available[str(pair.readings)], role)


def _has(values: Mapping[str, Any], wanted: float | str) -> bool:
    """Tell whether a grid's values hold one, by its label or as a number."""
    if isinstance(wanted, str):
        return wanted in values
    numbers = [value for value in values.values() if isinstance(value, (int, float))]
    return f"{wanted:g}" in values or bool(np.isclose(numbers, wanted).any())


def check_free(studies: Mapping[str, Study], available: Mapping[str, Experiment]) -> None:
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
                raise ConfigError(_twice(f"studies.{study}", name, taken[name]))
    made_by_studies = set(taken)
    for name, experiment in available.items():
        for end, section in (("parameters", experiment.fit), ("retrieved", experiment.retrieve)):
            table = f"{name}_{end}"
            if table in made_by_studies:
                raise ConfigError(_twice(f"experiment {name}", table, taken[table]))
            if section:
                taken[table] = f"the table of the experiment {name}"
    for name in available:
        if name in taken:
            raise ConfigError(_twice(f"experiment {name}", name, taken[name]))


def _twice(key: str, name: str, owner: str) -> str:
    allowed = "one that nothing else has"
    return f"{key}: {refuse('name', name, allowed, f'{owner} has it')}"
