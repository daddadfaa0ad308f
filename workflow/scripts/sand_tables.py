"""Tables of the sand experiments (map snakemake to `splits.analysis`)."""

import pandas as pd

from splits import load
from splits.analysis.colour import colours
from splits.analysis.sand_tables import sand_trends, shifts
from splits.analysis.tables import write_table

roles = zip(snakemake.params.roles, snakemake.input.data, strict=True)
datasets = {role: load(path) for role, path in roles}
weights = [
    shifts(datasets["mineral_weight"], "refractive_index", "as modelled"),
    shifts(datasets["readings"], "readings", "default"),
    shifts(datasets["size_tail"], "size_tail", 1e-4),
]
swatches = [
    colours(datasets[role]).assign(experiment=datasets[role].attrs["experiment"])
    for role in ("wet_colours", "colours")
]
write_table(sand_trends(datasets), snakemake.output.trends)
write_table(pd.concat(weights), snakemake.output.weights)
write_table(pd.concat(swatches), snakemake.output.colours)
