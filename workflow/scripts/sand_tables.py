"""Write the tables of the sand experiments (snakemake script)."""

import pandas as pd

from splits import load
from splits.analysis.colour import make_colour_table
from splits.experiments.papers.paper_tables import write_data_frame
from splits.experiments.papers.sand_trends import make_sand_trend_table, make_shift_table

roles = zip(snakemake.params.roles, snakemake.input.data, strict=True)
datasets = {role: load(path) for role, path in roles}
weights = [
    make_shift_table(datasets["mineral_weight"], "refractive_index", "as modelled"),
    make_shift_table(datasets["interpretation"], "interpretation", "default"),
    make_shift_table(datasets["size_tail"], "size_tail", 1e-4),
]
swatches = [
    make_colour_table(datasets[role]).assign(experiment=datasets[role].attrs["experiment"])
    for role in ("wet_colours", "colours")
]
write_data_frame(make_sand_trend_table(datasets), snakemake.output.trends)
write_data_frame(pd.concat(weights), snakemake.output.weights)
write_data_frame(pd.concat(swatches), snakemake.output.colours)
