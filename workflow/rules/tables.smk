rule table_part:
    input:
        tables=lambda wildcards: EXPERIMENTS[wildcards.experiment].list_table_paths(),
    output:
        f"{RESULTS}/blocks/{{experiment}}/part_{{part}}.json",
    log:
        f"{RESULTS}/logs/table_part/{{experiment}}_{{part}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/table_part/{{experiment}}_{{part}}.tsv"
    wildcard_constraints:
        experiment=match_any(TABLES),
        part=r"\d+",
    priority: 1
    conda:
        "../../environment.yml"
    # Parallel parts are faster than threads, which wait for each other.
    threads: 1
    params:
        experiment=lambda wildcards: EXPERIMENTS[wildcards.experiment].dump_simulation(),
        accuracy=SETTINGS.accuracies[SETTINGS.accuracy].model_dump(),
        seed=SETTINGS.seed,
        physics=hash_physics_sources(),
    message:
        "Simulating part {wildcards.part} of {wildcards.experiment}"
    script:
        "../scripts/table_part.py"


rule table:
    input:
        parts=lambda wildcards: list_table_parts(wildcards.experiment),
        tables=lambda wildcards: EXPERIMENTS[wildcards.experiment].list_table_paths(),
    output:
        f"{RESULTS}/data/{{experiment}}.nc",
    log:
        f"{RESULTS}/logs/table/{{experiment}}.log",
    wildcard_constraints:
        experiment=match_any(TABLES),
    priority: 1
    conda:
        "../../environment.yml"
    params:
        experiment=lambda wildcards: EXPERIMENTS[wildcards.experiment].dump_simulation(),
        accuracy=SETTINGS.accuracies[SETTINGS.accuracy].model_dump(),
        seed=SETTINGS.seed,
        physics=hash_physics_sources(),
        sources=hash_sources(provenance.TABLE_SOURCES),
    message:
        "Assembling {wildcards.experiment}"
    script:
        "../scripts/table.py"


# The package holds a copy of these tables in splits/discrete_ordinates.
rule natural_grains:
    output:
        multiext(f"{RESULTS}/grains/natural_grains", "_dry.nc", "_wet.nc"),
    log:
        f"{RESULTS}/logs/natural_grains.log",
    conda:
        "../../environment.yml"
    threads: 64
    shell:
        f"python -m splits.discrete_ordinates.grain_tabulation {RESULTS}/grains {{threads}} > {{log}}"
