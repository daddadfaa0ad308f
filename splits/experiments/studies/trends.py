"""Studies of statements in words: on BRDFs of both grain models, and on rough layers."""

from __future__ import annotations

from typing import ClassVar, Literal

from splits.experiments.studies.study import Inputs, Study, StudyProduct, StudyRun
from splits.experiments.studies.study_input import StudyInput, make_goniophotometer_input


class AngularTrendsStudy(Study):
    """Statements of the papers on BRDFs; a subset of the study inputs is sufficient."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct(
            "{study}",
            "Statements on BRDFs",
            "Statements of SPLITSnow (section 5.3) and SPLITS (Fig 11) in words on their BRDFs, "
            "expressed as numbers with standard errors. A trend agrees with the paper if its "
            "smallest step exceeds three standard errors. Rows with the verdict outside are trends "
            "that are not reproduced with the default interpretation of the papers; see "
            "docs/theory/angles.md.",
            is_comparison=True,
        ),
    }
    INPUTS: ClassVar = {
        "incidence": make_goniophotometer_input(
            "incidence_deg", labels={"incidence_deg": (0,)}, at_nm=(600.0,)
        ),
        "grazing": make_goniophotometer_input("incidence_deg", at_nm=(600.0,)),
        "wavelength": make_goniophotometer_input(at_nm=(600.0, 1800.0)),
        "grain_size": make_goniophotometer_input("grain_size_um", at_nm=(600.0,)),
        "grain_size_uniform": make_goniophotometer_input("grain_size_um", at_nm=(600.0,)),
        "grain_size_infrared": make_goniophotometer_input("grain_size_um", at_nm=(1450.0,)),
        "facetness": make_goniophotometer_input("facetness", at_nm=(600.0,)),
        "sand": make_goniophotometer_input(
            "incidence_deg", labels={"incidence_deg": (60,)}, at_nm=(600.0,)
        ),
    }
    MESSAGE: ClassVar = "Comparing BRDFs with the trends stated in the papers"
    SOME_INPUTS_SUFFICE: ClassVar = True

    kind: Literal["angular_trends"]
    inputs: Inputs

    def make(self, run: StudyRun) -> None:
        """Make the table."""
        import pandas as pd

        from splits.experiments.papers.brdf_trends import make_brdf_trend_rows

        datasets = {
            key: dataset.sel(wavelength=list(self.INPUTS[key].at_nm), method="nearest")
            for key, dataset in self.load_inputs(run, descending="grain_size_um").items()
        }
        run.write_table("table", pd.DataFrame(make_brdf_trend_rows(datasets)))


class LayerTrendsStudy(Study):
    """Statements of the paper on rough layers; a subset of the study inputs is sufficient."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct(
            "{study}",
            "Statements on layers with a rough surface",
            "Statements of Budak & Grimailo (2020) in words on layers under rough surfaces, "
            "expressed as numbers with standard errors: the statistical lens, the contribution of "
            "a volume below a surface, and the effects of the correlation of slopes, of "
            "polarization, and of the band limit of a surface without finite slopes. The paper "
            "states no numbers; see docs/theory/agreement.md.",
            is_comparison=True,
        ),
    }
    INPUTS: ClassVar = {
        "lens": StudyInput(instrument="lens"),
        "volume": make_goniophotometer_input(
            "medium", labels={"medium": ("surface only", "surface and volume")}
        ),
        "slope_correlation": make_goniophotometer_input("surface"),
        "polarization": make_goniophotometer_input("polarized"),
        "multiple_reflection": make_goniophotometer_input("polarized"),
        "band_limit": StudyInput(("surface",)),
    }
    MESSAGE: ClassVar = "Comparing rough layers with the statements of their paper"
    SOME_INPUTS_SUFFICE: ClassVar = True

    kind: Literal["layer_trends"]
    inputs: Inputs

    def make(self, run: StudyRun) -> None:
        """Make the table."""
        import pandas as pd

        from splits.experiments.papers.layer_trends import make_layer_trend_rows

        datasets = {key: run.load(name) for key, name in self.inputs.items()}
        run.write_table("table", pd.DataFrame(make_layer_trend_rows(datasets)))
