"""Write the explorer of tables (map snakemake to `splits.plotting.explorer.page`)."""

import splits
from splits.plotting.explorer.page import ExplorerTable, write_explorer

given, asked = snakemake.input, snakemake.params
directions = {
    label: splits.load(path) for label, path in zip(asked.directions, given.directions, strict=True)
}
tables = zip(asked.labels, given.tables, asked.about, strict=True)
write_explorer(
    {
        label: ExplorerTable(splits.open_table(path), path, about, directions.get(label))
        for label, path, about in tables
    },
    snakemake.output[0],
)
