"""Write the table of goniometric trends (snakemake script)."""

import pandas as pd

from splits import load
from splits.experiments.papers.brdf_trends import make_brdf_trend_rows
from splits.experiments.papers.paper_tables import write_data_frame

roles = zip(snakemake.params.roles, snakemake.input.data, strict=True)
datasets = {role: load(path) for role, path in roles}
write_data_frame(pd.DataFrame(make_brdf_trend_rows(datasets)), snakemake.output[0])
