"""Write the explorer of tables (map snakemake to `splits.explorer.page`)."""

import splits
from splits.explorer.page import Shown, write_page

given, asked = snakemake.input, snakemake.params
directions = {
    label: splits.load(path) for label, path in zip(asked.directions, given.directions, strict=True)
}
tables = zip(asked.labels, given.tables, asked.about, strict=True)
write_page(
    {
        label: Shown(splits.open_table(path), path, about, directions.get(label))
        for label, path, about in tables
    },
    snakemake.output[0],
)
