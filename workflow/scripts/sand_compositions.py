"""Compositions of all sands (map snakemake to `splits.experiments`)."""

import json

from splits.analysis.tables import write_table
from splits.experiments.composition_table import composition_table
from splits.experiments.simulation import Simulation

experiments = {
    name: Simulation.model_validate(content)
    for name, content in json.loads(snakemake.params.experiments).items()
}
write_table(composition_table(experiments), snakemake.output[0])
