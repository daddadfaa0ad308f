from splits.experiments.studies import FILES, left_out
from splits.sources import physics_digest

STUDIES = SETTINGS.studies
# Studies that lack experiments, each with the line that says so.
LEFT_OUT = left_out(STUDIES, EXPERIMENTS, AVAILABLE)
for NAME in set(LEFT_OUT) & set(sys.argv[1:]):
    raise WorkflowError(LEFT_OUT[NAME])

DRAWN = [name for name, e in EXPERIMENTS.items() if e.figure.kind != "none"]
MADE = [name for name in STUDIES if name not in LEFT_OUT]


wildcard_constraints:
    experiment="|".join(EXPERIMENTS),


def data(names):
    """Return the datasets of experiments."""
    return [f"{RESULTS}/data/{name}.nc" for name in names]


def products(name):
    """Return everything that one experiment makes."""
    suffixes = (".png", ".svg") if name in DRAWN else ()
    made = [f"{RESULTS}/figures/{name}{suffix}" for suffix in suffixes]
    if EXPERIMENTS[name].fit:
        made.append(f"{RESULTS}/tables/{name}_parameters.csv")
    return data([name]) + made


def study_products():
    """Return what the studies make whose experiments are all selected."""
    return [
        f"{RESULTS}/{path}"
        for name in MADE
        for paths in STUDIES[name].paths(name).values()
        for path in paths
    ]


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
