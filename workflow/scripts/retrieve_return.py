"""Retrieve parameters from returns of a pulse with a table (snakemake script)."""

from splits.core.progress import open_progress_log
from splits.experiments.config.load import locate_job_errors
from splits.experiments.config.retrieval import RetrieveReturnSection
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run_retrieve import write_return_retrieval
from splits.io.netcdf import exit_if_damaged

exit_if_damaged(snakemake.input)
with (
    open_progress_log(snakemake.log[0]) as log,
    locate_job_errors(snakemake.config, snakemake.wildcards.experiment),
):
    write_return_retrieval(
        SimulationConfig.model_validate(snakemake.params.experiment),
        RetrieveReturnSection.model_validate_json(snakemake.params.retrieve),
        (snakemake.input.table, next(iter(snakemake.input.measured), None)),
        snakemake.params.seed,
        (snakemake.output.table, snakemake.output.figure[0]),
        snakemake.threads,
        log,
    )
