"""Base class of studies: tables and figures made from several experiments."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, get_args

from pydantic import Field

from splits.core.provenance import FIGURE_SOURCES, PACKAGE_FOLDER, STUDY_SOURCES
from splits.core.validation import check_choice, invalid, join_names, suggest_name, unknown_key
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.reproduces import ReproducesSection
from splits.experiments.config.sections import Caption, ConfigSection, Title, check_path
from splits.experiments.config.simulation import NAME_PATTERN, NAME_RULE
from splits.experiments.studies.study_files import StudyFile, StudyProduct, StudyRun
from splits.experiments.studies.study_input import StudyInput, check_input

if TYPE_CHECKING:
    import xarray as xr


INPUTS_DESCRIPTION = "experiment of each study input"
FILES_DESCRIPTION = "names of tables in the folders of published and measured numbers"
Inputs = Annotated[dict[str, str], Field(description=INPUTS_DESCRIPTION)]
Files = Annotated[dict[str, str], Field(description=FILES_DESCRIPTION)]
Experiments = Mapping[str, ExperimentConfig]
"""Experiments by name."""


class Study(ConfigSection):
    """An analysis of several experiments; each kind of study is a subclass.

    Attributes
    ----------
    PRODUCTS : dict of str to StudyProduct
        Files it makes; `outputs` gives other names.
    INPUTS : dict of str to StudyInput
        Requirements on its experiments, by study input.
    FILES : dict of str to StudyFile
        Tables of numbers that it reads.
    MESSAGE : str
        What it does, for the terminal.
    SOME_INPUTS_SUFFICE, OPTIONAL_FILES : bool
        Whether some of the study inputs suffice, and whether the tables may be left out.
    USES_ALL_THREADS : bool
        Whether `make` simulates, and therefore has all cores.
    """

    PRODUCTS: ClassVar[Mapping[str, StudyProduct]]
    INPUTS: ClassVar[Mapping[str, StudyInput]] = {}
    FILES: ClassVar[Mapping[str, StudyFile]] = {}
    MESSAGE: ClassVar[str]
    SOME_INPUTS_SUFFICE: ClassVar[bool] = False
    OPTIONAL_FILES: ClassVar[bool] = False
    USES_ALL_THREADS: ClassVar[bool] = False
    TEXT_KEYS: ClassVar = {"reproduces", "group", "titles", "captions"}
    """Keys on which the products do not depend."""

    kind: str = Field(description="kind of the study")
    group: str | None = Field(
        None, description="group of experiments with which the study is selected"
    )
    reproduces: ReproducesSection | None = Field(
        None, description="paper with which the report lists the products of the study"
    )
    outputs: dict[str, str] = Field({}, description="other names for products of the study")
    titles: dict[str, Title] = Field({}, description="other titles of products in the report")
    captions: dict[str, Caption] = Field({}, description="other captions of products")

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Reject the definition of a kind without what all studies need."""
        super().__pydantic_init_subclass__(**kwargs)
        if not (kinds := get_args(cls.model_fields["kind"].annotation)):
            return
        overridden = (cls.list_experiments, cls.list_parameters) != (
            Study.list_experiments, Study.list_parameters
        )  # fmt: skip
        for is_given, needed in (
            (hasattr(cls, "PRODUCTS"), "a class with PRODUCTS"),
            (hasattr(cls, "MESSAGE"), "a class with MESSAGE"),
            (("files" in cls.model_fields) == bool(cls.FILES), "with both a field files and FILES"),
            (
                "inputs" in cls.model_fields or overridden,
                "with a field inputs, or with list_experiments or list_parameters",
            ),
        ):
            if not is_given:
                raise invalid(f"{cls.__name__}.kind", kinds[0], needed)

    def make(self, run: StudyRun) -> None:
        """Make all products."""
        raise NotImplementedError

    def load_inputs(self, run: StudyRun, descending: str = "") -> dict[str, xr.Dataset]:
        """Return the results by study input, with increasing values except of one parameter."""
        return {
            key: sort_values(run.load(name), self.INPUTS[key].axes, descending)
            for key, name in getattr(self, "inputs", {}).items()
        }

    @classmethod
    def list_sources(cls) -> list[str]:
        """Return the files and folders of the package that determine the products of the kind."""
        source = Path(inspect.getfile(cls)).relative_to(PACKAGE_FOLDER).as_posix()
        has_figure = any(product.folder == "figures" for product in cls.PRODUCTS.values())
        return [source, *STUDY_SOURCES, *(FIGURE_SOURCES if has_figure else ())]

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

    def get_product(self, key: str) -> StudyProduct:
        """Return a product with the title and the caption of this study."""
        product, reproduces = self.PRODUCTS[key], self.reproduces
        return product._replace(
            title=self.titles.get(key, product.title),
            caption=self.captions.get(key, product.caption),
            place=(product.place or reproduces.place) if reproduces else "",
            is_comparison=product.is_comparison and reproduces is not None,
        )

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

    def list_file_paths(self, folders: Mapping[str, Path]) -> dict[str, str]:
        """Return the tables of numbers that the study reads, by key."""
        files: Mapping[str, str] = getattr(self, "files", {})
        return {key: str(folders[self.FILES[key].folder] / file) for key, file in files.items()}

    def list_required_values(self, key: str) -> tuple[str, ...]:
        """Return the columns, or the ids of published numbers, that a table must have."""
        return self.FILES[key].required

    def describe_missing(self, available: Experiments, studies: Mapping[str, Study]) -> list[str]:
        """Return messages about experiments that the study needs and that do not exist."""
        required = self.list_experiments()
        for name in self.list_studies():
            required += studies[name].list_experiments()
        return describe_missing(required, available)

    def check(
        self, available: Experiments, folders: Mapping[str, Path], studies: Mapping[str, Study]
    ) -> None:
        """Reject unknown or missing names, and unsuitable experiments and tables.

        Parameters
        ----------
        available : mapping
            All experiments.
        folders : mapping
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
            ("titles", self.PRODUCTS), ("captions", self.PRODUCTS),
        ):  # fmt: skip
            for name in getattr(self, key, {}) if allowed else ():
                if name not in allowed:
                    raise unknown_key(f"{key}.{name}", allowed)
        self._check_files(folders)
        for key, name in self.outputs.items():
            if not NAME_PATTERN.fullmatch(name):
                raise invalid(f"outputs.{key}", name, NAME_RULE)
        self.check_inputs(available)
        self.check_keys(available, studies)

    def check_keys(self, available: Experiments, studies: Mapping[str, Study]) -> None:
        """Reject values of keys of this kind of study, given all experiments and studies."""

    def check_inputs(self, available: Experiments) -> None:
        """Reject missing study inputs, and experiments that do not meet their requirements."""
        inputs: Mapping[str, str] = getattr(self, "inputs", {})
        missing = [key for key in self.INPUTS if key not in inputs]
        if missing and not (self.SOME_INPUTS_SUFFICE and inputs):
            which = "one of " if self.SOME_INPUTS_SUFFICE else ""
            raise invalid("inputs", inputs, f"with {which}{', '.join(missing)}")
        for key, name in inputs.items():
            if name in available and key in self.INPUTS:
                check_input(f"inputs.{key}", available[name], self.INPUTS[key])

    def _check_files(self, folders: Mapping[str, Path]) -> None:
        """Reject missing and malformed tables of numbers."""
        files: Mapping[str, str] = getattr(self, "files", {})
        if not self.OPTIONAL_FILES and set(self.FILES) - set(files):
            raise invalid("files", files, f"with {', '.join(self.FILES)}")
        for key, file in files.items():
            check_path(f"files.{key}", file)
            folder = folders[self.FILES[key].folder]
            if not (folder / file).is_file():
                check_choice(f"files.{key}", file, [path.name for path in folder.glob("*.csv")])
            table = self.FILES[key].read(folder / file, f"files.{key}")
            present, required = {*table.columns, *table.index}, self.list_required_values(key)
            if missing := [name for name in required if name not in present]:
                raise invalid(f"files.{key}", file, f"a table with {join_names(missing)}")


def sort_values(dataset: xr.Dataset, parameters: Iterable[str], descending: str = "") -> xr.Dataset:
    """Return a dataset with increasing numbers, or means of ranges, of parameters except of one."""
    for name in parameters:
        order = f"{name}_mean" if f"{name}_mean" in dataset.coords else name
        if dataset[order].dtype.kind == "f":
            dataset = dataset.sortby(order, ascending=name != descending)
    return dataset


def describe_missing(required: Iterable[str], available: Experiments) -> list[str]:
    """Return messages about required experiments that do not exist."""
    messages = []
    for name in dict.fromkeys(required):
        if name not in available:
            hint = suggest_name(name, available)
            messages.append(f"no such experiment: {name}" + (f" ({hint})" if hint else ""))
    return messages
