"""Write the report (snakemake script)."""

from splits.experiments.report.page import write_report

write_report(snakemake.params.contents, snakemake.output[0])
