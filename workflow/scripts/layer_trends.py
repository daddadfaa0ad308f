"""Table of what rough layers do (map snakemake to `splits.analysis`)."""

from pathlib import Path

import pandas as pd

from splits import load
from splits.analysis.layer_trends import layer_trends
from splits.analysis.tables import write_table

datasets = {Path(path).stem: load(path) for path in snakemake.input.data}
write_table(pd.DataFrame(layer_trends(datasets)), snakemake.output[0])
