"""Hold results against published and measured numbers (map snakemake to `splits.analysis`)."""

from pathlib import Path

from splits import load
from splits.analysis.agreement import agreement_table, read_published
from splits.analysis.measured import letcher_bands, read_measured
from splits.analysis.tables import table1, table3, write_table

datasets = {Path(path).stem: load(path) for path in snakemake.input.data}
aviris = read_measured(snakemake.input.aviris)
letcher = read_measured(snakemake.input.letcher)
published = read_published(snakemake.input.published)
agreement = agreement_table(datasets, published, load(snakemake.input.sensitivity), aviris, letcher)
write_table(agreement, snakemake.output.agreement)
write_table(letcher_bands(datasets["letcher2022"], letcher), snakemake.output.bands)
write_table(table1(datasets["table1_sample"]), snakemake.output.table1)
bands = table3(datasets["readings_table3"], aviris, published)
write_table(bands, snakemake.output.table3)
