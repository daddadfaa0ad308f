"""Pack results for deposit (map snakemake to `splits.archive`)."""

from splits.archive import configuration_members, pack
from splits.experiments.settings import Settings

configuration = configuration_members(Settings.model_validate(snakemake.params.settings))
pack(snakemake.input.results, configuration, snakemake.output[0], snakemake.params.lock)
