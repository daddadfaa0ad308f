from splits.core.escaping import escape_json
from splits.core import provenance
from splits.core.provenance import hash_files, hash_physics_sources, hash_sources
from splits.plotting.grammar import FIGURE_SUFFIXES
from splits.experiments.config.settings import (
    describe_missing,
    find_incomplete_studies,
    hash_function,
    select_studies,
)
from splits.experiments.run_table import count_parts

STUDIES = SETTINGS.studies
# Studies of which experiments do not exist, with a message for each.
INCOMPLETE_STUDIES = find_incomplete_studies(STUDIES, EXPERIMENTS)
for NAME, MESSAGE in INCOMPLETE_STUDIES.items():
    if NAME in sys.argv[1:]:
        raise WorkflowError(MESSAGE)
for MESSAGE in SETTINGS.list_warnings(EXPERIMENTS) if workflow.is_main_process else ():
    logger.warning(MESSAGE)
COMPLETE_STUDIES = {
    name: study for name, study in STUDIES.items() if name not in INCOMPLETE_STUDIES
}

# Experiments by group.
GROUPS = {
    group: [name for name, e in EXPERIMENTS.items() if e.group == group]
    for group in dict.fromkeys(e.group for e in EXPERIMENTS.values())
}
SELECTED_GROUPS = (
    GROUPS if SETTINGS.experiments == "everything" else SETTINGS.experiments
)

TABLES = [name for name, e in EXPERIMENTS.items() if e.is_in_parts]
EXPLORER_TABLES, EXPLORER_DIRECTIONS = SETTINGS.select_explorer(EXPERIMENTS)
if "explorer" in sys.argv[1:] and not EXPLORER_TABLES:
    MISSING = describe_missing(SETTINGS.explorer.values(), EXPERIMENTS)
    LACKING = "; ".join(MISSING) or "explorer names no tables"
    raise WorkflowError(f"the explorer is left out: {LACKING}")
# Experiments whose tables are used for retrievals.
EXPERIMENTS_WITH_RETRIEVAL = [name for name, e in EXPERIMENTS.items() if e.retrieval]
EXPERIMENTS_WITH_RETURNS = [
    name for name, e in EXPERIMENTS.items() if e.retrieve_return
]
EXPERIMENTS_WITH_FIGURE = [name for name, e in EXPERIMENTS.items() if e.has_figure]


def match_any(names):
    """Return a regular expression that matches names of experiments, or nothing without names."""
    return "|".join(names) or "(?!)"


wildcard_constraints:
    experiment=match_any(EXPERIMENTS),


def list_datasets(names):
    """Return the datasets of experiments."""
    return [f"{RESULTS}/data/{name}.nc" for name in names]


def list_table_parts(name):
    """Return the manifests of the parts of a table."""
    number = count_parts(EXPERIMENTS[name])
    return [f"{RESULTS}/blocks/{name}/part_{part}.json" for part in range(number)]


def list_products(names):
    """Return all products of experiments."""
    return [
        f"{RESULTS}/{path}"
        for name in names
        for path in EXPERIMENTS[name].list_product_paths()
    ]


# Snakemake would take the input of such an experiment for its result.
for NAME, EXPERIMENT in EXPERIMENTS.items() if workflow.is_main_process else ():
    try:
        EXPERIMENT.check_targets(list_products([NAME]), [])
    except ValueError as error:
        raise WorkflowError(str(error)) from None


def list_study_outputs(names):
    """Return the files of studies."""
    return [
        f"{RESULTS}/{path}"
        for name in names
        for paths in STUDIES[name].list_product_paths(name).values()
        for path in paths
    ]


def list_study_products(experiments, groups):
    """Return the products of the studies of these groups, over these experiments only."""
    chosen = {name: EXPERIMENTS[name] for name in experiments}
    return list_study_outputs(select_studies(COMPLETE_STUDIES, chosen, groups))


def list_group_studies(group):
    """Return the products of the studies that need experiments of a group, or name it."""
    papers = GROUPS.get("papers", ())
    others = [] if group == "papers" else list_study_products(papers, ())
    made = list_study_products({*GROUPS.get(group, ()), *papers}, [group])
    return [path for path in made if path not in others]


def list_explorer(experiments):
    """Return the page of the explorer, if its tables are among these experiments."""
    complete = EXPLORER_TABLES and set(EXPLORER_TABLES.values()) <= set(experiments)
    return [f"{RESULTS}/explorer.html"] if complete else []


def list_measured_files(experiment, section):
    """Return the measured table that a section of an experiment names, if any."""
    measured = EXPERIMENTS[experiment].list_measured_names()[section]
    return [f"{SETTINGS.measured_folder}/{measured}"] if measured else []


def escape_param(value):
    """Return a parameter with users' text as JSON, in which Snakemake searches no wildcards."""
    return lambda wildcards: escape_json(value)


def count_cores():
    """Return the number of cores, 1 without `--cores`."""
    return workflow.resource_settings.cores or 1


def choose_threads():
    """Return the threads of a simulation.

    Up to four simulations run in parallel, which hides their start-up times.  A single requested
    experiment has all cores.
    """
    targets = workflow.dag_settings.targets
    requested = {name for target in targets for name in GROUPS.get(target, [target])}
    n_parallel = min(4, len(requested & set(EXPERIMENTS) or SELECTED))
    return max(1, count_cores() // n_parallel)


def choose_study_threads(study):
    """Return the threads of a study: all if its function uses them."""
    return count_cores() if "threads" in study.list_run_parameters() else 1


def list_run_values(study):
    """Return the settings of the run that the function of a study has as parameters."""
    values = {"seed": SETTINGS.seed, "max_stderr": MAX_STDERR}
    used = study.list_run_parameters()
    if "experiments" in used:
        values["experiments"] = {
            n: one.dump_simulation() for n, one in SELECTED.items()
        }
    return {name: value for name, value in values.items() if name in used}


def list_benchmark_files(name):
    """Return the tables and the figure of a benchmark of time against error."""
    suffixes = (".csv", "_times.csv", *FIGURE_SUFFIXES)
    return [f"{RESULTS}/benchmarks/{name}{suffix}" for suffix in suffixes]
