"""Draw the figure of an experiment (snakemake script)."""

import json
from pathlib import Path

from splits import load
from splits.analysis.measured import read_spectra
from splits.core.progress import open_progress_log
from splits.experiments.config.experiment import draw_figure
from splits.experiments.config.load import locate_job_errors
from splits.io.netcdf import exit_if_damaged
from splits.plotting import save_figure

exit_if_damaged(snakemake.input)
with (
    open_progress_log(snakemake.log[0]),
    locate_job_errors(snakemake.config, snakemake.wildcards.experiment),
):
    settings = json.loads(snakemake.params.figure)
    for path in snakemake.input.measured:
        settings["measured"] = read_spectra(path)
    figure = draw_figure(load(snakemake.input.data), settings)
    save_figure(figure, Path(snakemake.output[0]).with_suffix(""))
