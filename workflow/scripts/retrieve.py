"""Retrieve parameters from measured spectra with a table (snakemake script)."""

from pathlib import Path

import splits
from splits.analysis.measured import read_spectra
from splits.core.progress import open_progress_log
from splits.experiments.config.retrieve import RetrieveSection
from splits.experiments.papers.paper_tables import write_data_frame
from splits.experiments.run_retrieve import combine_samples, make_retrieval_table, run_retrieve
from splits.plotting.retrieval import draw_retrievals
from splits.plotting.style import save_figure

with open_progress_log(snakemake.log[0]) as log:
    section = RetrieveSection.model_validate_json(snakemake.params.retrieve)
    retrievals = run_retrieve(
        section,
        splits.open_table(snakemake.input.table),
        read_spectra(snakemake.input.measured[0]),
        snakemake.params.seed,
        log,
    )
    write_data_frame(
        make_retrieval_table(retrievals, section.reference_values), snakemake.output.table
    )
    joined = combine_samples(retrievals, snakemake.wildcards.experiment)
    figure = draw_retrievals(joined, section.reference_values, section.list_sample_prefixes())
    save_figure(figure, Path(snakemake.output.figure[0]).with_suffix(""))
