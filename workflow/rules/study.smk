MAX_STDERR = SETTINGS.accuracies[SETTINGS.accuracy].max_stderr
for NAME, STUDY in COMPLETE_STUDIES.items():

    rule:
        name:
            NAME
        input:
            data=list(list_study_datasets(NAME).values()),
            files=list(STUDY.list_file_paths(SETTINGS.table_folders).values()),
        output:
            **list_study_outputs(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        # Without datasets, a study is a table of the selected experiments, which jobs of a cluster
        # cannot derive: they have no targets.
        localrule: not list_study_datasets(NAME)
        conda:
            "../../environment.yml"
        threads: count_cores() if STUDY.USES_ALL_THREADS else 1
        params:
            study=escape_param(STUDY.model_dump(mode="json", exclude=STUDY.TEXT_KEYS)),
            parameters=escape_param(
                STUDY.list_parameters(SETTINGS.seed, MAX_STDERR, SELECTED)
            ),
            sources=hash_sources(STUDY.list_sources()),
            inputs=list(list_study_datasets(NAME)),
            files=list(STUDY.list_file_paths(SETTINGS.table_folders)),
        message:
            STUDY.MESSAGE
        script:
            "../scripts/study.py"


rule fitted_parameters:
    input:
        f"{RESULTS}/data/{{experiment}}.nc",
    output:
        f"{RESULTS}/tables/{{experiment}}_parameters.csv",
    log:
        f"{RESULTS}/logs/fitted_parameters/{{experiment}}.log",
    conda:
        "../../environment.yml"
    params:
        sources=hash_sources(["experiments/papers"]),
    message:
        "Listing the sands fitted by {wildcards.experiment}"
    script:
        "../scripts/fitted_parameters.py"
