rule explorer:
    input:
        **{
            name: f"{RESULTS}/data/{name}.nc"
            for name in (*EXPLORED.values(), *WHERE.values())
        },
    output:
        f"{RESULTS}/explorer.html",
    log:
        f"{RESULTS}/logs/explorer.log",
    conda:
        "../../environment.yml"
    threads: 1
    params:
        explorer=EXPLORED,
        directions=WHERE,
        about={name: EXPERIMENTS[name].title for name in EXPLORED.values()},
        page=files_digest(
            PACKAGE / "explorer", ["page.py", "page.html", "page.css", "page.js"]
        ),
    message:
        "Writing the explorer"
    script:
        "../scripts/explorer.py"
