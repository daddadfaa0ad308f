import splits

PACKAGE = Path(splits.__file__).parent

# A simulation depends on these sources and no others: plots and tables may change freely.
PHYSICS = sorted(
    str(path)
    for folder in ("materials", "media", "transport", "instruments")
    for path in (PACKAGE / folder).rglob("*.py")
) + [str(PACKAGE / "experiments" / "run.py"), str(PACKAGE / "uncertainty.py")]

FITTING = [
    str(PACKAGE / "experiments" / name)
    for name in ("fit.py", "parameters.py", "run_fit.py")
]

# Experiments whose numbers the SPLITSnow tables are made of.
TABLE_EXPERIMENTS = [
    "table1_sample",
    "fig07_transmittance",
    "fig08_grain_size",
    "fig09_facetness",
    "fig10_density",
    "fig11_depth",
    "fig12_grain_size",
    "fig13_saturation",
    "fig14_density",
    "fig24b_aviris",
    "letcher2022",
    "readings_table3",
]
# Experiments whose numbers the SPLITS tables are made of.
SAND_EXPERIMENTS = [
    "sand_fig06_tec_samples",
    "sand_fig07_wet_colours",
    "sand_fig08_hematite_ratio",
    "sand_fig08_iron_oxide",
    "sand_fig08_magnetite",
    "sand_fig08_texture",
    "sand_fig09_colours",
    "sand_fine_fraction",
    "sand_mineral_weight",
    "sand_readings",
    "sand_size_tail",
]
SAND_TABLES = [
    "sand_trends",
    "sand_weights",
    "sand_colours",
    "sand_compositions",
]
# Experiments whose BRDFs the papers describe in words.
ANGULAR_EXPERIMENTS = [
    "fig16_incidence",
    "fig18_wavelength",
    "fig19_incidence",
    "fig20_grain_size",
    "fig20_struck_uniform",
    "fig21_grain_size",
    "fig22_facetness",
    "sand_fig11_brdf",
]
# Experiments of which the paper on rough layers says something.
LAYER_EXPERIMENTS = [
    "layer_fig02_lens",
    "layer_fig03_glass",
    "layer_slope_correlation",
    "layer_polarization",
    "layer_multiple_reflection",
    "layer_band_limit",
]
SENSITIVITY_EXPERIMENTS = sorted(
    {
        name
        for pair in SETTINGS.sensitivity.values()
        for name in (pair.experiment, pair.readings)
    }
)


wildcard_constraints:
    experiment="|".join(EXPERIMENTS),


def data(names):
    """Return the datasets of experiments."""
    return [f"{RESULTS}/data/{name}.nc" for name in names]


def products(name):
    """Return everything that one experiment makes."""
    made = [f"{RESULTS}/figures/{name}{suffix}" for suffix in (".png", ".svg")]
    if EXPERIMENTS[name].fit:
        made.append(f"{RESULTS}/tables/{name}_parameters.csv")
    return data([name]) + made


def paper_products():
    """Return tables that need several experiments, if all of them are selected."""
    made = []
    if set(SENSITIVITY_EXPERIMENTS) <= set(EXPERIMENTS) and SENSITIVITY_EXPERIMENTS:
        made += [
            f"{RESULTS}/data/fig23_sensitivity.nc",
            f"{RESULTS}/figures/fig23_sensitivity.png",
            f"{RESULTS}/figures/fig23_sensitivity.svg",
            f"{RESULTS}/tables/sensitivity.csv",
            f"{RESULTS}/tables/table2.csv",
        ]
        if set(TABLE_EXPERIMENTS) <= set(EXPERIMENTS):
            made += [
                f"{RESULTS}/tables/{table}.csv"
                for table in ("agreement", "measured_bands", "table1", "table3")
            ]
            made += [
                f"{RESULTS}/figures/letcher2022_measured{suffix}"
                for suffix in (".png", ".svg")
            ]
    if set(SAND_EXPERIMENTS) <= set(EXPERIMENTS):
        made += [f"{RESULTS}/tables/{table}.csv" for table in SAND_TABLES]
    if set(ANGULAR_EXPERIMENTS) <= set(EXPERIMENTS):
        made.append(f"{RESULTS}/tables/angular_trends.csv")
    if set(LAYER_EXPERIMENTS) <= set(EXPERIMENTS):
        made.append(f"{RESULTS}/tables/layer_trends.csv")
    return made


def measured_files(name):
    """Return the measured table that an experiment's figure shows, if any."""
    measured = EXPERIMENTS[name].figure.measured
    return [f"config/measured/{measured}"] if measured else []


def fitted_files(name):
    """Return the measured table that an experiment fits sands to, if any."""
    fit = EXPERIMENTS[name].fit
    return [f"config/measured/{fit.measured}"] if fit else []


def threads_of(name):
    """Return the threads of a simulation.

    Up to four run side by side, which hides their starts behind each other's work; a single one
    that was asked for by its name, and a fit, which is long, have all cores.
    """
    asked = set(workflow.dag_settings.targets) & set(EXPERIMENTS)
    together = min(4, len(asked or EXPERIMENTS))
    cores = workflow.cores or 1
    return cores if EXPERIMENTS[name].fit else max(1, cores // together)


def physics_of(name):
    """Return the sources that an experiment's numbers depend on."""
    return PHYSICS + FITTING if EXPERIMENTS[name].fit else PHYSICS
