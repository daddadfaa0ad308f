"""Find the surface area of measured snow (map snakemake to `splits.analysis`)."""

from pathlib import Path

from splits import load
from splits.analysis.measured import read_spectra
from splits.analysis.surface_area import field_law, overlay, surface_areas
from splits.analysis.tables import write_table
from splits.figures import area_law, conditions, fitted_spectra, save_figure

roles = zip(snakemake.params.roles, snakemake.input.data, strict=True)
datasets = {role: load(path) for role, path in roles}
spectra = read_spectra(snakemake.input.spectra)
found = surface_areas(datasets["spectra"], spectra)
write_table(found, snakemake.output.table)
figure = fitted_spectra(
    overlay(datasets["spectra"], spectra, found), conditions(datasets["spectra"])
)
save_figure(figure, Path(snakemake.output.figure[0]).with_suffix(""))
law = field_law(datasets["field"])
write_table(law, snakemake.output.law)
save_figure(
    area_law(law, conditions(datasets["field"], band="bars")),
    Path(snakemake.output.law_figure[0]).with_suffix(""),
)
