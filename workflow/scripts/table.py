"""Assemble a table from its blocks (snakemake script)."""

from pathlib import Path

from splits.core.process import exit_on_signals

exit_on_signals(snakemake.wildcards.experiment)

from splits.core.progress import open_progress_log
from splits.experiments.config.load import locate_job_errors
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run_table import delete_unused_blocks, write_table

with (
    open_progress_log(snakemake.log[0]) as log,
    locate_job_errors(snakemake.config, snakemake.wildcards.experiment),
):
    write_table(
        SimulationConfig.model_validate(snakemake.params.experiment),
        Accuracy.model_validate(snakemake.params.accuracy),
        snakemake.params.seed,
        Path(snakemake.input.parts[0]).parent,
        Path(snakemake.output[0]),
        snakemake.threads,
        log,
    )
delete_unused_blocks([Path(manifest) for manifest in snakemake.input.parts])
