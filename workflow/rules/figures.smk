rule figure:
    input:
        data=f"{RESULTS}/data/{{experiment}}.nc",
        measured=lambda wildcards: list_measured_files(wildcards.experiment, "figure"),
    output:
        multiext(f"{RESULTS}/figures/{{experiment}}", *FIGURE_SUFFIXES),
    log:
        f"{RESULTS}/logs/figure/{{experiment}}.log",
    wildcard_constraints:
        experiment=match_any(
            set(EXPERIMENTS_WITH_FIGURE) - set(EXPERIMENTS_WITH_RETRIEVAL)
        ),
    conda:
        "../../environment.yml"
    params:
        figure=lambda wildcards: escape_json(
            EXPERIMENTS[wildcards.experiment].resolve_figure()
        ),
        sources=hash_sources(provenance.FIGURE_SOURCES),
    message:
        "Drawing {wildcards.experiment}"
    script:
        "../scripts/figure.py"
