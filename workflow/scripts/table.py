"""Put a table together from its blocks (map snakemake to `splits.experiments.run_table`)."""

from pathlib import Path

from splits.interrupts import end_on_signals

end_on_signals(snakemake.wildcards.experiment)

from splits.experiments.run_table import drop_unused, write_table
from splits.experiments.settings import Accuracy
from splits.experiments.simulation import Simulation
from splits.progress_log import progress_log

with progress_log(snakemake.log[0]) as say:
    write_table(
        Simulation.model_validate(snakemake.params.experiment),
        Accuracy.model_validate(snakemake.params.accuracy),
        snakemake.params.seed,
        Path(snakemake.input[0]).parent,
        Path(snakemake.output[0]),
        snakemake.threads,
        say,
    )
drop_unused([Path(note) for note in snakemake.input])
