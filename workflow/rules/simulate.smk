rule simulate:
    input:
        physics=PHYSICS,
    output:
        f"{RESULTS}/data/{{experiment}}.nc",
    log:
        f"{RESULTS}/logs/simulate/{{experiment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/simulate/{{experiment}}.tsv"
    # The longest first, so that none is left running alone at the end.
    priority: 1
    conda:
        "../../environment.yml"
    threads: 1
    params:
        experiment=lambda wildcards: EXPERIMENTS[wildcards.experiment].simulation(),
        accuracy=SETTINGS.accuracies[SETTINGS.accuracy].model_dump(),
        seed=SETTINGS.seed,
    message:
        "Simulating {wildcards.experiment}"
    script:
        "../scripts/simulate.py"
