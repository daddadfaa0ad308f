"""Retrieve the surface area of measured snow (snakemake script)."""

from pathlib import Path

from splits import load
from splits.analysis.measured import read_spectra
from splits.analysis.surface_area import (
    make_field_table,
    make_overlay_table,
    retrieve_surface_areas,
)
from splits.experiments.papers.paper_tables import write_data_frame
from splits.plotting import describe_conditions, draw_area_law, draw_fitted_spectra, save_figure

roles = zip(snakemake.params.roles, snakemake.input.data, strict=True)
datasets = {role: load(path) for role, path in roles}
spectra = read_spectra(snakemake.input.spectra)
areas = retrieve_surface_areas(datasets["spectra"], spectra)
write_data_frame(areas, snakemake.output.table)
figure = draw_fitted_spectra(
    make_overlay_table(datasets["spectra"], spectra, areas),
    describe_conditions(datasets["spectra"]),
)
save_figure(figure, Path(snakemake.output.figure[0]).with_suffix(""))
law = make_field_table(datasets["field"])
write_data_frame(law, snakemake.output.law)
save_figure(
    draw_area_law(law, describe_conditions(datasets["field"], band="bars")),
    Path(snakemake.output.law_figure[0]).with_suffix(""),
)
