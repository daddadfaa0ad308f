"""Compute mean sensitivity indices (snakemake script)."""

import json
from pathlib import Path

from splits import load, save
from splits.analysis.measured import read_published
from splits.experiments.papers.paper_tables import write_data_frame
from splits.experiments.papers.sensitivity_table import (
    describe_ranges,
    make_sensitivity_table,
    select_chosen_sensitivities,
)
from splits.plotting import draw_sensitivity_bars, save_figure

pairs = json.loads(snakemake.params.pairs)
datasets = {Path(path).stem: load(path) for path in snakemake.input.data}
table = make_sensitivity_table(datasets, pairs)
published = snakemake.input.get("published")
chosen = select_chosen_sensitivities(table, read_published(published) if published else None)
write_data_frame(table, snakemake.output.table)
write_data_frame(chosen.to_dataframe().reset_index(), snakemake.output.chosen)
save(chosen, snakemake.output.data)
figure = draw_sensitivity_bars(chosen, describe_ranges(pairs))
save_figure(figure, Path(snakemake.output.figure[0]).with_suffix(""))
