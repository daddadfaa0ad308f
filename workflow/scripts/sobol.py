"""Compute Sobol indices of tables (snakemake script)."""

from pathlib import Path

import pandas as pd

import splits
from splits.experiments.papers.paper_tables import write_data_frame
from splits.plotting.sensitivity import draw_sobol_indices
from splits.plotting.style import save_figure
from splits.tables.axes import list_numeric_axes

indices = {}
for name, path in zip(snakemake.params.names, snakemake.input.data, strict=True):
    table = splits.open_table(path)
    free = list_numeric_axes(table.dataset, table.axes[:-1])
    indices[name.replace("_", " ")] = splits.sobol_indices(table, free, seed=snakemake.params.seed)
tables = [ds.to_dataframe().reset_index().assign(table=name) for name, ds in indices.items()]
write_data_frame(pd.concat(tables, ignore_index=True), snakemake.output.table)
save_figure(draw_sobol_indices(indices), Path(snakemake.output.figure[0]).with_suffix(""))
