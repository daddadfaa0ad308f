BENCHMARK_OPTIONS = [] if SETTINGS.accuracy == "standard" else ["--quick"]
BENCHMARKED = [
    f"{RESULTS}/benchmarks/speed_against_error.csv",
    f"{RESULTS}/benchmarks/speed_against_error.png",
    f"{RESULTS}/benchmarks/speed_against_error.svg",
    f"{RESULTS}/benchmarks/speed_against_error.pdf",
    f"{RESULTS}/benchmarks/kernels.csv",
]
# Benchmarks take many minutes, so `all` includes them only for a report, if they exist.
REPORTED = (
    BENCHMARKED
    if "--report" in sys.argv and all(Path(path).exists() for path in BENCHMARKED)
    else []
)


rule benchmarks:
    input:
        BENCHMARKED,


# A benchmark reserves all cores, so that no other job runs at the same time.
rule speed_against_error:
    output:
        report(
            f"{RESULTS}/benchmarks/speed_against_error.csv",
            caption="../report/speed_against_error.rst",
            category="Benchmarks",
        ),
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


rule benchmark_kernels:
    output:
        report(
            f"{RESULTS}/benchmarks/kernels.csv",
            caption="../report/kernels.rst",
            category="Benchmarks",
        ),
    log:
        f"{RESULTS}/logs/kernels.log",
    conda:
        "../../environment.yml"
    threads: 64
    params:
        program="kernels.py",
        options=BENCHMARK_OPTIONS,
        source=lambda wildcards: hash_program("kernels.py"),
        physics=hash_physics_sources(),
    message:
        "Comparing the times of the kernels"
    script:
        "../scripts/benchmark.py"


rule figure_speed_against_error:
    input:
        f"{RESULTS}/benchmarks/speed_against_error.csv",
    output:
        report(
            f"{RESULTS}/benchmarks/speed_against_error.png",
            caption="../report/speed_against_error_figure.rst",
            category="Benchmarks",
        ),
        f"{RESULTS}/benchmarks/speed_against_error.svg",
        f"{RESULTS}/benchmarks/speed_against_error.pdf",
    log:
        f"{RESULTS}/logs/figure_speed_against_error.log",
    benchmark:
        f"{RESULTS}/benchmarks/figure_speed_against_error.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    message:
        "Drawing error against time"
    script:
        "../scripts/figure_speed_against_error.py"
