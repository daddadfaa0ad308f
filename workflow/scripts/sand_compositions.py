"""Compositions of all sands (map snakemake to `splits.experiments`)."""

from splits.analysis.tables import write_table
from splits.experiments.composition_table import composition_table
from splits.experiments.model import Experiment

experiments = {
    name: Experiment.model_validate({**content, "figure": "none"})
    for name, content in snakemake.params.experiments.items()
}
write_table(composition_table(experiments), snakemake.output[0])
