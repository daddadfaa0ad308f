from .config.experiment import ExperimentConfig as ExperimentConfig
from .config.load import load_experiment as load_experiment
from .config.load import load_experiments as load_experiments
from .config.load import load_settings as load_settings
from .config.settings import Settings as Settings
from .config.simulation import SimulationConfig as SimulationConfig
