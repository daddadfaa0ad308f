"""Write the report (snakemake script)."""

from splits.experiments.report.contents import ReportContents
from splits.experiments.report.page import write_report

contents = ReportContents.model_validate_json(snakemake.params.contents)
write_report(contents, snakemake.output[0])
