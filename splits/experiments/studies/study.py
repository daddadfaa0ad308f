"""Base class of studies: tables and figures made from several experiments."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

from pydantic import Field

from splits.analysis.measured import read_measured, read_published, read_spectra
from splits.core.provenance import PACKAGE_FOLDER
from splits.core.validation import check_choice, invalid, suggest_name, unknown_key
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.reproduces import PaperKey
from splits.experiments.config.sections import FIGURE_SUFFIXES, ConfigSection, check_path
from splits.experiments.config.simulation import NAME_PATTERN, NAME_RULE
from splits.experiments.studies.study_input import StudyInput, check_input

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


TABLE_READERS = {"published": read_published, "directions": read_measured}
"""Functions that read tables of studies other than spectra."""


class StudyProduct(NamedTuple):
    """Files that a study makes.

    Attributes
    ----------
    name : str
        Default name, in which ``{study}`` is that of the study.
    title, caption : str
        Plain text in the report and in the gallery; without a title, it is not shown.
    folder : str
    suffixes : tuple of str
    place : str
        Figure, table or section of the paper that the study reproduces, such as "Fig 23".
    is_comparison : bool
        Whether it is a table of statements with a verdict on each.
    """

    name: str
    title: str = ""
    caption: str = ""
    folder: str = "tables"
    suffixes: tuple[str, ...] = (".csv",)
    place: str = ""
    is_comparison: bool = False

    @classmethod
    def make_figure(cls, name: str, title: str, caption: str, place: str = "") -> StudyProduct:
        """Return a figure, in all formats."""
        return cls(name, title, caption, "figures", FIGURE_SUFFIXES, place)


ROLES_DESCRIPTION = "experiments by role"
FILES_DESCRIPTION = "names of tables in the folders of published and measured numbers"
Roles = Annotated[dict[str, str], Field(description=ROLES_DESCRIPTION)]
Files = Annotated[dict[str, str], Field(description=FILES_DESCRIPTION)]
Experiments = Mapping[str, ExperimentConfig]
"""Experiments by name."""


class StudyRun(NamedTuple):
    """What a study reads and writes in a run of the workflow.

    Attributes
    ----------
    datasets : dict of str to str
        Paths of the datasets of experiments and of other studies, by their names.
    files : dict of str to str
        Paths of the tables of numbers, by key.
    outputs : dict of str to list of str
        Paths of the products, by key.
    parameters : dict of str to object
        See `Study.list_parameters`.
    threads : int
    log : callable
        Writes a line to the terminal and to the log file.
    """

    datasets: dict[str, str]
    files: dict[str, str]
    outputs: dict[str, list[str]]
    parameters: dict[str, Any]
    threads: int
    log: Callable[[str], None]

    def load(self, experiment: str) -> xr.Dataset:
        """Return the results of an experiment."""
        from splits import load

        return load(self.datasets[experiment])

    def read(self, key: str) -> pd.DataFrame:
        """Return a table of numbers."""
        return TABLE_READERS.get(key, read_spectra)(Path(self.files[key]))

    def write_table(self, key: str, table: Any) -> None:
        """Write a table of the study."""
        from splits.experiments.papers.paper_tables import write_data_frame

        write_data_frame(table, self.outputs[key][0])

    def save_figure(self, key: str, figure: Any) -> None:
        """Save a figure of the study in all formats."""
        from splits.plotting import save_figure

        save_figure(figure, Path(self.outputs[key][0]).with_suffix(""))


class Study(ConfigSection):
    """An analysis of several experiments; each kind of study is a subclass.

    Attributes
    ----------
    PRODUCTS : dict of str to StudyProduct
        Files it makes; `outputs` gives other names.
    INPUTS : dict of str to StudyInput
        Requirements on its experiments, by role.
    FILES : dict of str to str
        Tables of numbers that it reads, and their folders: "published" or "measured".
    MESSAGE : str
        What it does, for the terminal.
    SOME_INPUTS_SUFFICE, OPTIONAL_FILES : bool
        Whether some of the roles suffice, and whether the tables may be left out.
    USES_ALL_THREADS : bool
        Whether `make` simulates, and therefore has all cores.
    """

    PRODUCTS: ClassVar[Mapping[str, StudyProduct]]
    INPUTS: ClassVar[Mapping[str, StudyInput]] = {}
    FILES: ClassVar[Mapping[str, str]] = {}
    MESSAGE: ClassVar[str]
    SOME_INPUTS_SUFFICE: ClassVar[bool] = False
    OPTIONAL_FILES: ClassVar[bool] = False
    USES_ALL_THREADS: ClassVar[bool] = False

    kind: str = Field(description="kind of the study")
    group: str | None = Field(
        None, description="group of experiments with which the study is selected"
    )
    reproduces: PaperKey | None = Field(
        None, description="paper with which the report lists the products of the study"
    )
    outputs: dict[str, str] = Field({}, description="other names for products of the study")

    def make(self, run: StudyRun) -> None:
        """Make all products."""
        raise NotImplementedError

    @classmethod
    def get_source(cls) -> str:
        """Return the source file of the kind, relative to the package."""
        return Path(inspect.getfile(cls)).relative_to(PACKAGE_FOLDER).as_posix()

    def list_experiments(self) -> list[str]:
        """Return the names of the experiments of the study, without repetition."""
        return list(dict.fromkeys(getattr(self, "inputs", {}).values()))

    def list_studies(self) -> list[str]:
        """Return the names of other studies that it reads."""
        return []

    def list_parameters(
        self, seed: int, max_stderr: float, experiments: Experiments
    ) -> dict[str, Any]:
        """Return what the products depend on besides inputs, files and keys of the study."""
        return {}

    def list_product_names(self, study: str) -> dict[str, str]:
        """Return the names of all products, without folder and suffix, by key."""
        return {
            key: self.outputs.get(key, product.name.format(study=study))
            for key, product in self.PRODUCTS.items()
        }

    def list_product_paths(self, study: str) -> dict[str, list[str]]:
        """Return the files of all products by key, relative to the results folder."""
        return {
            key: [f"{self.PRODUCTS[key].folder}/{name}{s}" for s in self.PRODUCTS[key].suffixes]
            for key, name in self.list_product_names(study).items()
        }

    def list_file_paths(self, tables: Mapping[str, Path]) -> dict[str, str]:
        """Return the tables of numbers that the study reads, by key."""
        files: Mapping[str, str] = getattr(self, "files", {})
        return {key: str(tables[self.FILES[key]] / file) for key, file in files.items()}

    def describe_missing(self, available: Experiments, studies: Mapping[str, Study]) -> list[str]:
        """Return messages about experiments that the study needs and that do not exist."""
        required = self.list_experiments()
        for name in self.list_studies():
            required += studies[name].list_experiments()
        return describe_missing(required, available)

    def check(
        self, available: Experiments, tables: Mapping[str, Path], studies: Mapping[str, Study]
    ) -> None:
        """Reject unknown or missing names, and unsuitable experiments and tables.

        Parameters
        ----------
        available : mapping
            All experiments.
        tables : mapping
            Folders of ``published`` and ``measured`` tables.
        studies : mapping
            All studies.

        Raises
        ------
        ValueError
            With one line that names the key, the value and the allowed values.
        """
        for key, allowed in (
            ("inputs", self.INPUTS), ("files", self.FILES), ("outputs", self.PRODUCTS),
        ):  # fmt: skip
            for name in getattr(self, key, {}) if allowed else ():
                if name not in allowed:
                    raise unknown_key(f"{key}.{name}", allowed)
        self._check_files(tables)
        for key, name in self.outputs.items():
            if not NAME_PATTERN.fullmatch(name):
                raise invalid(f"outputs.{key}", name, NAME_RULE)
        self.check_inputs(available)
        self.check_keys(available, studies)

    def check_keys(self, available: Experiments, studies: Mapping[str, Study]) -> None:
        """Reject values of keys of this kind of study, given all experiments and studies."""

    def check_inputs(self, available: Experiments) -> None:
        """Reject missing roles, and experiments that do not meet the requirements of their role."""
        inputs: Mapping[str, str] = getattr(self, "inputs", {})
        missing = [role for role in self.INPUTS if role not in inputs]
        if missing and not (self.SOME_INPUTS_SUFFICE and inputs):
            which = "one of" if self.SOME_INPUTS_SUFFICE else "the roles"
            raise invalid("inputs", inputs, f"with {which} {', '.join(missing)}")
        for role, name in inputs.items():
            if name in available and role in self.INPUTS:
                check_input(f"inputs.{role}", available[name], self.INPUTS[role])

    def _check_files(self, tables: Mapping[str, Path]) -> None:
        """Reject missing and malformed tables of numbers."""
        files: Mapping[str, str] = getattr(self, "files", {})
        if not self.OPTIONAL_FILES and set(self.FILES) - set(files):
            raise invalid("files", files, f"with {', '.join(self.FILES)}")
        for key, file in files.items():
            check_path(f"files.{key}", file)
            folder = tables[self.FILES[key]]
            if not (folder / file).is_file():
                check_choice(f"files.{key}", file, [path.name for path in folder.glob("*.csv")])
            TABLE_READERS.get(key, read_spectra)(folder / file, f"files.{key}")


def describe_missing(required: Iterable[str], available: Experiments) -> list[str]:
    """Return messages about required experiments that do not exist."""
    messages = []
    for name in dict.fromkeys(required):
        if name not in available:
            hint = suggest_name(name, available)
            messages.append(f"no such experiment: {name}" + (f" ({hint})" if hint else ""))
    return messages
