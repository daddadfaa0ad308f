for NAME in list_studies_of_kind("sensitivity"):

    rule:
        name:
            NAME
        input:
            **list_study_files(NAME),
            data=list_datasets(STUDIES[NAME].list_experiments()),
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: 1
        params:
            pairs=escape_param(
                {key: pair.model_dump() for key, pair in STUDIES[NAME].pairs.items()}
            ),
        message:
            "Computing mean sensitivity indices"
        script:
            "../scripts/sensitivity.py"


for NAME in list_studies_of_kind("agreement"):

    rule:
        name:
            NAME
        input:
            **list_study_files(NAME),
            data=list_datasets(STUDIES[NAME].inputs.values()),
            sensitivity=format_study_output(STUDIES[NAME].sensitivity)["data"],
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: 1
        params:
            roles=list(STUDIES[NAME].inputs),
        message:
            "Comparing results with published and measured numbers"
        script:
            "../scripts/agreement.py"


for NAME in list_studies_of_kind("sand_tables"):

    rule:
        name:
            NAME
        input:
            data=list_datasets(STUDIES[NAME].inputs.values()),
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: 1
        params:
            roles=list(STUDIES[NAME].inputs),
        message:
            "Comparing sand with the trends stated in SPLITS"
        script:
            "../scripts/sand_tables.py"


for NAME in list_studies_of_kind("angular_trends"):

    rule:
        name:
            NAME
        input:
            data=list_datasets(STUDIES[NAME].inputs.values()),
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: 1
        params:
            roles=list(STUDIES[NAME].inputs),
        message:
            "Comparing BRDFs with the trends stated in the papers"
        script:
            "../scripts/angular_trends.py"


for NAME in list_studies_of_kind("layer_trends"):

    rule:
        name:
            NAME
        input:
            data=list_datasets(STUDIES[NAME].inputs.values()),
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: 1
        params:
            roles=list(STUDIES[NAME].inputs),
        message:
            "Comparing rough layers with the statements of their paper"
        script:
            "../scripts/layer_trends.py"


for NAME in list_studies_of_kind("interpretation"):

    rule:
        name:
            NAME
        input:
            **list_study_files(NAME),
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: lambda wildcards: count_cores()
        params:
            physics=hash_physics_sources(),
            interpretation=STUDIES[NAME].interpretation,
            stated=STUDIES[NAME].stated,
            seed=SETTINGS.seed,
            stderr_scale=SETTINGS.accuracies[SETTINGS.accuracy].max_stderr / 0.002,
        message:
            "Ranking the interpretations of the paper"
        script:
            "../scripts/interpretation.py"


for NAME in list_studies_of_kind("surface_area"):

    rule:
        name:
            NAME
        input:
            **list_study_files(NAME),
            data=list_datasets(STUDIES[NAME].inputs.values()),
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: 1
        params:
            roles=list(STUDIES[NAME].inputs),
        message:
            "Retrieving the surface area of measured snow"
        script:
            "../scripts/surface_area.py"


for NAME in list_studies_of_kind("anisotropy"):

    rule:
        name:
            NAME
        input:
            **list_study_files(NAME),
            data=list_datasets(STUDIES[NAME].inputs.values()),
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: 1
        message:
            "Comparing modelled and measured directions"
        script:
            "../scripts/anisotropy.py"


for NAME in list_studies_of_kind("sobol"):

    rule:
        name:
            NAME
        input:
            data=list_datasets(STUDIES[NAME].inputs.values()),
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: 1
        params:
            names=list(STUDIES[NAME].inputs),
            seed=SETTINGS.seed,
            program=hash_files(PACKAGE_FOLDER, RETRIEVAL_SOURCES),
        message:
            "Computing Sobol indices of tables"
        script:
            "../scripts/sobol.py"


for NAME in list_studies_of_kind("bands"):

    rule:
        name:
            NAME
        input:
            data=list_datasets(STUDIES[NAME].inputs.values()),
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: 1
        params:
            names=list(STUDIES[NAME].inputs),
            bands=STUDIES[NAME].bands,
            noise=STUDIES[NAME].noise,
            n_bands=STUDIES[NAME].n_bands,
            fixed=escape_param(STUDIES[NAME].fixed),
            seed=SETTINGS.seed,
            program=hash_files(PACKAGE_FOLDER, RETRIEVAL_SOURCES),
        message:
            "Selecting the most informative bands"
        script:
            "../scripts/bands.py"


for NAME in list_studies_of_kind("sand_compositions"):

    rule:
        name:
            NAME
        output:
            **format_study_output(NAME),
        log:
            f"{RESULTS}/logs/{NAME}.log",
        benchmark:
            f"{RESULTS}/benchmarks/{NAME}.tsv"
        conda:
            "../../environment.yml"
        threads: 1
        params:
            physics=hash_physics_sources(),
            experiments=escape_param(
                {
                    name: e.dump_simulation()
                    for name, e in EXPERIMENTS.items()
                    if e.medium.get("kind") == "sand"
                }
            ),
        message:
            "Listing the compositions of all sands"
        script:
            "../scripts/sand_compositions.py"


rule fitted_parameters:
    input:
        f"{RESULTS}/data/{{experiment}}.nc",
    output:
        report(
            f"{RESULTS}/tables/{{experiment}}_parameters.csv",
            caption="../report/fits.rst",
            category="Sand",
            labels={"experiment": "{experiment}"},
        ),
    log:
        f"{RESULTS}/logs/fitted_parameters/{{experiment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/fitted_parameters/{{experiment}}.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    message:
        "Listing the sands fitted by {wildcards.experiment}"
    script:
        "../scripts/fitted_parameters.py"
