"""Contents of the report: experiments and studies by paper and group, in the order of figures."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import PurePath
from typing import Any

from pydantic import BaseModel, ConfigDict

from splits.core.provenance import PACKAGE_FOLDER, hash_files
from splits.experiments.config.experiment import OWN_GROUP, ExperimentConfig
from splits.experiments.config.reproduces import PAPERS, parse_place
from splits.experiments.config.sections import FIGURE_SUFFIXES
from splits.experiments.config.settings import Settings
from splits.experiments.config.studies import Study

GROUP_TITLES = {
    OWN_GROUP: "Own experiments",
    "papers": "Other experiments on the papers",
    "interpretations": "Interpretations of the papers",
    "retrievals": "Retrievals from measured spectra",
    "wet_sand": "Wet sand",
    "polarization": "Polarization",
    "explorer": "Look-up tables",
    "examples": "Examples",
}
"""Titles of the groups of experiments that the package comes with, in the order of the report."""
REPORT_SOURCES = (
    "comparison.py", "contents.py", "page.py", "tables.py",
    "page.css", "page.html", "page.js",
)  # fmt: skip
"""Files of this folder that determine the page."""
FIT_CAPTION = (
    "Sands fitted to measured spectra, with the standard error of every parameter. There are two "
    "separate verdicts. The verdict on a parameter states whether the spectrum constrains it, "
    "which means that its error is below half of the error that follows from the range alone. The "
    "verdict on the spectrum states whether the fitted sand reproduces it with a root-mean-square "
    "misfit below 0.03 (a good reconstruction according to SPLITS). If a spectrum is reproduced, "
    "its parameters may still be undetermined, since other sands reproduce it as well. A "
    "constrained parameter may be at the end of its range; a mass fraction of clay of 0.0001 is "
    "negligible. The spectra that the paper fits (TEC) are not public as numbers, so the misfits "
    "of the paper cannot be reproduced."
)
RETRIEVAL_CAPTION = (
    "Parameters retrieved from spectra or returns with the table of the experiment, by optimal "
    "estimation. Errors include the stated noise of the measurement, the noise of the table, and "
    "the error of interpolation between its grid points. A parameter is constrained if the "
    "measurement at least halves the standard deviation of the range or the prior. The error "
    "inflation is the factor by which all errors were increased because the misfit exceeds the "
    "noise. The increased errors may still be too small, since errors of the model are correlated "
    "between neighbouring wavelengths or delays. The averaging kernel is the change of the result "
    "with the true value, in units of the prior standard deviation: 1 if the measurement "
    "determines the parameter completely, 0 if it contains no information."
)


class _ReportModel(BaseModel):
    """Part of the contents: immutable, and unknown keys are rejected."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ReportTable(_ReportModel):
    """A table with a note on its columns."""

    path: str
    note: str = ""


class ReportItem(_ReportModel):
    """An experiment, or a product of a study.

    Attributes
    ----------
    anchor : str
        Unique identifier on the page.
    name, title, caption : str
        Name of the experiment or study, and plain texts.
    place : str
        Place in the paper, such as "Fig 8".
    figure : str
        Path of the figure without suffix, or an empty text; all paths are relative to the folder of
        results.
    tables : tuple of ReportTable
    datasets : tuple of str
        Paths.
    is_comparison : bool
        Whether the table contains statements of papers with a verdict on each.
    """

    anchor: str
    name: str
    title: str
    caption: str = ""
    place: str = ""
    figure: str = ""
    tables: tuple[ReportTable, ...] = ()
    datasets: tuple[str, ...] = ()
    is_comparison: bool = False


class ReportSection(_ReportModel):
    """The experiments and studies of a paper (by its key) or of a group (by its name)."""

    key: str
    title: str
    reference: str = ""
    items: tuple[ReportItem, ...]


class ReportContents(_ReportModel):
    """What the report shows besides the files of the results.

    Attributes
    ----------
    accuracy, max_stderr, relative_stderr, seed
        Settings of the run.
    sections : tuple of ReportSection
    benchmarks : tuple of str
        Paths of the benchmarks that are shown.
    explorer : bool
        Whether the run writes the explorer.
    """

    accuracy: str
    max_stderr: float
    relative_stderr: float
    seed: int
    sections: tuple[ReportSection, ...]
    benchmarks: tuple[str, ...] = ()
    explorer: bool = False

    def compute_digest(self) -> str:
        """Return the digest of the contents and of the files that determine the page."""
        sources = hash_files(PACKAGE_FOLDER / "experiments" / "report", REPORT_SOURCES)
        return hashlib.sha256(f"{sources} {self.model_dump_json()}".encode()).hexdigest()[:16]


def make_report_contents(
    settings: Settings,
    experiments: Mapping[str, ExperimentConfig],
    studies: Iterable[str],
    benchmarks: Iterable[str] = (),
    explorer: bool = False,
) -> ReportContents:
    """Return the contents of the report on a run.

    Parameters
    ----------
    settings : Settings
    experiments : mapping
        The selected experiments.
    studies : iterable of str
        Names of the studies that run.
    benchmarks, explorer
        See `ReportContents`.
    """
    items: dict[str, list[ReportItem]] = {}
    for name, experiment in experiments.items():
        key = experiment.reproduces.paper if experiment.reproduces else experiment.group
        items.setdefault(key, []).append(_make_experiment_item(name, experiment))
    for name in studies:
        study = settings.studies[name]
        paper = study.reproduces.paper if study.reproduces else None
        key = paper or study.group or _get_group(study, experiments, settings.studies)
        items.setdefault(key, []).extend(_list_study_items(name, study))
    accuracy = settings.accuracies[settings.accuracy]
    return ReportContents(
        accuracy=settings.accuracy,
        max_stderr=accuracy.max_stderr,
        relative_stderr=accuracy.relative_stderr,
        seed=settings.seed,
        sections=tuple(
            _make_section(key, items[key])
            for key in dict.fromkeys([*PAPERS, *GROUP_TITLES, *items])
            if key in items
        ),
        benchmarks=tuple(benchmarks),
        explorer=explorer,
    )


def _get_group(
    study: Study, experiments: Mapping[str, ExperimentConfig], studies: Mapping[str, Study]
) -> str:
    """Return the group of a study without one: that of its first experiment."""
    names = study.list_experiments(studies)
    return experiments[names[0]].group if names else OWN_GROUP


def _make_section(key: str, items: list[ReportItem]) -> ReportSection:
    paper = next((paper for name, paper in PAPERS.items() if name == key), None)
    title = GROUP_TITLES.get(key, key.replace("_", " ").capitalize())
    return ReportSection(
        key=key, title=paper.title if paper else title,
        reference=paper.reference if paper else "",
        items=tuple(sorted(items, key=lambda item: parse_place(item.place)[:3])),
    )  # fmt: skip


def _make_experiment_item(name: str, experiment: ExperimentConfig) -> ReportItem:
    note = FIT_CAPTION if experiment.fit else RETRIEVAL_CAPTION
    return ReportItem(
        anchor=f"experiment-{name}",
        name=name,
        title=experiment.title or name,
        caption=experiment.caption,
        place=experiment.reproduces.place if experiment.reproduces else "",
        **_sort_files(experiment.list_product_paths(), note),
    )


def _list_study_items(name: str, study: Study) -> list[ReportItem]:
    outputs, paths = study.list_outputs(name), study.list_product_paths(name)
    # A dataset of the study is linked below its figure.
    datasets = _sort_files([path for made in paths.values() for path in made])["datasets"]
    reproduced = study.reproduces.place if study.reproduces else ""
    items = []
    for file, output in outputs.items():
        files = _sort_files(paths[file])
        if not files["datasets"]:
            item = ReportItem(
                anchor=f"study-{name}-{file}",
                name=name,
                title=output.title or PurePath(file).stem,
                caption=output.caption,
                place=output.place or reproduced,
                is_comparison=output.comparison,
                **files | ({"datasets": datasets} if files["figure"] else {}),
            )
            items.append(item)
    return items


def _sort_files(paths: list[str], note: str = "") -> dict[str, Any]:
    """Return the figure (without suffix), tables and datasets among the files of an item."""
    first = FIGURE_SUFFIXES[0]
    figures = [path.removesuffix(first) for path in paths if path.endswith(first)]
    tables = [ReportTable(path=path, note=note) for path in paths if path.endswith(".csv")]
    datasets = [path for path in paths if path.endswith(".nc")]
    return {"figure": "".join(figures[:1]), "tables": (*tables,), "datasets": (*datasets,)}
