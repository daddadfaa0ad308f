"""Files of studies: tables of numbers that they read, products, and paths in a run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from splits.analysis.measured import read_measured, read_published, read_spectra
from splits.experiments.config.sections import FIGURE_SUFFIXES
from splits.io.data_frame import write_data_frame

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


class StudyFile(NamedTuple):
    """Table of numbers that a study reads.

    Attributes
    ----------
    folder : {"measured", "published"}
    read : callable
        From the path, and the key for messages, to the table.
    required : tuple of str
        Columns, or ids of published numbers, that it must have.
    """

    folder: str
    read: Callable[..., pd.DataFrame]
    required: tuple[str, ...] = ()


PUBLISHED_TABLE = StudyFile("published", read_published)
MEASURED_SPECTRA = StudyFile("measured", read_spectra)
MEASURED_VALUES = StudyFile("measured", read_measured)


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


class StudyRun(NamedTuple):
    """What a study reads and writes in a run of the workflow.

    Attributes
    ----------
    datasets : dict of str to str
        Paths of the datasets of experiments and of other studies, by their names.
    files : dict of str to str
        Paths of the tables of numbers, by key.
    readers : dict of str to callable
        Their readers, by key.
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
    readers: dict[str, Callable[..., pd.DataFrame]]
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
        return self.readers[key](Path(self.files[key]))

    def write_table(self, key: str, table: Any) -> None:
        """Write a table of the study."""
        write_data_frame(table, self.outputs[key][0])

    def save_figure(self, key: str, figure: Any) -> None:
        """Save a figure of the study in all formats."""
        from splits.plotting import save_figure

        save_figure(figure, Path(self.outputs[key][0]).with_suffix(""))
