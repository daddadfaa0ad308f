from snakemake.logging import logger

from splits.core.atomic import remove_stale_files, rename_damaged_file
from splits.io.integrity import find_damage


def check_files(renames):
    """Report datasets that are damaged or of other experiments, or rename them and clean up.

    Renamed datasets are simulated again, since the job graph is made from the existing files.
    """
    products = list_study_products(EXPERIMENTS, GROUPS)
    studies = [path for path in products if path.endswith(".nc")]
    for path in map(Path, list_datasets(EXPERIMENTS) + studies):
        experiment = path.stem if path.stem in EXPERIMENTS else ""
        try:
            wrong = find_damage(path, experiment) if path.is_file() else ""
        except OSError as error:
            raise WorkflowError(str(error)) from None
        if wrong:
            new = f"; set aside as {rename_damaged_file(path).name}" if renames else ""
            logger.warning(wrong + new)
    for folder in Path(RESULTS).glob("*") if renames else ():
        remove_stale_files(folder)


def execute_workflow(*args, executor_plugin, execute=workflow.execute, **settings):
    """Check the files and execute the workflow.

    Commands that run no job, such as `--summary`, do not execute it; a dry run only reports.
    """
    common = executor_plugin.common_settings
    check_files(renames=not (common.dryrun_exec or common.touch_exec))
    return execute(*args, executor_plugin=executor_plugin, **settings)


# The executor is unknown before the execution, and jobs are determined at its beginning.
if workflow.is_main_process:
    workflow.execute = execute_workflow
