rule figure:
    input:
        data=f"{RESULTS}/data/{{experiment}}.nc",
        measured=lambda wildcards: measured_files(wildcards.experiment),
    output:
        report(
            f"{RESULTS}/figures/{{experiment}}.png",
            caption="../report/figure.rst",
            category="Experiments",
            labels={"experiment": "{experiment}"},
        ),
        f"{RESULTS}/figures/{{experiment}}.svg",
    log:
        f"{RESULTS}/logs/figure/{{experiment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/figure/{{experiment}}.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    params:
        figure=lambda wildcards: EXPERIMENTS[wildcards.experiment].drawing(),
        title=lambda wildcards: EXPERIMENTS[wildcards.experiment].title,
        caption=lambda wildcards: EXPERIMENTS[wildcards.experiment].caption,
    message:
        "Drawing {wildcards.experiment}"
    script:
        "../scripts/figure.py"


rule figure_sensitivity:
    input:
        f"{RESULTS}/data/fig23_sensitivity.nc",
    output:
        report(
            f"{RESULTS}/figures/fig23_sensitivity.png",
            caption="../report/sensitivity.rst",
            category="Experiments",
            labels={"experiment": "fig23_sensitivity"},
        ),
        f"{RESULTS}/figures/fig23_sensitivity.svg",
    log:
        f"{RESULTS}/logs/figure_sensitivity.log",
    benchmark:
        f"{RESULTS}/benchmarks/figure_sensitivity.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    message:
        "Drawing the mean sensitivity index"
    script:
        "../scripts/figure_sensitivity.py"


rule figure_letcher:
    input:
        f"{RESULTS}/tables/measured_bands.csv",
    output:
        report(
            f"{RESULTS}/figures/letcher2022_measured.png",
            caption="../report/letcher.rst",
            category="Agreement",
            labels={"experiment": "letcher2022_measured"},
        ),
        f"{RESULTS}/figures/letcher2022_measured.svg",
    log:
        f"{RESULTS}/logs/figure_letcher.log",
    benchmark:
        f"{RESULTS}/benchmarks/figure_letcher.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    message:
        "Drawing the measured albedo of Letcher et al."
    script:
        "../scripts/figure_letcher.py"
