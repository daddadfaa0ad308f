rule explorer:
    input:
        # Lists, since labels given by users may equal names of methods of `snakemake.input`.
        tables=data(EXPLORED.values()),
        directions=data(WHERE.values()),
    output:
        f"{RESULTS}/explorer.html",
    log:
        f"{RESULTS}/logs/explorer.log",
    conda:
        "../../environment.yml"
    threads: 1
    params:
        labels=list(EXPLORED),
        directions=list(WHERE),
        about=[EXPERIMENTS[name].title for name in EXPLORED.values()],
        page=hash_files(
            PACKAGE_FOLDER / "plotting" / "explorer",
            ["page.py", "page.html", "page.css", "page.js"],
        ),
    message:
        "Writing the explorer"
    script:
        "../scripts/explorer.py"
