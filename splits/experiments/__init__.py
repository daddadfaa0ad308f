"""Experiments as configuration: validation, grids, names, runs."""

from splits.extras import optional

optional("pydantic", "experiments", "experiments and fits need")

from splits.experiments.load import load_experiment, load_experiments, load_settings
from splits.experiments.model import Experiment
from splits.experiments.settings import Settings
from splits.experiments.simulation import Simulation
from splits.experiments.yaml_files import ConfigError, read_yaml

__all__ = [
    "ConfigError",
    "Experiment",
    "Settings",
    "Simulation",
    "load_experiment",
    "load_experiments",
    "load_settings",
    "read_yaml",
]
