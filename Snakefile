"""Workflow that runs all experiments and studies of config/ and draws their figures.

snakemake --cores 2                             all results
snakemake --cores 2 fig08_grain_size            one experiment or study
snakemake --cores 2 --config accuracy=draft     all results at low accuracy
"""

import os
import sys
from pathlib import Path

from snakemake.exceptions import WorkflowError
from snakemake.utils import update_config

from splits.core.interrupts import forward_interrupts
from splits.experiments import ConfigError, load_experiments, load_settings, read_yaml

# Otherwise snakemake would wait for running jobs to complete.
forward_interrupts()

# Jobs already use all cores in parallel. Multithreaded linear algebra in each of them would be many
# times slower.
for library in ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "VECLIB_MAXIMUM"):
    os.environ.setdefault(f"{library}_THREADS", "1")


configfile: "config/config.yaml"


report: "workflow/report/workflow.rst"


# Snakemake has parsed the files as YAML 1.1, where 045 is 37 and 1:15 is 75. They are parsed again
# as YAML 1.2.
COMMAND_LINE = workflow.config_settings
DEFAULT_FILES = workflow.configfiles[len(COMMAND_LINE.configfiles) :]
try:
    config.clear()
    for FILE in [
        *([] if COMMAND_LINE.replace_workflow_config else DEFAULT_FILES),
        *COMMAND_LINE.configfiles,
    ]:
        update_config(config, read_yaml(Path(FILE)))
    update_config(config, COMMAND_LINE.config)
    SETTINGS = load_settings(config)
    AVAILABLE = load_experiments(
        SETTINGS.experiments_folder, SETTINGS.media_folder, SETTINGS.measured_folder
    )
    EXPERIMENTS = SETTINGS.select_experiments(AVAILABLE)
except ConfigError as error:
    raise WorkflowError(str(error)) from None

RESULTS = SETTINGS.results_folder


include: "workflow/rules/common.smk"
include: "workflow/rules/damage.smk"
include: "workflow/rules/simulate.smk"
include: "workflow/rules/tables.smk"
include: "workflow/rules/figures.smk"
include: "workflow/rules/retrieve.smk"
include: "workflow/rules/explorer.smk"
include: "workflow/rules/study.smk"
include: "workflow/rules/archive.smk"
include: "workflow/rules/benchmark.smk"
include: "workflow/rules/update_docs.smk"


onstart:
    # A study of which only some experiments are selected is reported, since this may be unintended.
    for name, line in INCOMPLETE_STUDIES.items():
        if set(STUDIES[name].list_experiments()) & set(EXPERIMENTS):
            logger.info(line)
    if MISSING_EXPLORER_TABLES and set(SETTINGS.explorer.values()) & set(
        EXPERIMENTS
    ):
        logger.info(
            f"the explorer is left out: {'; '.join(MISSING_EXPLORER_TABLES)}"
        )
    elif EXPLORER_TABLES and MISSING_DIRECTIONS:
        logger.info(
            f"the explorer has no directions: {'; '.join(MISSING_DIRECTIONS)}"
        )


rule all:
    default_target: True
    input:
        [list_products(name) for name in EXPERIMENTS],
        list_study_products(),
        REPORTED,
        [f"{RESULTS}/explorer.html"] if EXPLORER_TABLES else [],


for NAME in EXPERIMENTS:

    rule:
        name:
            NAME
        input:
            list_products(NAME),
