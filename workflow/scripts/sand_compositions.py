"""Write the compositions of all sands (snakemake script)."""

import json

from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.papers.paper_tables import write_data_frame
from splits.experiments.run import make_composition_table

experiments = {
    name: SimulationConfig.model_validate(content)
    for name, content in json.loads(snakemake.params.experiments).items()
}
write_data_frame(make_composition_table(experiments), snakemake.output[0])
