from splits.experiments.report.contents import make_report_contents

REPORT_CONTENTS = make_report_contents(
    SETTINGS,
    SELECTED,
    select_studies(COMPLETE_STUDIES, SELECTED, SELECTED_GROUPS),
    [Path(path).relative_to(RESULTS).as_posix() for path in REPORTED_BENCHMARKS],
    explorer=bool(list_explorer(SELECTED)),
)


REPORTED = [
    *list_products(SELECTED),
    *list_study_products(SELECTED, SELECTED_GROUPS),
    *list_explorer(SELECTED),
    *REPORTED_BENCHMARKS,
]


# The contents depend on the targets, which jobs of a cluster do not have.
localrules:
    archive,
    report,


rule report:
    input:
        REPORTED,
    output:
        f"{RESULTS}/report.html",
    log:
        f"{RESULTS}/logs/report.log",
    conda:
        "../../environment.yml"
    params:
        # Snakemake records the digest only, since it prints recorded parameters that change.
        contents=lambda wildcards: REPORT_CONTENTS,
        digest=REPORT_CONTENTS.compute_digest(),
        sources=hash_sources(["experiments/report"]),
    message:
        "Writing the report"
    script:
        "../scripts/report.py"
