"""Run one experiment (map snakemake to `splits.experiments.run`)."""

import sys

from splits import save
from splits.analysis.measured import read_measured
from splits.experiments.model import Experiment
from splits.experiments.run import run
from splits.experiments.run_fit import run_fit
from splits.experiments.settings import Accuracy

with open(snakemake.log[0], "w", encoding="utf-8") as log:

    def say(line: str) -> None:
        """Show progress in the terminal and keep it in the log."""
        print(line, file=sys.stderr, flush=True)
        print(line, file=log, flush=True)

    # What its figure may show was checked when the file was read, and does not matter here.
    experiment = Experiment.model_validate({**snakemake.params.experiment, "figure": "none"})
    accuracy = Accuracy.model_validate(snakemake.params.accuracy)
    settings = {"seed": snakemake.params.seed, "threads": snakemake.threads, "say": say}
    if experiment.fit:
        measured = read_measured(snakemake.input.measured[0])
        dataset = run_fit(experiment, accuracy, measured, **settings)
    else:
        dataset = run(experiment, accuracy, **settings)
    save(dataset, snakemake.output[0])
