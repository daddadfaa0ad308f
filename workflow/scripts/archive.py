"""Write the archive of results for deposit (snakemake script)."""

from splits.experiments.archive import make_configuration_members, pack_archive
from splits.experiments.config.settings import Settings
from splits.io.netcdf import exit_if_damaged

exit_if_damaged(snakemake.input)
settings = Settings.model_validate(snakemake.params.settings)
pack_archive(
    snakemake.input.results,
    make_configuration_members(settings),
    snakemake.output[0],
    snakemake.params.repository,
    settings.archive_license,
    settings.list_authors(),
)
