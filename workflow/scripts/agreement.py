"""Hold results against published and measured numbers (map snakemake to `splits.analysis`)."""

from pathlib import Path

from splits import load
from splits.analysis.agreement import agreement_table, read_published
from splits.analysis.measured import letcher_bands, read_spectra
from splits.analysis.tables import table1, table3, write_table
from splits.figures import conditions, measured_albedo, save_figure

roles = zip(snakemake.params.roles, snakemake.input.data, strict=True)
datasets = {role: load(path) for role, path in roles}
aviris = read_spectra(snakemake.input.aviris)
letcher = read_spectra(snakemake.input.letcher)
published = read_published(snakemake.input.published)
agreement = agreement_table(datasets, published, load(snakemake.input.sensitivity), aviris, letcher)
write_table(agreement, snakemake.output.agreement)
albedo = letcher_bands(datasets["letcher"], letcher)
write_table(albedo, snakemake.output.bands)
figure = measured_albedo(albedo, conditions(datasets["letcher"]))
save_figure(figure, Path(snakemake.output.figure[0]).with_suffix(""))
write_table(table1(datasets["sample"]), snakemake.output.table1)
bands = table3(datasets["readings"], aviris, published)
write_table(bands, snakemake.output.table3)
