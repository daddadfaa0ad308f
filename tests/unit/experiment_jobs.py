"""Jobs of an experiment file, which reject what its media, instruments and figures cannot use."""

from splits.experiments import load_experiment
from splits.experiments.config.load import locate_errors
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run

COARSE = Accuracy(max_stderr=0.5, relative_stderr=0.5, max_rays=1)


def start_jobs(path, media):
    """Read an experiment file and run it with few rays; errors have the file and the line."""
    experiment = load_experiment(path, media)
    with locate_errors(path):
        run(experiment, COARSE, threads=1)
    return experiment
