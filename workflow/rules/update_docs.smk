if "update_docs" in sys.argv and SETTINGS.accuracy != "standard":
    raise WorkflowError(
        f"accuracy = '{SETTINGS.accuracy}': must be standard for the target update_docs"
    )


# Documents are not outputs, because Snakemake removes outputs before a job; the rule always runs.
rule update_docs:
    input:
        list_products(EXPERIMENTS),
        list_study_products(EXPERIMENTS, GROUPS),
    log:
        f"{RESULTS}/logs/update_docs.log",
    conda:
        "../../environment.yml"
    params:
        figures=lambda wildcards, input: [
            Path(path).stem for path in input if path.endswith(".png")
        ],
    message:
        "Writing numbers and figures of this run into README.md and docs"
    script:
        "../scripts/update_docs.py"
