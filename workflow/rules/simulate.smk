rule simulate:
    input:
        physics=lambda wildcards: physics_of(wildcards.experiment),
        tables=lambda wildcards: EXPERIMENTS[wildcards.experiment].tables(),
        measured=lambda wildcards: fitted_files(wildcards.experiment),
    output:
        f"{RESULTS}/data/{{experiment}}.nc",
    log:
        f"{RESULTS}/logs/simulate/{{experiment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/simulate/{{experiment}}.tsv"
    priority: 1
    conda:
        "../../environment.yml"
    # Capped at --cores, so one after the other on all cores: none is left running alone at the
    # end, and a single experiment is as fast as can be.  The numbers do not depend on it.
    threads: 64
    params:
        experiment=lambda wildcards: EXPERIMENTS[wildcards.experiment].simulation(),
        accuracy=SETTINGS.accuracies[SETTINGS.accuracy].model_dump(),
        seed=SETTINGS.seed,
    message:
        "Simulating {wildcards.experiment}"
    script:
        "../scripts/simulate.py"
