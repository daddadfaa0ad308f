rule retrieve:
    input:
        table=f"{RESULTS}/data/{{experiment}}.nc",
        measured=lambda wildcards: list_retrieved_files(wildcards.experiment),
    output:
        table=report(
            f"{RESULTS}/tables/{{experiment}}_retrieved.csv",
            caption="../report/retrieved.rst",
            category="Retrievals",
            labels={"experiment": "{experiment}"},
        ),
        figure=[
            report(
                f"{RESULTS}/figures/{{experiment}}.png",
                caption="../report/retrieved.rst",
                category="Retrievals",
                labels={"experiment": "{experiment}"},
            ),
            f"{RESULTS}/figures/{{experiment}}.svg",
            f"{RESULTS}/figures/{{experiment}}.pdf",
        ],
    log:
        f"{RESULTS}/logs/retrieve/{{experiment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/retrieve/{{experiment}}.tsv"
    wildcard_constraints:
        experiment=match_any(EXPERIMENTS_WITH_RETRIEVAL),
    conda:
        "../../environment.yml"
    threads: 1
    params:
        retrieve=lambda wildcards: escape_json(
            EXPERIMENTS[wildcards.experiment].retrieve.model_dump(mode="json")
        ),
        title=lambda wildcards: escape_rst(EXPERIMENTS[wildcards.experiment].title),
        caption=lambda wildcards: escape_rst(EXPERIMENTS[wildcards.experiment].caption),
        seed=SETTINGS.seed,
        program=hash_files(PACKAGE_FOLDER, RETRIEVAL_SOURCES),
    message:
        "Retrieving parameters for {wildcards.experiment}"
    script:
        "../scripts/retrieve.py"
