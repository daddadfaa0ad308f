"""Table of goniometric trends (map snakemake to `splits.analysis`)."""

import pandas as pd

from splits import load
from splits.analysis.angular_trends import angular_trends
from splits.analysis.tables import write_table

roles = zip(snakemake.params.roles, snakemake.input.data, strict=True)
datasets = {role: load(path) for role, path in roles}
write_table(pd.DataFrame(angular_trends(datasets)), snakemake.output[0])
