"""Pack results for deposit (map snakemake to `splits.archive`)."""

from splits.archive import configuration_members, pack
from splits.experiments.settings import Settings

settings = Settings.model_validate(snakemake.params.settings)
pack(
    snakemake.input.results,
    configuration_members(settings),
    snakemake.output[0],
    snakemake.params.repository,
    settings.archive_license,
    settings.list_authors(),
)
