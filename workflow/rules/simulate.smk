rule simulate:
    input:
        tables=lambda wildcards: EXPERIMENTS[wildcards.experiment].list_table_paths(),
    output:
        f"{RESULTS}/data/{{experiment}}.nc",
    log:
        f"{RESULTS}/logs/simulate/{{experiment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/simulate/{{experiment}}.tsv"
    wildcard_constraints:
        experiment=match_any(set(EXPERIMENTS) - set(TABLES)),
    priority: 1
    conda:
        "../../environment.yml"
    # Results do not depend on the number of threads.
    threads: lambda wildcards: choose_threads()
    params:
        experiment=lambda wildcards: EXPERIMENTS[wildcards.experiment].dump_simulation(),
        accuracy=SETTINGS.accuracies[SETTINGS.accuracy].model_dump(),
        seed=SETTINGS.seed,
        kept=lambda wildcards: f"{RESULTS}/blocks/{wildcards.experiment}",
        # Sources are not inputs, which would be recorded with the path of the package.
        physics=hash_physics_sources(),
    message:
        "Simulating {wildcards.experiment}"
    script:
        "../scripts/simulate.py"
