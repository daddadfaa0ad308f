"""Measure a part of a table (map snakemake to `splits.experiments.run_table`)."""

import sys
from pathlib import Path

from splits.interrupts import end_on_signals

end_on_signals(snakemake.wildcards.experiment)

from splits.experiments.run_table import note_part, run_part
from splits.experiments.settings import Accuracy
from splits.experiments.simulation import Simulation

made, part = Path(snakemake.output[0]), int(snakemake.wildcards.part)
with open(snakemake.log[0], "w", encoding="utf-8") as log:

    def say(line: str) -> None:
        """Show progress in the terminal and keep it in the log."""
        print(line, file=sys.stderr, flush=True)
        print(line, file=log, flush=True)

    experiment = Simulation.model_validate(snakemake.params.experiment)
    accuracy = Accuracy.model_validate(snakemake.params.accuracy)
    run_part(
        experiment,
        accuracy,
        snakemake.params.seed,
        made.parent,
        part,
        snakemake.threads,
        say,
    )
    note_part(experiment, made.parent, part, made)
