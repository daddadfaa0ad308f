rule retrieve:
    input:
        table=f"{RESULTS}/data/{{experiment}}.nc",
        measured=lambda wildcards: list_measured_files(
            EXPERIMENTS[wildcards.experiment].retrieve
        ),
    output:
        table=f"{RESULTS}/tables/{{experiment}}_retrieved.csv",
        figure=multiext(f"{RESULTS}/figures/{{experiment}}", *FIGURE_SUFFIXES),
    log:
        f"{RESULTS}/logs/retrieve/{{experiment}}.log",
    wildcard_constraints:
        experiment=match_any(EXPERIMENTS_WITH_RETRIEVAL),
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
