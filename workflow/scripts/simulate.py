"""Run an experiment (snakemake script)."""

from splits.core.process import exit_on_signals

exit_on_signals(
    snakemake.wildcards.experiment,
    "simulated points are kept, and the same command resumes from them",
)

from pathlib import Path

from splits.core.progress import open_progress_log
from splits.experiments.config.load import locate_job_errors
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run import write_run

with (
    open_progress_log(snakemake.log[0]) as log,
    locate_job_errors(snakemake.config, snakemake.wildcards.experiment),
):
    experiment = SimulationConfig.model_validate(snakemake.params.experiment)
    accuracy = Accuracy.model_validate(snakemake.params.accuracy)
    settings = {"seed": snakemake.params.seed, "threads": snakemake.threads, "log": log}
    folder, target = Path(snakemake.params.kept), Path(snakemake.output[0])
    write_run(experiment, accuracy, folder=folder, path=target, **settings)
