"""Write the table of fitted parameters (snakemake script)."""

from splits import load
from splits.experiments.papers.paper_tables import write_data_frame
from splits.experiments.papers.sand_trends import make_fit_table

write_data_frame(make_fit_table(load(snakemake.input[0])), snakemake.output[0])
