"""Experiments as configuration: validation, grids, names, runs."""

from splits.experiments.load import load_experiment, load_experiments, load_settings
from splits.experiments.model import ConfigError, Experiment
from splits.experiments.settings import Settings

__all__ = [
    "ConfigError",
    "Experiment",
    "Settings",
    "load_experiment",
    "load_experiments",
    "load_settings",
]
