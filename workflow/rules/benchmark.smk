# Programs of benchmarks/ with their options.
BENCHMARKS = {
    "speed_against_error_short": ["speed_against_error.py", "--short"],
    "speed_against_error": ["speed_against_error.py"],
    "kernels": ["kernels.py"],
}
# Low accuracy levels only test that they run.
if SETTINGS.accuracies[SETTINGS.accuracy].max_stderr > 0.01:
    BENCHMARKS = {name: [call[0], "--quick"] for name, call in BENCHMARKS.items()}
# Time against error belongs to the results of the papers.
REPORTED_BENCHMARKS = (
    list_benchmark_files("speed_against_error_short")
    if set(GROUPS.get("papers", ["papers"])) <= set(SELECTED)
    else []
)


rule benchmarks:
    input:
        list_benchmark_files("speed_against_error"),
        f"{RESULTS}/benchmarks/kernels.csv",


# A benchmark reserves all cores, so that no other job runs at the same time.
rule benchmark:
    output:
        f"{RESULTS}/benchmarks/{{name}}.csv",
    log:
        f"{RESULTS}/logs/benchmark/{{name}}.log",
    wildcard_constraints:
        name=match_any(BENCHMARKS),
    conda:
        "../../environment.yml"
    threads: max(64, count_cores())
    params:
        call=lambda wildcards: BENCHMARKS[wildcards.name],
        sources=lambda wildcards: hash_files(
            Path(workflow.basedir) / "benchmarks",
            [BENCHMARKS[wildcards.name][0], "performance.py"],
        ),
        physics=hash_physics_sources(),
        theories=hash_sources(["analysis/theory"]),
    message:
        "Benchmark {wildcards.name}"
    script:
        "../scripts/benchmark.py"


rule figure_benchmark:
    input:
        f"{RESULTS}/benchmarks/{{name}}.csv",
    output:
        figure=multiext(f"{RESULTS}/benchmarks/{{name}}", *FIGURE_SUFFIXES),
        table=f"{RESULTS}/benchmarks/{{name}}_times.csv",
    log:
        f"{RESULTS}/logs/figure_benchmark/{{name}}.log",
    wildcard_constraints:
        name="speed_against_error(_short)?",
    conda:
        "../../environment.yml"
    params:
        program=hash_files(Path(workflow.basedir) / "benchmarks", ["performance.py"]),
        sources=hash_sources(provenance.FIGURE_SOURCES),
    message:
        "Drawing error against time"
    script:
        "../scripts/figure_benchmark.py"
