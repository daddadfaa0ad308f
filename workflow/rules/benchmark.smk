rule benchmarks:
    input:
        physics=PHYSICS,
        program="benchmarks/speed_against_error.py",
    output:
        f"{RESULTS}/benchmarks/speed_against_error.csv",
    log:
        f"{RESULTS}/logs/benchmarks.log",
    conda:
        "../../environment.yml"
    threads: 1
    message:
        "Measuring speed against error of the two estimators"
    shell:
        "python {input.program} {output} 2>&1 | tee {log}"
