"""Choose the bands that tell most (map snakemake to `splits.select_bands`)."""

import json
from pathlib import Path

import pandas as pd

import splits
from splits.experiments.papers.paper_tables import write_table
from splits.plotting.sensitivity import draw_band_selection
from splits.plotting.style import save_figure
from splits.tables.axes import list_numeric_axes

found, given = {}, json.loads(snakemake.params.fixed)
for name, path in zip(snakemake.params.names, snakemake.input.data, strict=True):
    table = splits.open_table(path)
    at = {n: value for n, value in given.items() if n in table.axes}
    free = [n for n in list_numeric_axes(table.dataset, table.axes[:-1]) if n not in at]
    bands = snakemake.params.bands or table.dataset.wavelength.values
    found[name.replace("_", " ")] = splits.select_bands(
        table, bands, free, snakemake.params.noise, snakemake.params.n_bands, fixed=at,
        seed=snakemake.params.seed,
    )  # fmt: skip
lines = [one.to_dataframe().reset_index().assign(table=name) for name, one in found.items()]
write_table(pd.concat(lines, ignore_index=True), snakemake.output.table)
known = ", ".join(f"{n} {v}" for n, v in given.items())
note = f"Noise {snakemake.params.noise:g}" + (f", at {known}" if known else "")
save_figure(draw_band_selection(found, note), Path(snakemake.output.figure[0]).with_suffix(""))
