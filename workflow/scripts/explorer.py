"""Write the explorer of tables (map snakemake to `splits.explorer.page`)."""

import splits
from splits.explorer.page import Shown, write_page

write_page(
    {
        label: Shown(
            splits.open_table(snakemake.input[name]),
            snakemake.input[name],
            snakemake.params.about[name],
        )
        for label, name in snakemake.params.explorer.items()
    },
    snakemake.output[0],
)
