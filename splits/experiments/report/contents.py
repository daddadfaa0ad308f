"""Contents of the report: experiments and studies by paper and group, in the order of figures."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import PurePath
from typing import Any, NamedTuple

from splits.core.provenance import PACKAGE_FOLDER, hash_files
from splits.experiments.config.experiment import OWN_GROUP, PAPERS, ExperimentConfig, parse_place
from splits.experiments.config.settings import Settings
from splits.plotting.grammar import FIGURE_SUFFIXES

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
REPORT_SOURCES = ("contents.py", "page.py", "page.css", "page.html", "page.js")
"""Files of this folder that determine the page."""
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


class ReportItem(NamedTuple):
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
    tables, datasets : tuple of str
        Paths.
    note : str
        On the columns of the tables.
    is_comparison : bool
        Whether the table contains statements of papers with a verdict on each.
    """

    anchor: str
    name: str
    title: str
    caption: str = ""
    place: str = ""
    figure: str = ""
    tables: tuple[str, ...] = ()
    datasets: tuple[str, ...] = ()
    note: str = ""
    is_comparison: bool = False


class ReportSection(NamedTuple):
    """The experiments and studies of a paper (by its key) or of a group (by its name)."""

    key: str
    title: str
    reference: str
    items: tuple[ReportItem, ...]


class ReportContents(NamedTuple):
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
        return hashlib.sha256(f"{sources} {self!r}".encode()).hexdigest()[:16]


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
        paper = experiment.reproduces
        item = ReportItem(
            anchor=f"experiment-{name}",
            name=name,
            title=experiment.title or name,
            caption=experiment.caption,
            place=paper.place if paper else "",
            note=RETRIEVAL_CAPTION,
            **_sort_files(experiment.list_product_paths()),
        )
        items.setdefault(paper.paper if paper else experiment.group, []).append(item)
    for name in studies:
        study = settings.studies[name]
        # Without a group of its own, a study is in that of its first experiment.
        read = [experiments[one].group for one in study.list_experiments(settings.studies)]
        group = study.group or next(iter(read), OWN_GROUP)
        key = study.reproduces.paper if study.reproduces else group
        outputs, paths = study.list_outputs(name), study.list_product_paths(name)
        # A dataset of the study is linked below its figure.
        datasets = _sort_files([path for made in paths.values() for path in made])["datasets"]
        for file, output in outputs.items():
            files = _sort_files(paths[file])
            if files["datasets"]:
                continue
            item = ReportItem(
                anchor=f"study-{name}-{file}",
                name=name,
                title=output.title or PurePath(file).stem,
                caption=output.caption,
                place=output.place or (study.reproduces.place if study.reproduces else ""),
                is_comparison=output.comparison,
                **files | ({"datasets": datasets} if files["figure"] else {}),
            )
            items.setdefault(key, []).append(item)
    papers = {str(key): (paper.title, paper.reference) for key, paper in PAPERS.items()}
    sections = []
    for key in dict.fromkeys([*papers, *GROUP_TITLES, *items]):
        if key in items:
            title = GROUP_TITLES.get(key, key.replace("_", " ").capitalize())
            ordered = sorted(items[key], key=lambda item: parse_place(item.place)[:3])
            sections.append(ReportSection(key, *papers.get(key, (title, "")), (*ordered,)))
    accuracy = settings.accuracies[settings.accuracy]
    return ReportContents(
        settings.accuracy, accuracy.max_stderr, accuracy.relative_stderr, settings.seed,
        (*sections,), (*benchmarks,), explorer,
    )  # fmt: skip


def _sort_files(paths: list[str]) -> dict[str, Any]:
    """Return the figure (without suffix), tables and datasets among the files of an item."""
    first = FIGURE_SUFFIXES[0]
    figures = [path.removesuffix(first) for path in paths if path.endswith(first)]
    tables, datasets = (tuple(p for p in paths if p.endswith(end)) for end in (".csv", ".nc"))
    return {"figure": "".join(figures[:1]), "tables": tables, "datasets": datasets}
