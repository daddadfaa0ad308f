ARCHIVED = list(EXPERIMENTS) if SETTINGS.archive == "all" else list(SETTINGS.archive)


rule archive:
    input:
        [products(name) for name in ARCHIVED],
        study_products() if SETTINGS.archive == "all" else [],
    output:
        f"{RESULTS}/archive/splits-results.zip",
    log:
        f"{RESULTS}/logs/archive.log",
    benchmark:
        f"{RESULTS}/benchmarks/archive.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    params:
        configuration=["config", SETTINGS.media_folder, SETTINGS.experiments_folder],
    message:
        "Packing results for deposit"
    script:
        "../scripts/archive.py"
