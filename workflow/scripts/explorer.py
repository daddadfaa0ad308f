"""Write the explorer of tables (snakemake script)."""

import splits
from splits.io.netcdf import exit_if_damaged
from splits.plotting.explorer.page import ExplorerTable, write_explorer

exit_if_damaged(snakemake.input)
inputs, params = snakemake.input, snakemake.params
directions = {
    label: splits.load(path)
    for label, path in zip(params.directions, inputs.directions, strict=True)
}
tables = zip(params.labels, inputs.tables, params.about, strict=True)
write_explorer(
    {
        label: ExplorerTable(splits.Table(path), path, description, directions.get(label))
        for label, path, description in tables
    },
    snakemake.output[0],
)
