"""Table of what rough layers do (map snakemake to `splits.analysis`)."""

import pandas as pd

from splits import load
from splits.analysis.layer_trends import layer_trends
from splits.analysis.tables import write_table

roles = zip(snakemake.params.roles, snakemake.input.data, strict=True)
datasets = {role: load(path) for role, path in roles}
write_table(pd.DataFrame(layer_trends(datasets)), snakemake.output[0])
