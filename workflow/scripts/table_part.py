"""Measure a part of a table (map snakemake to `splits.experiments.run_table`)."""

from pathlib import Path

from splits.interrupts import end_on_signals

end_on_signals(snakemake.wildcards.experiment)

from splits.experiments.run_table import note_part, run_part
from splits.experiments.settings import Accuracy
from splits.experiments.simulation import Simulation
from splits.progress_log import progress_log

made, part = Path(snakemake.output[0]), int(snakemake.wildcards.part)
with progress_log(snakemake.log[0]) as say:
    experiment = Simulation.model_validate(snakemake.params.experiment)
    accuracy = Accuracy.model_validate(snakemake.params.accuracy)
    blocks = run_part(
        experiment,
        accuracy,
        snakemake.params.seed,
        made.parent,
        part,
        snakemake.threads,
        say,
    )
    note_part(blocks, made)
