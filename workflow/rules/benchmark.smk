BENCHMARK_OPTIONS = [] if SETTINGS.accuracy == "standard" else ["--quick"]
BENCHMARKED = [
    *(
        f"{RESULTS}/benchmarks/speed_against_error{suffix}"
        for suffix in (".csv", *FIGURE_SUFFIXES)
    ),
    f"{RESULTS}/benchmarks/kernels.csv",
]
# Benchmarks take many minutes, so the report shows them only if they exist.
REPORTED_BENCHMARKS = (
    BENCHMARKED if all(Path(path).exists() for path in BENCHMARKED) else []
)


rule benchmarks:
    input:
        BENCHMARKED,


# A benchmark reserves all cores, so that no other job runs at the same time.
rule speed_against_error:
    output:
        f"{RESULTS}/benchmarks/speed_against_error.csv",
    log:
        f"{RESULTS}/logs/speed_against_error.log",
    conda:
        "../../environment.yml"
    threads: 64
    params:
        program="speed_against_error.py",
        options=BENCHMARK_OPTIONS,
        source=lambda wildcards: hash_program(
            "speed_against_error.py", "method_table.py", "theories.py"
        ),
        physics=hash_physics_sources(),
        theories=hash_files(
            PACKAGE_FOLDER,
            [
                "experiments/papers/performance.py",
                "analysis/theory/discrete_ordinates.py",
                "analysis/theory/asymptotic.py",
            ],
        ),
    message:
        "Measuring time against error of all methods"
    script:
        "../scripts/benchmark.py"


use rule speed_against_error as benchmark_kernels with:
    output:
        f"{RESULTS}/benchmarks/kernels.csv",
    log:
        f"{RESULTS}/logs/kernels.log",
    params:
        program="kernels.py",
        options=BENCHMARK_OPTIONS,
        source=lambda wildcards: hash_program("kernels.py"),
        physics=hash_physics_sources(),
    message:
        "Comparing the times of the kernels"


rule figure_speed_against_error:
    input:
        f"{RESULTS}/benchmarks/speed_against_error.csv",
    output:
        multiext(f"{RESULTS}/benchmarks/speed_against_error", *FIGURE_SUFFIXES),
    log:
        f"{RESULTS}/logs/figure_speed_against_error.log",
    benchmark:
        f"{RESULTS}/benchmarks/figure_speed_against_error.tsv"
    conda:
        "../../environment.yml"
    message:
        "Drawing error against time"
    script:
        "../scripts/figure_speed_against_error.py"
