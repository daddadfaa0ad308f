from splits.experiments.archive import (
    REPOSITORY_FILES,
    get_packing_time,
    list_configuration_files,
    list_table_files,
)
from splits.experiments.config.sections import check_path

ARCHIVED = SETTINGS.select_archived(SELECTED)
ARCHIVED_NAMES = [name for name in ARCHIVED.experiments if name in EXPERIMENTS]
if "archive" in sys.argv[1:]:
    # Invalid values are rejected before anything runs.
    try:
        get_packing_time()
        CONFIGURATION_FILES = list_configuration_files(ARCHIVED).values()
        for path in map(str, [*CONFIGURATION_FILES, *list_table_files(ARCHIVED)]):
            check_path("archive", path)
    except ValueError as error:
        raise WorkflowError(str(error)) from None


rule archive:
    input:
        results=list_products(ARCHIVED_NAMES)
        + (
            list_study_products(SELECTED, SELECTED_GROUPS)
            if SETTINGS.archive == "all"
            else []
        ),
        configuration=lambda wildcards: list_configuration_files(ARCHIVED).values(),
        tables=lambda wildcards: list_table_files(ARCHIVED),
        software=[
            path
            for path in map(Path(workflow.basedir).joinpath, REPOSITORY_FILES)
            if path.is_file()
        ],
    output:
        f"{RESULTS}/archive/splits-results.zip",
    log:
        f"{RESULTS}/logs/archive.log",
    conda:
        "../../environment.yml"
    params:
        settings=ARCHIVED.model_dump(mode="json"),
        repository=lambda wildcards: str(workflow.basedir),
    message:
        "Packing results for deposit"
    script:
        "../scripts/archive.py"
