"""Studies of measured spectra and directions: surface areas of snow, anisotropy of wet sand."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field

from splits.experiments.studies.study import (
    FILES_DESCRIPTION,
    ROLES_DESCRIPTION,
    Study,
    StudyProduct,
    StudyRun,
)
from splits.experiments.studies.study_input import StudyInput, make_goniophotometer_input


class SurfaceAreaStudy(Study):
    """Specific surface areas of measured snow."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct("{study}", "surface_area", "Agreement"),
        "law": StudyProduct("{study}_law", "surface_area_law", "Agreement"),
        "figure": StudyProduct.make_figure("{study}_found", "surface_area", "Agreement"),
        "law_figure": StudyProduct.make_figure("{study}_law", "surface_area_law", "Agreement"),
    }
    INPUTS: ClassVar = {
        "spectra": StudyInput(
            ("specific_surface_area_m2_kg", "incidence_deg"), band_nm=(700.0, 2400.0)
        ),
        "field": StudyInput(("specific_surface_area_m2_kg", "medium"), at_nm=(1310.0,)),
    }
    FILES: ClassVar = {"spectra": "measured"}
    MESSAGE: ClassVar = "Retrieving the surface area of measured snow"

    kind: Literal["surface_area"]
    inputs: dict[str, str] = Field(description=ROLES_DESCRIPTION)
    files: dict[str, str] = Field(description=FILES_DESCRIPTION)

    def make(self, run: StudyRun) -> None:
        """Make the tables and figures."""
        from splits.analysis.measured import read_spectra
        from splits.analysis.surface_area import (
            make_field_table,
            make_overlay_table,
            retrieve_surface_areas,
        )
        from splits.plotting import describe_conditions, draw_area_law, draw_fitted_spectra

        modelled, field = (run.load(self.inputs[role]) for role in ("spectra", "field"))
        spectra = read_spectra(Path(run.files["spectra"]))
        areas = retrieve_surface_areas(modelled, spectra)
        run.write_table("table", areas)
        overlay = make_overlay_table(modelled, spectra, areas)
        run.save_figure("figure", draw_fitted_spectra(overlay, describe_conditions(modelled)))
        law = make_field_table(field)
        run.write_table("law", law)
        run.save_figure("law_figure", draw_area_law(law, describe_conditions(field, band="bars")))


class AnisotropyStudy(Study):
    """Modelled and measured ratios to the nadir of wet sand, by angle."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct("{study}", "anisotropy", "Sand"),
        "misfits": StudyProduct("{study}_by_angle", "anisotropy", "Sand"),
        "figure": StudyProduct.make_figure("{study}", "anisotropy", "Sand"),
    }
    INPUTS: ClassVar = {"directions": make_goniophotometer_input("interpretation", "saturation")}
    FILES: ClassVar = {"directions": "measured"}
    MESSAGE: ClassVar = "Comparing modelled and measured directions"

    kind: Literal["anisotropy"]
    inputs: dict[str, str] = Field(description=ROLES_DESCRIPTION)
    files: dict[str, str] = Field(description=FILES_DESCRIPTION)

    def make(self, run: StudyRun) -> None:
        """Make the tables and the figure."""
        from splits.analysis.anisotropy import compare_with_measured, summarize_by_angle
        from splits.analysis.measured import read_measured
        from splits.plotting.anisotropy import draw_anisotropy

        dataset = run.load(self.inputs["directions"])
        table = compare_with_measured(dataset, read_measured(Path(run.files["directions"])))
        misfits = summarize_by_angle(table)
        run.write_table("table", table)
        run.write_table("misfits", misfits)
        # The principal plane is shown at a wavelength common to all samples.
        by_sample = [set(part.wavelength_nm) for _, part in table.groupby("saturation")]
        shared = set.intersection(*by_sample)
        middle = float(sorted(shared or set(table.wavelength_nm))[len(shared) // 3])
        run.save_figure("figure", draw_anisotropy(dataset, table, misfits, middle))
