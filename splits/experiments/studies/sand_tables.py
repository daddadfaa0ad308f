"""Studies of sand: the statements of SPLITS, and the compositions of all sands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from splits.core.provenance import hash_physics_sources
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.studies.study import Experiments, Inputs, Study, StudyProduct, StudyRun
from splits.experiments.studies.study_input import StudyInput

_RANGE_NM, _COLOUR_NM = (400.0, 1000.0), (400.0, 780.0)


class SandTablesStudy(Study):
    """Statements of SPLITS on sand."""

    PRODUCTS: ClassVar = {
        "trends": StudyProduct(
            "{study}_trends",
            "Trends stated in SPLITS",
            "Every spectral trend that SPLITS states for sand. The number is the smallest step in "
            "the stated direction, with its standard error. A trend agrees with the paper if this "
            "step exceeds three standard errors.",
            is_comparison=True,
        ),
        "weights": StudyProduct(
            "{study}_weights",
            "Effect of data and interpretation on reflectance",
            "Change of the reflectance of five sands, 400-1000 nm, if one input is changed: the "
            "absorption index k of the two minerals without a public table (goethite, kaolinite), "
            "the ordinary ray of hematite alone, each interpretation of the paper, or the mass "
            "fraction that is assumed outside the outermost limits of size.",
        ),
        "colours": StudyProduct(
            "{study}_colours",
            "Colours of dry and wet sand",
            "Colours of SPLITS Figs 7 and 9: tristimulus values, CIELAB with standard errors and "
            "sRGB, for the CIE 1931 2° observer under the illuminant D65. Standard errors are "
            "standard deviations over runs with different seeds. The interpolation bound is an "
            "upper bound on the error of interpolation between refractive indices.",
        ),
    }
    INPUTS: ClassVar = {
        "samples": StudyInput(("medium",), band_nm=_RANGE_NM),
        "wet_colours": StudyInput(("medium", "saturation"), band_nm=_COLOUR_NM),
        "colours": StudyInput(("medium",), band_nm=_COLOUR_NM),
        "iron_oxide": StudyInput(("iron_oxide",), band_nm=_RANGE_NM),
        "hematite_ratio": StudyInput(("hematite_ratio",), band_nm=(480.0, 700.0)),
        "magnetite": StudyInput(("magnetite",), band_nm=_RANGE_NM),
        "texture": StudyInput(("texture",), band_nm=_RANGE_NM),
        "fine_fraction": StudyInput(("texture",), band_nm=(400.0, 500.0)),
        "mineral_weight": StudyInput(
            ("medium", "refractive_index"), {"refractive_index": ("as modelled",)}
        ),
        "interpretation": StudyInput(
            ("medium", "interpretation"), {"interpretation": ("default",)}
        ),
        "size_tail": StudyInput(("medium", "size_tail"), {"size_tail": (1e-4,)}),
    }
    MESSAGE: ClassVar = "Comparing sand with the trends stated in SPLITS"

    kind: Literal["sand_tables"]
    inputs: Inputs

    def make(self, run: StudyRun) -> None:
        """Make the tables."""
        import pandas as pd

        from splits.analysis.colour import make_colour_table
        from splits.experiments.papers.sand_trends import make_sand_trend_table, make_shift_table

        datasets = self.load_inputs(run)
        weights = [
            make_shift_table(datasets[key], dimension, labels[0])
            for key in ("mineral_weight", "interpretation", "size_tail")
            for dimension, labels in self.INPUTS[key].labels.items()
        ]
        colours = [
            make_colour_table(datasets[key]).assign(experiment=self.inputs[key])
            for key in ("wet_colours", "colours")
        ]
        run.write_table("trends", make_sand_trend_table(datasets))
        run.write_table("weights", pd.concat(weights))
        run.write_table("colours", pd.concat(colours))


class SandCompositionsStudy(Study):
    """Compositions of all selected sands."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct(
            "{study}",
            "Compositions of the sands",
            "Composition of every sand of the experiments: mass fractions, densities and volume "
            "fractions of the types of grain, minerals by mass and by volume within each type, "
            "volume fraction of iron oxide in a mixture or coating, and volume fraction of "
            "coatings.",
            place="section 4.2.5",
        ),
    }
    MESSAGE: ClassVar = "Listing the compositions of all sands"

    kind: Literal["sand_compositions"]

    def list_parameters(
        self, seed: int, max_stderr: float, experiments: Experiments
    ) -> dict[str, Any]:
        """Return the experiments with sand."""
        sands = {
            name: experiment.dump_simulation()
            for name, experiment in experiments.items()
            if experiment.medium.get("kind") == "sand"
        }
        return {"experiments": sands, "physics": hash_physics_sources()}

    def describe_missing(self, available: Experiments, studies: Mapping[str, Study]) -> list[str]:
        """Return a message if there is no experiment with sand."""
        has_sand = any(one.medium.get("kind") == "sand" for one in available.values())
        return [] if has_sand else ["no experiment has sand"]

    def make(self, run: StudyRun) -> None:
        """Make the table."""
        from splits.experiments.papers.composition_table import make_composition_table

        experiments = {
            name: SimulationConfig.model_validate(content)
            for name, content in run.parameters["experiments"].items()
        }
        run.write_table("table", make_composition_table(experiments))
