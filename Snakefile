"""Workflow that runs all experiments and studies of config/ and writes a report on them.

snakemake --cores 2                             the papers, and your own experiments
snakemake --cores 2 explorer                    another group of experiments
snakemake --cores 2 everything                  all groups
snakemake --cores 2 fig08_grain_size            one experiment or study
snakemake --cores 2 --config accuracy=draft     results at low accuracy
"""

import os
import sys
from pathlib import Path

from snakemake.exceptions import WorkflowError
from snakemake.utils import update_config

from splits.core.process import forward_interrupts
from splits.core.validation import ConfigError
from splits.core.yaml import read_yaml
from splits.experiments import load_experiments, load_settings
from splits.experiments.config.load import select_experiments

# Functions of studies are in workflow/, or in any other module.
sys.path.insert(0, str(workflow.basedir))

# Otherwise snakemake would wait for running jobs to complete.
forward_interrupts()

# Jobs already use all cores in parallel. Multithreaded linear algebra in each of them would be many
# times slower.
for library in ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "VECLIB_MAXIMUM"):
    os.environ.setdefault(f"{library}_THREADS", "1")


configfile: "config/config.yaml"


# Snakemake has parsed the files as YAML 1.1, where 045 is 37 and 1:15 is 75. They are parsed again
# as YAML 1.2.
COMMAND_LINE = workflow.config_settings
DEFAULT_FILES = workflow.configfiles[len(COMMAND_LINE.configfiles) :]
try:
    config.clear()
    FILES = [
        *([] if COMMAND_LINE.replace_workflow_config else DEFAULT_FILES),
        *COMMAND_LINE.configfiles,
    ]
    for FILE in FILES:
        update_config(config, read_yaml(Path(FILE)))
    update_config(config, COMMAND_LINE.config)
    if "everything" in sys.argv[1:]:
        if "experiments" in COMMAND_LINE.config:
            raise ConfigError(
                "experiments: must be left out with the target everything"
            )
        config["experiments"] = "everything"
    SETTINGS = load_settings(config, *FILES)
    EXPERIMENTS = load_experiments(
        SETTINGS.experiments_folder, SETTINGS.media_folder, SETTINGS.measured_folder
    )
    SELECTED = select_experiments(SETTINGS, EXPERIMENTS, config, *FILES)
except ConfigError as error:
    raise WorkflowError(str(error)) from None

RESULTS = SETTINGS.results_folder


include: "workflow/rules/common.smk"
include: "workflow/rules/simulate.smk"
include: "workflow/rules/tables.smk"
include: "workflow/rules/figures.smk"
include: "workflow/rules/retrieve.smk"
include: "workflow/rules/explorer.smk"
include: "workflow/rules/study.smk"
include: "workflow/rules/archive.smk"
include: "workflow/rules/benchmark.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/update_docs.smk"


rule all:
    default_target: True
    input:
        # A missing product is made even if the report, which shows it, exists.
        REPORTED,
        f"{RESULTS}/report.html",


rule everything:
    input:
        rules.all.input,


for GROUP in dict.fromkeys([*GROUPS, "papers", "own", "explorer"]):

    rule:
        name:
            GROUP
        input:
            list_products(GROUPS.get(GROUP, [])),
            list_group_studies(GROUP),
            list_explorer(EXPERIMENTS if GROUP == "explorer" else GROUPS.get(GROUP, [])),
            REPORTED_BENCHMARKS if GROUP == "papers" else [],


for NAME in EXPERIMENTS:

    rule:
        name:
            NAME
        input:
            list_products([NAME]),
