"""Studies of measured spectra and directions: surface areas of snow, anisotropy of wet sand."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from splits.analysis.anisotropy import MEASURED_COLUMNS
from splits.experiments.studies.study import Files, Inputs, Study, StudyProduct, StudyRun
from splits.experiments.studies.study_files import MEASURED_SPECTRA, MEASURED_VALUES
from splits.experiments.studies.study_input import StudyInput, make_goniophotometer_input


class SurfaceAreaStudy(Study):
    """Specific surface areas of measured snow."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct(
            "{study}",
            "Specific surface area of measured snow",
            "The specific surface area and the scale from all ranges of wavelength and from parts "
            "of them, with the error due to that of the model. The differences between the "
            "parts are a better estimate of the uncertainty.",
        ),
        "law": StudyProduct(
            "{study}_law",
            "Reflectance at 1310 nm by specific surface area",
            "Simulated values, and those of two laws.",
        ),
        "figure": StudyProduct.make_figure(
            "{study}_found",
            "Surface area of measured snow",
            "Three measured reflectance spectra of snow (Dozier 2021) and the fitted deep, clean, "
            "modelled natural snow. Only the specific surface area and the scale are fitted, at "
            "700-900, 990-1090, 1220-1300, 1500-1750 and 2060-2350 nm, outside the absorption "
            "bands of water vapour. The sensor measured a single direction, while the modelled "
            "reflectance is directional-hemispherical; the scale compensates for only a part of "
            "the difference. There are no measurements of the snow itself.",
        ),
        "law_figure": StudyProduct.make_figure(
            "{study}_law",
            "Reflectance at 1310 nm and surface area",
            "Reflectance at 1310 nm of deep snow at normal incidence against specific surface "
            "area. Modelled natural snow and smooth spheres (with polarization) are simulated. The "
            "other lines are the "
            "laws of Kokhanovsky & Zege (2004), valid for weak absorption, and of Malinka et al. "
            "(2016), computed with snowoptics. The grey area is the range of reflectance that "
            "Gallet et al. (2009) state for specific surface areas below 60 m2/kg.",
        ),
    }
    INPUTS: ClassVar = {
        "spectra": StudyInput(
            ("specific_surface_area_m2_kg", "incidence_deg"), band_nm=(700.0, 2400.0)
        ),
        **{
            grains: StudyInput(("specific_surface_area_m2_kg",), at_nm=(1310.0,))
            for grains in ("natural", "spheres")
        },
    }
    FILES: ClassVar = {"spectra": MEASURED_SPECTRA}
    MESSAGE: ClassVar = "Retrieving the surface area of measured snow"

    kind: Literal["surface_area"]
    inputs: Inputs
    files: Files

    def make(self, run: StudyRun) -> None:
        """Make the tables and figures."""
        from splits.analysis.surface_area import (
            make_field_table,
            make_overlay_table,
            retrieve_surface_areas,
        )
        from splits.plotting import describe_conditions, draw_area_law, draw_fitted_spectra

        modelled, natural, spheres = (
            run.load(self.inputs[key]) for key in ("spectra", "natural", "spheres")
        )
        spectra = run.read("spectra")
        areas = retrieve_surface_areas(modelled, spectra)
        run.write_table("table", areas)
        overlay = make_overlay_table(modelled, spectra, areas)
        run.save_figure("figure", draw_fitted_spectra(overlay, describe_conditions(modelled)))
        law = make_field_table({"natural snow": natural, "smooth spheres": spheres})
        run.write_table("law", law)
        run.save_figure("law_figure", draw_area_law(law, describe_conditions(natural, band="bars")))


class AnisotropyStudy(Study):
    """Modelled and measured reflectance of wet sand by direction."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct(
            "{study}",
            "Reflectance of wet sand by direction",
            "Measured and modelled reflectance factor and ratio to the nadir in each direction.",
        ),
        "misfits": StudyProduct(
            "{study}_by_angle",
            "Anisotropy of wet sand by angle",
            "Root-mean-square differences of reflectance factors and of ratios to the nadir, for "
            "every water content, wavelength and viewing angle, also those of an isotropic model "
            "of the same reflectance. Measured reflectance factors are divided by the factor of "
            "the reference panel.",
        ),
        "figure": StudyProduct.make_figure(
            "{study}",
            "Modelled and measured anisotropy of wet sand",
            "Ratio to the nadir of dune sand (Nur & Bachmann 2023), dry, wet and saturated with "
            "water, for an incidence angle of 40 degrees: the reflectance in a direction divided "
            "by that at the nadir in the same scan. This ratio does not depend on the reference "
            "panel and the irradiance. The measurement is compared with two models: water that "
            "fills narrow pores first, and water in whole pores as in the paper.",
        ),
    }
    INPUTS: ClassVar = {"directions": make_goniophotometer_input("interpretation", "saturation")}
    FILES: ClassVar = {"directions": MEASURED_VALUES._replace(required=tuple(MEASURED_COLUMNS))}
    MESSAGE: ClassVar = "Comparing modelled and measured directions"

    kind: Literal["anisotropy"]
    inputs: Inputs
    files: Files
    scale: float = Field(
        1.0, gt=0.0, le=10.0, description="ratio of measured reflectance factors to true ones"
    )

    def make(self, run: StudyRun) -> None:
        """Make the tables and the figure."""
        from splits.analysis.anisotropy import compare_with_measured, summarize_by_angle
        from splits.plotting.anisotropy import draw_anisotropy

        dataset = run.load(self.inputs["directions"])
        table = compare_with_measured(dataset, run.read("directions"), self.scale)
        misfits = summarize_by_angle(table)
        run.write_table("table", table)
        run.write_table("misfits", misfits)
        # The principal plane is shown at a wavelength common to all samples.
        by_sample = [set(part.wavelength_nm) for _, part in table.groupby("saturation")]
        shared = set.intersection(*by_sample)
        middle = float(sorted(shared or set(table.wavelength_nm))[len(shared) // 3])
        run.save_figure("figure", draw_anisotropy(dataset, table, misfits, middle))
