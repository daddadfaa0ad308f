rule retrieve:
    input:
        table=f"{RESULTS}/data/{{experiment}}.nc",
        measured=lambda wildcards: list_measured_files(wildcards.experiment, "retrieve"),
    output:
        table=f"{RESULTS}/tables/{{experiment}}_retrieved.csv",
        figure=multiext(f"{RESULTS}/figures/{{experiment}}", *FIGURE_SUFFIXES),
    log:
        f"{RESULTS}/logs/retrieve/{{experiment}}.log",
    wildcard_constraints:
        experiment=match_any(
            set(EXPERIMENTS_WITH_RETRIEVAL) - set(EXPERIMENTS_WITH_RETURNS)
        ),
    conda:
        "../../environment.yml"
    params:
        retrieve=lambda wildcards: escape_json(
            EXPERIMENTS[wildcards.experiment].retrieve.model_dump(mode="json")
        ),
        seed=SETTINGS.seed,
        program=hash_sources(provenance.RETRIEVAL_SOURCES + provenance.FIGURE_SOURCES),
    message:
        "Retrieving parameters for {wildcards.experiment}"
    script:
        "../scripts/retrieve.py"


rule retrieve_return:
    input:
        table=f"{RESULTS}/data/{{experiment}}.nc",
        measured=lambda wildcards: list_measured_files(
            wildcards.experiment, "retrieve_return"
        ),
        media=lambda wildcards: EXPERIMENTS[wildcards.experiment].list_table_paths(),
    output:
        table=f"{RESULTS}/tables/{{experiment}}_retrieved.csv",
        figure=multiext(f"{RESULTS}/figures/{{experiment}}", *FIGURE_SUFFIXES),
    log:
        f"{RESULTS}/logs/retrieve_return/{{experiment}}.log",
    wildcard_constraints:
        experiment=match_any(EXPERIMENTS_WITH_RETURNS),
    conda:
        "../../environment.yml"
    threads: lambda wildcards: choose_threads()
    params:
        experiment=lambda wildcards: EXPERIMENTS[wildcards.experiment].dump_simulation(),
        retrieve=lambda wildcards: escape_json(
            EXPERIMENTS[wildcards.experiment].retrieve_return.model_dump(mode="json")
        ),
        seed=SETTINGS.seed,
        # Synthetic returns are simulated.
        physics=hash_physics_sources(),
        program=hash_sources(provenance.RETURN_SOURCES + provenance.FIGURE_SOURCES),
    message:
        "Retrieving parameters from returns for {wildcards.experiment}"
    script:
        "../scripts/retrieve_return.py"
