MAX_STDERR = SETTINGS.accuracies[SETTINGS.accuracy].max_stderr
for NAME in COMPLETE_STUDIES:

    rule:
        name:
            NAME
        input:
            **list_study_inputs(NAME),
        output:
            **format_study_outputs(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: choose_study_threads(NAME)
        params:
            study=escape_param(
                STUDIES[NAME].model_dump(mode="json", exclude={"reproduces"})
            ),
            parameters=escape_param(
                STUDIES[NAME].list_parameters(SETTINGS.seed, MAX_STDERR, SELECTED)
            ),
            inputs=list(list_study_datasets(NAME)),
            files=list(STUDIES[NAME].list_file_paths(SETTINGS.table_folders)),
        message:
            STUDIES[NAME].MESSAGE
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
    message:
        "Listing the sands fitted by {wildcards.experiment}"
    script:
        "../scripts/fitted_parameters.py"
