"""Run one experiment (map snakemake to `splits.experiments.run`)."""

import sys

from splits.interrupts import end_on_signals

end_on_signals(snakemake.wildcards.experiment)

from splits import save
from splits.analysis.measured import read_measured
from splits.experiments.run import run
from splits.experiments.run_fit import run_fit
from splits.experiments.settings import Accuracy
from splits.experiments.simulation import Simulation

with open(snakemake.log[0], "w", encoding="utf-8") as log:

    def say(line: str) -> None:
        """Show progress in the terminal and keep it in the log."""
        print(line, file=sys.stderr, flush=True)
        print(line, file=log, flush=True)

    experiment = Simulation.model_validate(snakemake.params.experiment)
    accuracy = Accuracy.model_validate(snakemake.params.accuracy)
    settings = {"seed": snakemake.params.seed, "threads": snakemake.threads, "say": say}
    if experiment.fit:
        measured = read_measured(snakemake.input.measured[0])
        dataset = run_fit(experiment, accuracy, measured, **settings)
    else:
        dataset = run(experiment, accuracy, **settings)
    save(dataset, snakemake.output[0])
