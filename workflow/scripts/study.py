"""Make the tables and figures of a study (snakemake script)."""

import json

from splits.core.process import exit_on_signals

exit_on_signals(snakemake.rule)

from splits.core.progress import open_progress_log
from splits.experiments.studies import STUDY_KINDS
from splits.experiments.studies.study import StudyRun
from splits.io.netcdf import exit_if_damaged

exit_if_damaged(snakemake.input)
content = json.loads(snakemake.params.study)
study = STUDY_KINDS[content["kind"]].model_validate(content)
with open_progress_log(snakemake.log[0]) as log:
    study.make(
        StudyRun(
            datasets=dict(zip(snakemake.params.inputs, snakemake.input.data, strict=True)),
            files=dict(zip(snakemake.params.files, snakemake.input.files, strict=True)),
            readers={key: file.read for key, file in study.FILES.items()},
            outputs={key: list(paths) for key, paths in snakemake.output.items()},
            parameters=json.loads(snakemake.params.parameters),
            threads=snakemake.threads,
            log=log,
        )
    )
