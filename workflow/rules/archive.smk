from splits.experiments.archive import get_packing_time, list_configuration_files

ARCHIVED = SETTINGS.select_archived(SELECTED)
ARCHIVED_NAMES = [name for name in ARCHIVED.experiments if name in EXPERIMENTS]
if "archive" in sys.argv[1:]:
    # Invalid values are rejected before anything runs.
    try:
        get_packing_time()
    except ValueError as error:
        raise WorkflowError(str(error)) from None
    for path in map(str, list_configuration_files(SETTINGS).values()):
        if {"{", "}"} & set(path):
            raise WorkflowError(f"archive = {path!r}: must be paths without {{ and }}")


rule archive:
    input:
        results=list_products(ARCHIVED_NAMES)
        + (
            list_study_products(SELECTED, SELECTED_GROUPS)
            if SETTINGS.archive == "all"
            else []
        ),
        configuration=lambda wildcards: list_configuration_files(ARCHIVED).values(),
        tables=lambda wildcards: sorted(
            {
                t
                for name in ARCHIVED_NAMES
                for t in EXPERIMENTS[name].list_table_paths()
            }
        ),
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
