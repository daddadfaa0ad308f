"""Tables of the sand experiments (map snakemake to `splits.analysis`)."""

from pathlib import Path

import pandas as pd

from splits import load
from splits.analysis.colour import colours
from splits.analysis.sand_tables import sand_trends, shifts
from splits.analysis.tables import write_table

datasets = {Path(path).stem: load(path) for path in snakemake.input.data}
weights = [
    shifts(datasets["sand_mineral_weight"], "refractive_index", "as modelled"),
    shifts(datasets["sand_readings"], "readings", "default"),
    shifts(datasets["sand_size_tail"], "size_tail", 1e-4),
]
swatches = [
    colours(datasets[name]).assign(experiment=name)
    for name in ("sand_fig07_wet_colours", "sand_fig09_colours")
]
write_table(sand_trends(datasets), snakemake.output.trends)
write_table(pd.concat(weights), snakemake.output.weights)
write_table(pd.concat(swatches), snakemake.output.colours)
