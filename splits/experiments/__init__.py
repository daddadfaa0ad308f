"""Experiments described by configuration files: validation, simulation and output."""

from splits.core.optional import import_optional

import_optional("pydantic", "experiments", "experiments and fits need")

from splits.core.yaml import ConfigError, read_yaml
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.load import load_experiment, load_experiments, load_settings
from splits.experiments.config.settings import Settings
from splits.experiments.config.simulation import SimulationConfig

__all__ = [
    "ConfigError",
    "ExperimentConfig",
    "Settings",
    "SimulationConfig",
    "load_experiment",
    "load_experiments",
    "load_settings",
    "read_yaml",
]
