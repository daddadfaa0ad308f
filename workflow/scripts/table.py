"""Put a table together from its blocks (map snakemake to `splits.experiments.run_table`)."""

import sys
from pathlib import Path

from splits.interrupts import end_on_signals

end_on_signals(snakemake.wildcards.experiment)

from splits import save
from splits.experiments.run_table import run_table
from splits.experiments.settings import Accuracy
from splits.experiments.simulation import Simulation

with open(snakemake.log[0], "w", encoding="utf-8") as log:

    def say(line: str) -> None:
        """Show progress in the terminal and keep it in the log."""
        print(line, file=sys.stderr, flush=True)
        print(line, file=log, flush=True)

    dataset = run_table(
        Simulation.model_validate(snakemake.params.experiment),
        Accuracy.model_validate(snakemake.params.accuracy),
        snakemake.params.seed,
        Path(snakemake.input[0]).parent,
        snakemake.threads,
        say,
    )
    save(dataset, snakemake.output[0])
