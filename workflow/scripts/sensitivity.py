"""Take mean sensitivity indices (map snakemake to `splits.analysis`)."""

import json
from pathlib import Path

from splits import load, save
from splits.analysis.agreement import read_published
from splits.analysis.sensitivity_tables import (
    chosen_sensitivities,
    ranges_said,
    sensitivity_table,
)
from splits.analysis.tables import write_table
from splits.figures import save_figure, sensitivity_bars

pairs = json.loads(snakemake.params.pairs)
datasets = {Path(path).stem: load(path) for path in snakemake.input.data}
table = sensitivity_table(datasets, pairs)
published = snakemake.input.get("published")
chosen = chosen_sensitivities(table, read_published(published) if published else None)
write_table(table, snakemake.output.table)
write_table(chosen.to_dataframe().reset_index(), snakemake.output.chosen)
save(chosen, snakemake.output.data)
figure = sensitivity_bars(chosen, ranges_said(pairs))
save_figure(figure, Path(snakemake.output.figure[0]).with_suffix(""))
