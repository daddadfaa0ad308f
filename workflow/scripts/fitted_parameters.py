"""List what a fit found (map snakemake to `splits.analysis`)."""

from splits import load
from splits.analysis.sand_tables import fitted_parameters
from splits.analysis.tables import write_table

write_table(fitted_parameters(load(snakemake.input[0])), snakemake.output[0])
