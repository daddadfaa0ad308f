"""Write the table of fitted parameters (snakemake script)."""

from splits import load
from splits.experiments.papers.paper_tables import write_table
from splits.experiments.papers.sand_trends import make_fit_table

write_table(make_fit_table(load(snakemake.input[0])), snakemake.output[0])
