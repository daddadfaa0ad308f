from splits.archive import configuration_files

ARCHIVED = [
    name
    for name in EXPERIMENTS
    if SETTINGS.archive == "all" or name in SETTINGS.archive
]


if "archive" in sys.argv[1:]:
    for path in map(str, configuration_files(SETTINGS).values()):
        if {"{", "}"} & set(path):
            raise WorkflowError(f"archive = {path!r}: must be paths without {{ and }}")


rule archive:
    input:
        results=[products(name) for name in ARCHIVED]
        + (study_products() if SETTINGS.archive == "all" else []),
        configuration=lambda wildcards: configuration_files(SETTINGS).values(),
        tables=sorted({t for e in EXPERIMENTS.values() for t in e.tables()}),
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
        settings=SETTINGS.model_dump(mode="json"),
        repository=str(workflow.basedir),
    message:
        "Packing results for deposit"
    script:
        "../scripts/archive.py"
