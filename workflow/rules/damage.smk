import re

from snakemake.logging import logger

from splits.core.atomic import remove_stale_files, rename_damaged_file
from splits.io.integrity import find_damage

IS_DRY_RUN = any(
    re.fullmatch(r"-[a-zA-Z]*n[a-zA-Z]*|--dry-?run", word) for word in sys.argv
)


def check_files():
    """Rename datasets that are damaged or of other experiments, and remove stale files.

    Renamed datasets are simulated again, since the job graph is made from the existing files.  A dry
    run only reports them.
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
            done = (
                "" if IS_DRY_RUN else f"; set aside as {rename_damaged_file(path).name}"
            )
            logger.warning(wrong + done)
    for folder in Path(RESULTS).glob("*") if not IS_DRY_RUN else ():
        remove_stale_files(folder)


if workflow.is_main_process:
    check_files()
