"""Draw error against time, and write the table of times (snakemake script)."""

import sys
from pathlib import Path

import pandas as pd

from splits.core.escaping import write_data_frame
from splits.plotting import save_figure

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from performance import draw_speed_against_error, make_time_table

table = pd.read_csv(snakemake.input[0])
write_data_frame(make_time_table(table), snakemake.output.table)
save_figure(draw_speed_against_error(table), Path(snakemake.output.figure[0]).with_suffix(""))
