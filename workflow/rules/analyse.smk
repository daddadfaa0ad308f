rule sensitivity:
    input:
        data=data(SENSITIVITY_EXPERIMENTS),
        published="config/published/splitsnow2021.csv",
    output:
        data=f"{RESULTS}/data/fig23_sensitivity.nc",
        table=report(
            f"{RESULTS}/tables/sensitivity.csv",
            caption="../report/sensitivity_table.rst",
            category="Sensitivity",
        ),
        table2=report(
            f"{RESULTS}/tables/table2.csv",
            caption="../report/sensitivity.rst",
            category="Sensitivity",
        ),
    log:
        f"{RESULTS}/logs/sensitivity.log",
    benchmark:
        f"{RESULTS}/benchmarks/sensitivity.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    params:
        pairs={name: pair.model_dump() for name, pair in SETTINGS.sensitivity.items()},
    message:
        "Taking mean sensitivity indices"
    script:
        "../scripts/sensitivity.py"


rule agreement:
    input:
        data=data(TABLE_EXPERIMENTS),
        sensitivity=f"{RESULTS}/data/fig23_sensitivity.nc",
        published="config/published/splitsnow2021.csv",
        aviris="config/measured/aviris_ng_varsa2021.csv",
        letcher="config/measured/snow_albedo_letcher2022.csv",
    output:
        agreement=report(
            f"{RESULTS}/tables/agreement.csv",
            caption="../report/agreement.rst",
            category="Agreement",
        ),
        bands=report(
            f"{RESULTS}/tables/measured_bands.csv",
            caption="../report/measured_bands.rst",
            category="Agreement",
        ),
        table1=report(
            f"{RESULTS}/tables/table1.csv",
            caption="../report/table1.rst",
            category="Agreement",
        ),
        table3=report(
            f"{RESULTS}/tables/table3.csv",
            caption="../report/table3.rst",
            category="Agreement",
        ),
    log:
        f"{RESULTS}/logs/agreement.log",
    benchmark:
        f"{RESULTS}/benchmarks/agreement.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    message:
        "Holding results against published and measured numbers"
    script:
        "../scripts/agreement.py"


rule sand_tables:
    input:
        data=data(SAND_EXPERIMENTS),
    output:
        trends=report(
            f"{RESULTS}/tables/sand_trends.csv",
            caption="../report/sand_trends.rst",
            category="Sand",
        ),
        weights=report(
            f"{RESULTS}/tables/sand_weights.csv",
            caption="../report/sand_weights.rst",
            category="Sand",
        ),
        colours=report(
            f"{RESULTS}/tables/sand_colours.csv",
            caption="../report/sand_colours.rst",
            category="Sand",
        ),
    log:
        f"{RESULTS}/logs/sand_tables.log",
    benchmark:
        f"{RESULTS}/benchmarks/sand_tables.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    message:
        "Holding sand against the trends of SPLITS"
    script:
        "../scripts/sand_tables.py"


rule angular_trends:
    input:
        data=data(ANGULAR_EXPERIMENTS),
    output:
        report(
            f"{RESULTS}/tables/angular_trends.csv",
            caption="../report/angular_trends.rst",
            category="Angles",
        ),
    log:
        f"{RESULTS}/logs/angular_trends.log",
    benchmark:
        f"{RESULTS}/benchmarks/angular_trends.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    message:
        "Holding BRDFs against the trends of the papers"
    script:
        "../scripts/angular_trends.py"


rule layer_trends:
    input:
        data=data(LAYER_EXPERIMENTS),
    output:
        report(
            f"{RESULTS}/tables/layer_trends.csv",
            caption="../report/layer_trends.rst",
            category="Layers",
        ),
    log:
        f"{RESULTS}/logs/layer_trends.log",
    benchmark:
        f"{RESULTS}/benchmarks/layer_trends.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    message:
        "Holding rough layers against what their paper says"
    script:
        "../scripts/layer_trends.py"


rule sand_compositions:
    output:
        report(
            f"{RESULTS}/tables/sand_compositions.csv",
            caption="../report/sand_compositions.rst",
            category="Sand",
        ),
    log:
        f"{RESULTS}/logs/sand_compositions.log",
    benchmark:
        f"{RESULTS}/benchmarks/sand_compositions.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    params:
        physics=physics_digest(),
        experiments={
            name: e.simulation()
            for name, e in EXPERIMENTS.items()
            if e.medium.get("kind") == "sand"
        },
    message:
        "Listing the compositions of all sands"
    script:
        "../scripts/sand_compositions.py"


rule fitted_parameters:
    input:
        f"{RESULTS}/data/{{experiment}}.nc",
    output:
        report(
            f"{RESULTS}/tables/{{experiment}}_parameters.csv",
            caption="../report/fits.rst",
            category="Sand",
            labels={"experiment": "{experiment}"},
        ),
    log:
        f"{RESULTS}/logs/fitted_parameters/{{experiment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/fitted_parameters/{{experiment}}.tsv"
    conda:
        "../../environment.yml"
    threads: 1
    message:
        "Listing the sands found by {wildcards.experiment}"
    script:
        "../scripts/fitted_parameters.py"
