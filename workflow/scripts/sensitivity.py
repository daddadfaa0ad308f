"""Take mean sensitivity indices (map snakemake to `splits.analysis`)."""

from pathlib import Path

from splits import load, save
from splits.analysis.agreement import read_published
from splits.analysis.sensitivity_tables import chosen_sensitivities, sensitivity_table
from splits.analysis.tables import write_table

datasets = {Path(path).stem: load(path) for path in snakemake.input.data}
table = sensitivity_table(datasets, snakemake.params.pairs)
chosen = chosen_sensitivities(table, read_published(snakemake.input.published))
write_table(table, snakemake.output.table)
write_table(chosen.to_dataframe().reset_index(), snakemake.output.table2)
save(chosen, snakemake.output.data)
