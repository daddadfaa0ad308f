rule explorer_page:
    input:
        # Lists, since labels given by users may equal names of methods of `snakemake.input`.
        tables=list_datasets(EXPLORER_TABLES.values()),
        directions=list_datasets(EXPLORER_DIRECTIONS.values()),
    output:
        f"{RESULTS}/explorer.html",
    log:
        f"{RESULTS}/logs/explorer.log",
    conda:
        "../../environment.yml"
    params:
        labels=list(EXPLORER_TABLES),
        directions=list(EXPLORER_DIRECTIONS),
        about=[EXPERIMENTS[name].title for name in EXPLORER_TABLES.values()],
        page=hash_sources(["plotting/explorer/page.*"]),
    message:
        "Writing the explorer"
    script:
        "../scripts/explorer.py"
