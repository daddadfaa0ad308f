"""Run one experiment (map snakemake to `splits.experiments.run`)."""

import sys

from splits import save
from splits.experiments.model import Accuracy, Experiment
from splits.experiments.run import run

with open(snakemake.log[0], "w", encoding="utf-8") as log:

    def say(line: str) -> None:
        """Show progress in the terminal and keep it in the log."""
        print(line, file=sys.stderr, flush=True)
        print(line, file=log, flush=True)

    dataset = run(
        Experiment.model_validate(snakemake.params.experiment),
        Accuracy.model_validate(snakemake.params.accuracy),
        seed=snakemake.params.seed,
        threads=snakemake.threads,
        say=say,
    )
    save(dataset, snakemake.output[0])
