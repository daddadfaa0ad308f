"""Call the function of a study, and write what it returns (snakemake script)."""

import json
import sys

from splits.core.process import exit_on_signals

exit_on_signals(snakemake.rule)

from importlib import import_module
from pathlib import Path

import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from splits import load, save
from splits.core.escaping import write_data_frame
from splits.core.progress import open_progress_log
from splits.core.validation import invalid
from splits.experiments.config.settings import TABLE_READERS, Study
from splits.experiments.config.simulation import SimulationConfig
from splits.io.netcdf import exit_if_damaged
from splits.plotting import save_figure

WRITERS = {
    ".csv": (pd.DataFrame, write_data_frame),
    ".nc": (xr.Dataset, save),
    ".png": (Figure, lambda figure, path: save_figure(figure, path.with_suffix(""))),
}
"""Type of an output, and what writes it, by suffix."""

exit_if_damaged(snakemake.input)
sys.path.insert(0, str(Path(__file__).parents[2]))
study = Study.model_validate_json(snakemake.params.study)
arguments = study.options | dict(zip(study.inputs, map(load, snakemake.input.data), strict=True))
tables = iter(snakemake.input.tables)
for kind, read in TABLE_READERS.items():
    for parameter in getattr(study, kind):
        arguments[parameter] = read(Path(next(tables)), f"{kind}.{parameter}")

with open_progress_log(snakemake.log[0]) as log:
    run = json.loads(snakemake.params.run) | {"threads": snakemake.threads, "log": log}
    run["experiments"] = {
        name: SimulationConfig.model_validate(content)
        for name, content in run.get("experiments", {}).items()
    }
    arguments |= {name: run[name] for name in study.list_run_parameters()}
    module, _, name = study.function.rpartition(".")
    made = getattr(import_module(module), name)(**arguments)

products = made if isinstance(made, tuple) else (made,)
names = snakemake.params.outputs
paths = {Path(path).name: Path(path) for path in snakemake.output}
kinds = [WRITERS[Path(name).suffix][0] for name in names]
if len(products) != len(kinds) or not all(map(isinstance, products, kinds)):
    returned = [type(product).__name__ for product in products]
    expected = ", ".join(
        f"{kind.__name__} ({name})" for kind, name in zip(kinds, names, strict=False)
    )
    raise invalid(f"studies.{snakemake.rule}.function", returned, f"one that returns {expected}")
for name, product in zip(names, products, strict=True):
    WRITERS[Path(name).suffix][1](product, paths[name])
