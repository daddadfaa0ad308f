"""Hold combinations of readings against a paper (map snakemake to `splits.experiments`)."""

from pathlib import Path

from splits.interrupts import end_on_signals

end_on_signals("readings")

from splits.analysis.agreement import read_published
from splits.analysis.tables import write_table
from splits.experiments.rank_readings import rank_readings
from splits.experiments.ranking_tables import left_out, ranking, statements, telling
from splits.figures import readings_shifts, save_figure
from splits.progress_log import progress_log

with progress_log(snakemake.log[0]) as say:
    choices, text = snakemake.params.readings, snakemake.params.text
    combinations, stated = rank_readings(
        read_published(snakemake.input.published), choices, text, snakemake.params.seed,
        snakemake.threads, snakemake.params.error_factor, say,
    )  # fmt: skip
names = telling(combinations)
table = statements(combinations, stated, names)
write_table(ranking(combinations, stated, choices, text), snakemake.output.table)
write_table(table, snakemake.output.statements)
write_table(left_out(combinations, stated, names), snakemake.output.without)
save_figure(readings_shifts(table), Path(snakemake.output.figure[0]).with_suffix(""))
