"""Study of mean sensitivity indices of spectra to parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field

from splits.core.validation import invalid
from splits.experiments.config.sections import ConfigSection
from splits.experiments.studies.study import Experiments, Files, Study, StudyProduct, StudyRun
from splits.experiments.studies.study_input import StudyInput, check_input

DEPTHS_M: Mapping[str, tuple[float | str, ...]] = {"depth_m": (0.12, 0.02)}
"""Depths of `splits.experiments.papers.sensitivity_table.QUANTITY_CONDITIONS`."""
BAND_NM = (400.0, 2500.0)


class SensitivityPair(ConfigSection):
    """Two values of a parameter between which the sensitivity of a spectrum is computed.

    `experiment` varies the parameter, and the experiment `interpretation` the interpretation of the
    papers as well.  `source` is the origin of the two values: the paper, or our choice.
    """

    parameter: str = Field(description="parameter that varies")
    experiment: str = Field(description="experiment over the parameter and the depth")
    interpretation: str | None = Field(
        None, description="experiment that also varies the interpretations of the papers"
    )
    low: float | str = Field(description="value or label at one end of the range")
    high: float | str = Field(description="value or label at the other end")
    source: Literal["paper", "ours"] = Field(
        "ours", description="who chose the two values; the figure indicates this"
    )

    def list_experiments(self) -> list[str]:
        """Return the names of its experiments."""
        return [self.experiment, *([self.interpretation] if self.interpretation else [])]

    def check(self, key: str, available: Experiments) -> None:
        """Reject experiments that do not meet the requirements."""
        axes = (self.parameter, "depth_m")
        extremes: dict[str, tuple[float | str, ...]] = {self.parameter: (self.low, self.high)}
        if self.experiment in available:
            required = StudyInput(axes, {**extremes, **DEPTHS_M}, band_nm=BAND_NM)
            check_input(f"{key}.experiment", available[self.experiment], required)
        if self.interpretation in available:
            required = StudyInput((*axes, "interpretation"), DEPTHS_M, band_nm=BAND_NM)
            check_input(f"{key}.interpretation", available[str(self.interpretation)], required)


class SensitivityStudy(Study):
    """Mean sensitivity indices of spectra to parameters."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct(
            "{study}",
            "Mean sensitivity index for all pairs of values",
            "Mean sensitivity index for every pair of simulated values and for every "
            "interpretation of the papers. In the index msi, wavelengths where both spectra are "
            "below two standard errors contribute 0; msi_resolved excludes them; resolved_fraction "
            "is the fraction of the other wavelengths.",
        ),
        "chosen": StudyProduct(
            "{study}_chosen",
            "Mean sensitivity indices",
            "The values of the figure, and the published ones.",
            place="Table 2",
        ),
        "data": StudyProduct("{study}_index", folder="data", suffixes=(".nc",)),
        "figure": StudyProduct.make_figure(
            "{study}_index",
            "Mean sensitivity indices",
            "Mean sensitivity index of reflectance (12 cm, 400-2500 nm) and transmittance (2 cm, "
            "400-1420 nm). Error bars extend over two standard errors to either side. Standard "
            "errors include the correlation of errors between wavelengths. The paper does not "
            "state the extremes of saturation and density: those used here are in the "
            "configuration, and the table of sensitivities has the index for others.",
            place="Fig 23",
        ),
    }
    FILES: ClassVar = {"published": "published"}
    OPTIONAL_FILES: ClassVar = True
    MESSAGE: ClassVar = "Computing mean sensitivity indices"

    kind: Literal["sensitivity"]
    pairs: dict[str, SensitivityPair] = Field(description="pairs of values by name; see below")
    files: Files = Field({})

    def list_experiments(self) -> list[str]:
        """Return the names of the experiments of the study, without repetition."""
        names = [name for pair in self.pairs.values() for name in pair.list_experiments()]
        return list(dict.fromkeys(names))

    def check_inputs(self, available: Experiments) -> None:
        """Reject experiments that do not meet the requirements."""
        if not self.pairs:
            raise invalid("pairs", self.pairs, "at least one pair")
        for name, pair in self.pairs.items():
            pair.check(f"pairs.{name}", available)

    def make(self, run: StudyRun) -> None:
        """Make the tables, the dataset and the figure."""
        from splits import save
        from splits.experiments.papers.sensitivity_table import (
            describe_ranges,
            make_sensitivity_table,
            select_chosen_sensitivities,
        )
        from splits.plotting import draw_sensitivity_bars

        pairs = {name: pair.model_dump() for name, pair in self.pairs.items()}
        datasets = {name: run.load(name) for name in self.list_experiments()}
        table = make_sensitivity_table(datasets, pairs)
        published = run.read("published") if run.files else None
        chosen = select_chosen_sensitivities(table, published)
        run.write_table("table", table)
        run.write_table("chosen", chosen.to_dataframe().reset_index())
        save(chosen, run.outputs["data"][0])
        run.save_figure("figure", draw_sensitivity_bars(chosen, describe_ranges(pairs)))
