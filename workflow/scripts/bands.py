"""Select the most informative bands (snakemake script)."""

import json
from pathlib import Path

import pandas as pd

import splits
from splits.experiments.papers.paper_tables import write_data_frame
from splits.plotting.sensitivity import draw_band_selection
from splits.plotting.style import save_figure
from splits.tables.axes import list_numeric_axes

selections, fixed_values = {}, json.loads(snakemake.params.fixed)
for name, path in zip(snakemake.params.names, snakemake.input.data, strict=True):
    table = splits.open_table(path)
    fixed = {n: value for n, value in fixed_values.items() if n in table.axes}
    free = [n for n in list_numeric_axes(table.dataset, table.axes[:-1]) if n not in fixed]
    bands = snakemake.params.bands or table.dataset.wavelength.values
    selections[name.replace("_", " ")] = splits.select_bands(
        table, bands, free, snakemake.params.noise, snakemake.params.n_bands, fixed=fixed,
        seed=snakemake.params.seed,
    )  # fmt: skip
tables = [ds.to_dataframe().reset_index().assign(table=name) for name, ds in selections.items()]
write_data_frame(pd.concat(tables, ignore_index=True), snakemake.output.table)
conditions = ", ".join(f"{n} {v}" for n, v in fixed_values.items())
note = f"Noise {snakemake.params.noise:g}" + (f", at {conditions}" if conditions else "")
save_figure(draw_band_selection(selections, note), Path(snakemake.output.figure[0]).with_suffix(""))
