"""Model of the main configuration file: studies, selected experiments, accuracy and folders."""

from __future__ import annotations

import ast
import posixpath
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from importlib.util import find_spec, resolve_name
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from splits.analysis.measured import read_measured, read_published
from splits.core.inputs import Seed
from splits.core.provenance import hash_files
from splits.core.validation import (
    ConfigError,
    check_choice,
    check_relations,
    expand_path,
    invalid,
    join_names,
    suggest_name,
    unknown_key,
)
from splits.experiments.config.experiment import (
    OWN_GROUP,
    RESERVED_NAMES,
    ExperimentConfig,
    PaperPlace,
    ReproducesSection,
)
from splits.experiments.config.sections import (
    Accuracy,
    Caption,
    ConfigSection,
    Label,
    Title,
    check_path,
)
from splits.experiments.config.simulation import NAME_PATTERN, NAME_RULE
from splits.io.ro_crate import Author
from splits.plotting.grammar import FIGURE_SUFFIXES

# --------------------------------------------------------------------------------------------------
# Studies: tables and figures that a function makes from the datasets of several experiments.
#
# An entry of `studies` names a function, and what the function reads by the names of its
# parameters.  The function is read here, not imported: it may import what takes time to import, and
# users' code runs only in the job of its study.

OUTPUT_FOLDERS = {".csv": "tables", FIGURE_SUFFIXES[0]: "figures", ".nc": "data"}
"""Folder of an output by its suffix: a table, a figure (in all formats) or a dataset."""
RUN_PARAMETERS = ("seed", "max_stderr", "threads", "log", "experiments")
"""Parameters of functions that the workflow gives: settings of the run, all threads, a function
that writes a line of progress, and the selected experiments by name."""
TABLE_READERS = {"published": read_published, "measured": read_measured}
"""Readers of the tables of numbers in the folders of published and measured numbers."""


class StudyOutput(ConfigSection):
    """What the report shows with an output of a study."""

    title: Title = ""
    """title in the report and in the gallery; by default the name of the file"""
    caption: Caption = ""
    """caption in the report; plain text, an empty line begins a paragraph"""
    place: PaperPlace = ""
    """figure or table of the paper; by default `place` of `reproduces`"""
    comparison: bool = False
    """whether it is a table of statements of the paper, with a verdict on each"""


class Study(ConfigSection):
    """Tables and figures that a function makes from the datasets of several experiments."""

    function: str
    """function, `MODULE.NAME`, which a file of `workflow/` (`workflow.studies.mine.draw` in
    `workflow/studies/mine.py`) or any other importable module defines"""
    inputs: dict[str, str] = Field({})
    """experiments, or datasets of other studies, by the name of a parameter of the function"""
    published: dict[str, str] = Field({})
    """files of the folder of published numbers, by parameter"""
    measured: dict[str, str] = Field({})
    """files of the folder of measured numbers, by parameter"""
    options: dict[str, Any] = Field({})
    """values of other parameters"""
    outputs: dict[str, StudyOutput] = Field({})
    """what the function returns, in this order: tables `NAME.csv`, figures `NAME.png`, datasets
    `NAME.nc`; by default a table with the name of the study"""
    group: str | None = None
    """group of experiments with which the study is selected"""
    reproduces: ReproducesSection | None = None
    """paper with which the report lists the outputs"""

    def list_outputs(self, name: str) -> dict[str, StudyOutput]:
        """Return the outputs of the study of this name by file name."""
        return self.outputs or {f"{name}.csv": StudyOutput()}

    def list_product_paths(self, name: str) -> dict[str, list[str]]:
        """Return the files of each output, relative to the results folder."""
        paths = {}
        for file in map(PurePath, self.list_outputs(name)):
            folder = OUTPUT_FOLDERS[file.suffix]
            suffixes = FIGURE_SUFFIXES if folder == "figures" else (file.suffix,)
            paths[file.name] = [f"{folder}/{file.stem}{suffix}" for suffix in suffixes]
        return paths

    def list_file_paths(self, folders: Mapping[str, Path]) -> dict[str, str]:
        """Return the tables of numbers that the study reads, by parameter."""
        return {
            parameter: str(folders[kind] / file)
            for kind in TABLE_READERS
            for parameter, file in getattr(self, kind).items()
        }

    def list_experiments(self, studies: Mapping[str, Study]) -> list[str]:
        """Return the experiments that the study reads, also through datasets of other studies."""
        makers = {
            file.removesuffix(".nc"): study
            for study in studies.values()
            for file in study.outputs
            if file.endswith(".nc")
        }
        names = dict.fromkeys(self.inputs.values())
        for name in names.copy():
            if name in makers and makers[name] is not self:
                del names[name]
                others = {key: study for key, study in studies.items() if study is not self}
                names |= dict.fromkeys(makers[name].list_experiments(others))
        return list(names)

    def list_run_parameters(self) -> list[str]:
        """Return the parameters of the function that the workflow gives."""
        parameters = read_parameters(self.function)
        return [name for name in RUN_PARAMETERS if name in parameters]

    def check(self, name: str, folders: Mapping[str, Path]) -> None:
        """Reject an unknown function, wrong names of its parameters, and missing tables."""
        parameters = read_parameters(self.function)
        given: dict[str, str] = {}
        for key in ("inputs", *TABLE_READERS, "options"):
            for parameter in getattr(self, key):
                if parameter in RUN_PARAMETERS or parameter in given:
                    hint = f"{given.get(parameter, 'the workflow')} has it"
                    raise invalid(f"{key} (key)", parameter, "another name", hint)
                takes_any = key == "inputs" and "**" in parameters
                if parameter not in parameters and not takes_any:
                    known = [name for name in parameters if name != "**"]
                    raise unknown_key(f"{key}.{parameter}", known)
                given[parameter] = key
        present = {*given, *RUN_PARAMETERS}
        if missing := [one for one, needed in parameters.items() if needed and one not in present]:
            allowed = f"with {join_names(missing)}, which the function needs"
            raise invalid("inputs", self.inputs, allowed, "or in published, measured, options")
        for kind, read in TABLE_READERS.items():
            for parameter, file in getattr(self, kind).items():
                check_path(f"{kind}.{parameter}", file)
                if not (folders[kind] / file).is_file():
                    known = [path.name for path in folders[kind].glob("*.csv")]
                    check_choice(f"{kind}.{parameter}", file, known)
                read(folders[kind] / file, f"{kind}.{parameter}")
        for file, output in self.list_outputs(name).items():
            path = PurePath(file)
            check_relations(
                (
                    path.suffix in OUTPUT_FOLDERS and NAME_PATTERN.fullmatch(path.stem),
                    "outputs (key)", file,
                    f"NAME{', NAME'.join(OUTPUT_FOLDERS)}, and NAME of {NAME_RULE}",
                ),
                (
                    not output.comparison or (path.suffix == ".csv" and self.reproduces),
                    f"outputs.{file}.comparison", True,
                    "left out, except for a table of a study with the key reproduces",
                ),
            )  # fmt: skip


def read_parameters(function: str) -> dict[str, bool]:
    """Return the parameters of a function, and whether each must be given, without importing it.

    The key ``**`` stands for any other inputs.
    """
    module, _, name = function.rpartition(".")
    key, rule = "function", "MODULE.NAME, a function that the module defines"
    path = _find_file(module) if module else None
    if path is None:
        raise invalid(key, function, rule, f"there is no module {module}" if module else "")
    try:
        tree = ast.parse(path.read_bytes())
    except SyntaxError as error:
        raise invalid(key, function, rule, f"{path}, line {error.lineno}: {error.msg}") from None
    functions = {node.name: node.args for node in tree.body if isinstance(node, ast.FunctionDef)}
    if name not in functions:
        hint = suggest_name(name, functions) or f"{path} defines {join_names(functions) or 'none'}"
        raise invalid(key, function, rule, hint)
    arguments = functions[name]
    needed = [True] * len(arguments.args)
    needed[len(needed) - len(arguments.defaults) :] = [False] * len(arguments.defaults)
    needed += [default is None for default in arguments.kw_defaults]
    names = [one.arg for one in (*arguments.args, *arguments.kwonlyargs)]
    return dict(zip(names, needed, strict=True)) | ({"**": False} if arguments.kwarg else {})


def hash_function(function: str) -> list[str]:
    """Return the digests of the module of a function and of those of its package it imports."""
    module = function.rpartition(".")[0]
    package, paths, names = module.partition(".")[0], [], [module]
    for name in names:
        path = _find_file(name)
        if path is None or path in paths:
            continue
        paths.append(path)
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Import):
                imported = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                relative = "." * node.level + (node.module or "")
                parent = resolve_name(relative, name.rpartition(".")[0])
                imported = [parent, *(f"{parent}.{alias.name}" for alias in node.names)]
            else:
                continue
            names += [one for one in imported if one.partition(".")[0] == package]
    return [hash_files(path.parent, [path.name]) for path in paths]


def _find_file(module: str) -> Path | None:
    """Return the source file of a module that can be imported, if there is one."""
    package, *names = module.split(".")
    spec = None
    with suppress(ImportError, ValueError):
        # With a dotted name, `find_spec` would import the packages above the module.
        spec = find_spec(package)
    folders = (spec.submodule_search_locations or ()) if spec else ()
    files = [Path(folder, *names, "__init__.py") for folder in folders]
    if names:
        files += [Path(folder, *names[:-1], f"{names[-1]}.py") for folder in folders]
    elif spec and str(spec.origin).endswith(".py"):
        files = [Path(str(spec.origin))]
    return next((file for file in files if file.is_file()), None)


def check_studies(
    studies: Mapping[str, Study],
    available: Mapping[str, ExperimentConfig],
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
    uses = []
    for name, study in studies.items():
        try:
            if not NAME_PATTERN.fullmatch(name) or name in RESERVED_NAMES:
                raise invalid("name", name, f"{NAME_RULE}, none of the workflow's rules")
            study.check(name, folders)
        except ValueError as error:
            raise ConfigError(f"studies.{name}.{error}") from None
        stems = [PurePath(file).stem for file in study.list_outputs(name)]
        uses += [(f"studies.{name}", one, f"the study {name}") for one in [name, *stems]]
    for name, experiment in available.items():
        owner = f"the table of the experiment {name}" if experiment.retrieval else ""
        uses.append((f"experiment {name}", f"{name}_retrieved", owner))
    uses += [(f"experiment {name}", name, f"the experiment {name}") for name in available]
    owners: dict[str, str] = {}
    for key, name, owner in uses:
        if owners.get(name, owner) != owner:
            raise ConfigError(f"{key}: {invalid('name', name, 'unique', f'{owners[name]} has it')}")
        if owner:
            owners[name] = owner


def find_incomplete_studies(
    studies: Mapping[str, Study], available: Mapping[str, ExperimentConfig]
) -> dict[str, str]:
    """Return a message for each study of which not all experiments, or no group, exist."""
    messages = {}
    groups = {one.group for one in available.values()}
    for name, study in studies.items():
        missing = describe_missing(study.list_experiments(studies), available)
        if study.group is not None and study.group not in groups:
            missing.append(f"no experiment is in its group {study.group}")
        if missing:
            messages[name] = f"study {name} is left out: {'; '.join(missing)}"
    return messages


def select_studies(
    studies: Mapping[str, Study],
    experiments: Mapping[str, ExperimentConfig],
    groups: Iterable[str],
) -> dict[str, Study]:
    """Return the studies of these groups, or of no group, over these experiments only."""
    return {
        name: study
        for name, study in studies.items()
        if not describe_missing(study.list_experiments(studies), experiments)
        and (study.group is None or study.group in groups)
    }


def describe_missing(
    required: Iterable[str], available: Mapping[str, ExperimentConfig]
) -> list[str]:
    """Return messages about required experiments that do not exist."""
    hints = {name: suggest_name(name, available) for name in required if name not in available}
    return [
        f"no such experiment: {name}" + (f" ({hint})" if hint else "")
        for name, hint in hints.items()
    ]


# --------------------------------------------------------------------------------------------------
# Settings of a run.

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
    seed: Seed = 1
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
            if "reflectance" not in available[name].instrument.list_quantities():
                raise ConfigError(f"{key}: must be a table of reflectance")
            if available[name].instrument.get_views():
                raise ConfigError(f"{key}: must be a table without directions")
            for axis, row in available[name].make_axes().items():
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
        unused = [
            name
            for name in messages
            if not any(
                one in available or suggest_name(one, available)
                for one in self.studies[name].list_experiments(self.studies)
            )
        ]
        names = [*self.explorer.values(), *self.explorer_directions.values()]
        common = f"none of their experiments exists: studies {join_names(unused)}"
        return [
            *(message for name, message in messages.items() if name not in unused),
            *(f"explorer: {message}" for message in describe_missing(names, available)),
            *([common] if unused else []),
        ]

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
