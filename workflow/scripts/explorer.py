"""Write the explorer of tables (map snakemake to `splits.explorer.page`)."""

import splits
from splits.explorer.page import Shown, write_page

where = snakemake.params.directions
write_page(
    {
        label: Shown(
            splits.open_table(snakemake.input[name]),
            snakemake.input[name],
            snakemake.params.about[name],
            splits.load(snakemake.input[where[label]]) if label in where else None,
        )
        for label, name in snakemake.params.explorer.items()
    },
    snakemake.output[0],
)
