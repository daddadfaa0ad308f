"""Read measured spectra in a table (map snakemake to `splits.experiments.run_retrieve`)."""

from pathlib import Path

import splits
from splits.analysis.measured import read_spectra
from splits.analysis.tables import write_table
from splits.experiments.retrieve_section import RetrieveSection
from splits.experiments.run_retrieve import retrieved_table, run_retrieve, together
from splits.figures.retrievals import retrievals
from splits.figures.style import save_figure
from splits.progress_log import progress_log

with progress_log(snakemake.log[0]) as say:
    section = RetrieveSection.model_validate_json(snakemake.params.retrieve)
    found = run_retrieve(
        section,
        splits.open_table(snakemake.input.table),
        read_spectra(snakemake.input.measured[0]),
        snakemake.params.seed,
        say,
    )
    write_table(retrieved_table(found, section.known), snakemake.output.table)
    joined = together(found, snakemake.wildcards.experiment)
    figure = retrievals(joined, section.known, section.list_sample_prefixes())
    save_figure(figure, Path(snakemake.output.figure[0]).with_suffix(""))
