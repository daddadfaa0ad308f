MAX_STDERR = SETTINGS.accuracies[SETTINGS.accuracy].max_stderr
for NAME, STUDY in COMPLETE_STUDIES.items():

    rule:
        name:
            NAME
        input:
            data=list_datasets(STUDY.inputs.values()),
            tables=list(STUDY.list_file_paths(SETTINGS.table_folders).values()),
        output:
            list_study_outputs([NAME]),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        # A study of the selected experiments, not of datasets: jobs of a cluster cannot select them,
        # since they have no targets.
        localrule: not STUDY.inputs
        conda:
            "../../environment.yml"
        threads: lambda wildcards, study=STUDY: choose_study_threads(study)
        params:
            # Without texts, on which the products do not depend.
            study=escape_param(
                STUDY.model_dump(
                    mode="json", exclude={"outputs", "group", "reproduces"}
                )
            ),
            outputs=list(STUDY.list_outputs(NAME)),
            run=lambda wildcards, study=STUDY: escape_json(list_run_values(study)),
            function=lambda wildcards, study=STUDY: hash_function(study.function),
            sources=hash_sources(provenance.STUDY_SOURCES),
            physics=hash_physics_sources(),
        message:
            f"Making {NAME}"
        script:
            "../scripts/study.py"
