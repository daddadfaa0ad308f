"""Compare results with published and measured numbers (snakemake script)."""

from pathlib import Path

from splits import load
from splits.analysis.measured import compare_with_letcher, read_published, read_spectra
from splits.experiments.papers.agreement import make_agreement_table
from splits.experiments.papers.paper_tables import make_table1, make_table3, write_data_frame
from splits.plotting import describe_conditions, draw_measured_albedo, save_figure

roles = zip(snakemake.params.roles, snakemake.input.data, strict=True)
datasets = {role: load(path) for role, path in roles}
aviris = read_spectra(snakemake.input.aviris)
letcher = read_spectra(snakemake.input.letcher)
published = read_published(snakemake.input.published)
agreement = make_agreement_table(
    datasets, published, load(snakemake.input.sensitivity), aviris, letcher
)
write_data_frame(agreement, snakemake.output.agreement)
albedo = compare_with_letcher(datasets["letcher"], letcher)
write_data_frame(albedo, snakemake.output.bands)
figure = draw_measured_albedo(albedo, describe_conditions(datasets["letcher"]))
save_figure(figure, Path(snakemake.output.figure[0]).with_suffix(""))
write_data_frame(make_table1(datasets["sample"]), snakemake.output.table1)
bands = make_table3(datasets["interpretation"], aviris, published)
write_data_frame(bands, snakemake.output.table3)
