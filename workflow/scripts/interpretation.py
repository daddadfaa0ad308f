"""Rank the interpretations of a paper (snakemake script)."""

from pathlib import Path

from splits.core.interrupts import exit_on_signals

exit_on_signals("interpretation")

from splits.analysis.measured import read_published
from splits.core.progress import open_progress_log
from splits.experiments.papers.interpretation_ranking import rank_interpretations
from splits.experiments.papers.interpretation_tables import (
    find_differing_keys,
    make_leave_out_table,
    make_ranking_table,
    make_statement_table,
)
from splits.experiments.papers.paper_tables import write_data_frame
from splits.plotting import draw_interpretation_shifts, save_figure

with open_progress_log(snakemake.log[0]) as log:
    choices, text = snakemake.params.interpretation, snakemake.params.stated
    combinations, stated = rank_interpretations(
        read_published(snakemake.input.published), choices, text, snakemake.params.seed,
        snakemake.threads, snakemake.params.stderr_scale, log,
    )  # fmt: skip
names = find_differing_keys(combinations)
table = make_statement_table(combinations, stated, names)
write_data_frame(make_ranking_table(combinations, stated, choices, text), snakemake.output.table)
write_data_frame(table, snakemake.output.statements)
write_data_frame(make_leave_out_table(combinations, stated, names), snakemake.output.without)
save_figure(draw_interpretation_shifts(table), Path(snakemake.output.figure[0]).with_suffix(""))
