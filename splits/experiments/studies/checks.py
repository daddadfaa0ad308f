"""Checks of all studies together: their names, and the experiments that they need."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from splits.core.validation import invalid
from splits.core.yaml import ConfigError
from splits.experiments.config.experiment import RESERVED_NAMES
from splits.experiments.config.simulation import NAME_PATTERN, NAME_RULE
from splits.experiments.studies.study import Experiments, Study


def check_studies(
    studies: Mapping[str, Study],
    available: Experiments,
    folders: Mapping[str, Path],
) -> None:
    """Reject invalid studies, and names that are used twice.

    Parameters
    ----------
    studies, available : mapping
        Studies, and all experiments, by name.
    folders : mapping
        Folders of ``published`` and ``measured`` tables.

    Raises
    ------
    ConfigError
        With one line that names the study, the key, the value and the allowed values.
    """
    for name, study in studies.items():
        try:
            if not NAME_PATTERN.fullmatch(name) or name in RESERVED_NAMES:
                raise invalid("name", name, f"{NAME_RULE}, none of the workflow's rules")
            study.check(available, folders, studies)
        except ValueError as error:
            raise ConfigError(f"studies.{name}.{error}") from None
    _check_unique_names(studies, available)


def find_incomplete_studies(studies: Mapping[str, Study], available: Experiments) -> dict[str, str]:
    """Return a message for each study of which not all experiments, or no group, exist."""
    messages = {}
    groups = {one.group for one in available.values()}
    for name, study in studies.items():
        missing = study.describe_missing(available, studies)
        if study.group is not None and study.group not in groups:
            missing.append(f"no experiment is in its group {study.group}")
        if missing:
            messages[name] = f"study {name} is left out: {'; '.join(missing)}"
    return messages


def select_studies(
    studies: Mapping[str, Study],
    experiments: Experiments,
    groups: Iterable[str],
) -> dict[str, Study]:
    """Return the studies of these groups, or of no group, over these experiments only."""
    return {
        name: study
        for name, study in studies.items()
        if not study.describe_missing(experiments, studies)
        and (study.group is None or study.group in groups)
    }


def _check_unique_names(studies: Mapping[str, Study], available: Experiments) -> None:
    """Reject names of experiments and studies that other products have."""
    uses = [
        (f"studies.{study}", name, f"the study {study}")
        for study, definition in studies.items()
        for name in [study, *definition.list_product_names(study).values()]
    ]
    for name, experiment in available.items():
        sections = {"parameters": experiment.fit, "retrieved": experiment.retrieval}
        for suffix, section in sections.items():
            owner = f"the table of the experiment {name}" if section else ""
            uses.append((f"experiment {name}", f"{name}_{suffix}", owner))
    uses += [(f"experiment {name}", name, f"the experiment {name}") for name in available]
    owners: dict[str, str] = {}
    for key, name, owner in uses:
        if owners.get(name, owner) != owner:
            raise ConfigError(f"{key}: {invalid('name', name, 'unique', f'{owners[name]} has it')}")
        if owner:
            owners[name] = owner
