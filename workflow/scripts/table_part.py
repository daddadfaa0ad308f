"""Simulate a part of a table (snakemake script)."""

from pathlib import Path

from splits.core.process import exit_on_signals

exit_on_signals(snakemake.wildcards.experiment)

from splits.core.progress import open_progress_log
from splits.experiments.config.load import locate_job_errors
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run_table import run_part, write_part_manifest

manifest, part = Path(snakemake.output[0]), int(snakemake.wildcards.part)
with (
    open_progress_log(snakemake.log[0]) as log,
    locate_job_errors(snakemake.config, snakemake.wildcards.experiment),
):
    experiment = SimulationConfig.model_validate(snakemake.params.experiment)
    accuracy = Accuracy.model_validate(snakemake.params.accuracy)
    blocks = run_part(
        experiment,
        accuracy,
        snakemake.params.seed,
        manifest.parent,
        part,
        snakemake.threads,
        log,
    )
    write_part_manifest(blocks, manifest)
