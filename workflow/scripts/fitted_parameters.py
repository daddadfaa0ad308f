"""Write the table of fitted parameters (snakemake script)."""

from splits import load
from splits.core.escaping import write_data_frame
from splits.experiments.run_fit import make_fit_table
from splits.io.netcdf import exit_if_damaged

exit_if_damaged(snakemake.input)
write_data_frame(make_fit_table(load(snakemake.input[0])), snakemake.output[0])
