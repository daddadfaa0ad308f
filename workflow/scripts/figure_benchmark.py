"""Draw error against time (snakemake script)."""

from pathlib import Path

import pandas as pd

from splits.experiments.papers.performance_figure import draw_speed_against_error
from splits.plotting import save_figure

figure = draw_speed_against_error(pd.read_csv(snakemake.input[0]))
save_figure(figure, Path(snakemake.output[0]).with_suffix(""))
