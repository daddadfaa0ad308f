"""Study that compares a run with the published and measured numbers of SPLITSnow."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field

from splits.analysis.measured import LETCHER_COLUMNS
from splits.core.validation import check_choice
from splits.experiments.papers.snow_statements import TABLE3_WAVELENGTHS_NM
from splits.experiments.studies.study import (
    Experiments,
    Files,
    Inputs,
    Study,
    StudyProduct,
    StudyRun,
)
from splits.experiments.studies.study_files import MEASURED_SPECTRA, PUBLISHED_TABLE
from splits.experiments.studies.study_input import StudyInput

_VISIBLE_NM = (400.0, 700.0)
_AVIRIS_COLUMNS = ("reflectance", "reflectance_min", "reflectance_max")
_AVIRIS_NM = (842.25, 1073.76, 1237.93)


class AgreementStudy(Study):
    """Comparison of a run with published and measured numbers of snow."""

    PRODUCTS: ClassVar = {
        "agreement": StudyProduct(
            "{study}",
            "Published numbers, trends and measured spectra",
            "Every number and every trend of spectra that the SPLITSnow paper states, and measured "
            "spectra, compared with these runs: the published value, the simulated value with its "
            "standard error, the difference, the tolerance (bar) and the verdict.",
            is_comparison=True,
        ),
        "bands": StudyProduct(
            "{study}_bands",
            "Measured and modelled albedo by wavelength",
            "Measured and modelled albedo by wavelength for the snow of Letcher et al. (2022), for "
            "modelled natural snow and for grains of SPLITSnow Table 1, at two depths.",
        ),
        "table1": StudyProduct(
            "{study}_table1",
            "The representative sample",
            "Inputs of the representative sample and derived quantities.",
            place="Table 1",
        ),
        "table3": StudyProduct(
            "{study}_table3",
            "Reflectance in three bands of AVIRIS-NG",
            "The measured mean, the simulated value with its standard error, and the value that "
            "the paper states. The simulations are for the default interpretation, and with one "
            "choice changed at a time.",
            place="Table 3",
        ),
        "figure": StudyProduct.make_figure(
            "{study}_measured",
            "Measured albedo and three kinds of grains",
            "Albedo measured by Letcher et al. (2022) and modelled with the measured density and "
            "specific surface area under 85 % diffuse light. Nothing is fitted. Modelled natural "
            "snow has the grain shape measured by tomography. The other two models have the grains "
            "of SPLITSnow Table 1, scaled to that specific surface area. The absolute uncertainty "
            "of the measurement is about 2 %.",
        ),
    }
    INPUTS: ClassVar = {
        "sample": StudyInput(("density_kg_m3",), {"density_kg_m3": (450,)}),
        "thick_transmittance": StudyInput(band_nm=(400.0, 1000.0)),
        "grain_size": StudyInput(
            ("grain_size_um",), band_nm=(400.0, 2500.0),
            at_nm=(1500.0, 1800.0, 2000.0, 2250.0, 2500.0),
        ),
        "facetness": StudyInput(("facetness",), band_nm=(700.0, 1300.0)),
        "density": StudyInput(("density_kg_m3",), {"density_kg_m3": (300, 450)}),
        "depth": StudyInput(("depth_m",), at_nm=(1030.0,), band_nm=_VISIBLE_NM),
        "grain_size_transmittance": StudyInput(("grain_size_um",), band_nm=_VISIBLE_NM),
        "saturation_transmittance": StudyInput(("saturation",), band_nm=(400.0, 1450.0)),
        "density_transmittance": StudyInput(
            ("density_kg_m3",), at_nm=(1420.0,), band_nm=_VISIBLE_NM
        ),
        "aviris": StudyInput(at_nm=_AVIRIS_NM),
        "letcher": StudyInput(
            ("medium", "depth_m", "incidence_deg"),
            {"depth_m": (0.34, 0.045), "incidence_deg": ("beam", "diffuse")},
        ),
        "interpretation": StudyInput(("interpretation",), at_nm=_AVIRIS_NM),
    }  # fmt: skip
    FILES: ClassVar = {
        "published": PUBLISHED_TABLE._replace(required=tuple(TABLE3_WAVELENGTHS_NM)),
        "aviris": MEASURED_SPECTRA._replace(required=_AVIRIS_COLUMNS),
        "letcher": MEASURED_SPECTRA._replace(required=tuple(LETCHER_COLUMNS.values())),
    }
    MESSAGE: ClassVar = "Comparing results with published and measured numbers"

    kind: Literal["agreement"]
    inputs: Inputs
    files: Files
    sensitivity: str = Field(
        description="name of the study of kind `sensitivity` for the same snow"
    )

    def list_studies(self) -> list[str]:
        """Return the study of sensitivity of the same snow."""
        return [self.sensitivity]

    def check_keys(self, available: Experiments, studies: Mapping[str, Study]) -> None:
        """Reject a name that is not that of a study of sensitivity."""
        names = [name for name, study in studies.items() if study.kind == "sensitivity"]
        check_choice("sensitivity", self.sensitivity, names)

    def make(self, run: StudyRun) -> None:
        """Make the tables and the figure."""
        from splits.analysis.measured import compare_with_letcher
        from splits.experiments.papers.agreement import make_agreement_table
        from splits.experiments.papers.paper_tables import make_table1, make_table3
        from splits.plotting import describe_conditions, draw_measured_albedo

        datasets = self.load_inputs(run)
        published, aviris, letcher = (run.read(key) for key in self.FILES)
        sensitivity = run.load(self.sensitivity)
        table = make_agreement_table(datasets, published, sensitivity, aviris, letcher)
        run.write_table("agreement", table)
        albedo = compare_with_letcher(datasets["letcher"], letcher)
        run.write_table("bands", albedo)
        conditions = describe_conditions(datasets["letcher"])
        run.save_figure("figure", draw_measured_albedo(albedo, conditions))
        run.write_table("table1", make_table1(datasets["sample"]))
        run.write_table("table3", make_table3(datasets["interpretation"], aviris, published))
