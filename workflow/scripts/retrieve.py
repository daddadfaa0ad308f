"""Retrieve parameters from measured spectra with a table (snakemake script)."""

from splits.core.progress import open_progress_log
from splits.experiments.config.load import locate_job_errors
from splits.experiments.config.retrieval import RetrieveSection
from splits.experiments.run_retrieve import write_retrieval
from splits.io.netcdf import exit_if_damaged

exit_if_damaged(snakemake.input)
with (
    open_progress_log(snakemake.log[0]) as log,
    locate_job_errors(snakemake.config, snakemake.wildcards.experiment),
):
    write_retrieval(
        RetrieveSection.model_validate_json(snakemake.params.retrieve),
        snakemake.input.table,
        snakemake.input.measured[0],
        snakemake.params.seed,
        (snakemake.output.table, snakemake.output.figure[0]),
        log,
    )
