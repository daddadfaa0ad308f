"""Pack results for deposit (map snakemake to `splits.archive`)."""

from splits.archive import pack

pack(snakemake.input, snakemake.params.configuration, snakemake.output[0])
