rule figure:
    input:
        data=f"{RESULTS}/data/{{experiment}}.nc",
        measured=lambda wildcards: list_measured_files(wildcards.experiment),
    output:
        report(
            f"{RESULTS}/figures/{{experiment}}.png",
            caption="../report/figure.rst",
            category="Experiments",
            labels={"experiment": "{experiment}"},
        ),
        f"{RESULTS}/figures/{{experiment}}.svg",
        f"{RESULTS}/figures/{{experiment}}.pdf",
    log:
        f"{RESULTS}/logs/figure/{{experiment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/figure/{{experiment}}.tsv"
    wildcard_constraints:
        experiment=match_any(
            set(EXPERIMENTS_WITH_FIGURE) - set(EXPERIMENTS_WITH_RETRIEVAL)
        ),
    conda:
        "../../environment.yml"
    threads: 1
    params:
        figure=lambda wildcards: escape_json(
            EXPERIMENTS[wildcards.experiment].resolve_figure()
        ),
        title=lambda wildcards: escape_rst(EXPERIMENTS[wildcards.experiment].title),
        caption=lambda wildcards: escape_rst(EXPERIMENTS[wildcards.experiment].caption),
    message:
        "Drawing {wildcards.experiment}"
    script:
        "../scripts/figure.py"
