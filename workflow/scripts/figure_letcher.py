"""Draw measured against modelled albedo (map snakemake to `splits.figures`)."""

from pathlib import Path

import pandas as pd

from splits.figures import measured_albedo, save_figure

figure = measured_albedo(pd.read_csv(snakemake.input[0]))
save_figure(figure, Path(snakemake.output[0]).with_suffix(""))
