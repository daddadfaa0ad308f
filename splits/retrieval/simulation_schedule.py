"""Schedule of a retrieval by simulations: stages, errors, and progress over all runs."""

from __future__ import annotations

import time

import numpy as np

from splits.core.progress import Progress, ProgressCallback
from splits.retrieval.medium_model import DESCENT_STAGES, N_SURVEY

SURVEY_STDERR = 0.01
"""Standard error of simulations of the survey and of the first descents."""
MIN_JACOBIAN_STDERR = 0.004
"""Smallest standard error of simulations for Jacobians, of which several are averaged."""
N_JACOBIANS_RANGE = (2, 6)
"""Smallest and largest number of independent Jacobians for the errors."""


class ProgressTracker:
    """Progress of a retrieval over all of its simulations.

    Parameters
    ----------
    report : callable, optional
    max_stderr : float
        Final standard error.
    n_parameters : int
    """

    def __init__(self, report: ProgressCallback, max_stderr: float, n_parameters: int) -> None:
        self.report, self.max_stderr = report, max_stderr
        final_cost, jacobian_cost = (
            _estimate_cost(max_stderr),
            count_runs(n_parameters) * _estimate_cost(max(max_stderr, MIN_JACOBIAN_STDERR)),
        )
        # Each descent needs about two Jacobians and a few steps; descents of the last stage mostly
        # start at the minimum.  Jacobians for errors and the test of linearity follow.
        survey_cost = N_SURVEY + DESCENT_STAGES[0].n_starts * 2 * (2 + count_runs(n_parameters))
        last_stage_cost = DESCENT_STAGES[1].n_starts * (4 * final_cost + jacobian_cost)
        self.total_cost = (
            survey_cost
            + last_stage_cost
            + float(np.mean(N_JACOBIANS_RANGE)) * jacobian_cost
            + 2 * n_parameters * final_cost
        )
        self.spent_cost, self.start_time = 0.0, time.perf_counter()

    def track_run(self, max_stderr: float, n_runs: int) -> ProgressCallback:
        """Return the callback for the progress of several simulations with an error."""
        if not callable(self.report):
            return None
        cost, report = n_runs * _estimate_cost(max_stderr), self.report
        previous_cost = self.spent_cost
        self.spent_cost += cost

        def show(progress: Progress) -> None:
            elapsed = time.perf_counter() - self.start_time
            done = previous_cost + progress.fraction_done * cost
            seconds_left = (
                max(self.total_cost - done, 0.0) * elapsed / done
                if done > 0.0
                else progress.seconds_left
            )
            report(
                Progress(
                    progress.rays,
                    progress.stderr,
                    self.max_stderr,
                    elapsed,
                    max(seconds_left, progress.seconds_left),
                )
            )

        return show


def count_runs(n_parameters: int) -> int:
    """Return the typical number of simulations for a spectrum and its derivatives."""
    return 1 + 5 * n_parameters


def _estimate_cost(max_stderr: float) -> float:
    """Return the cost of a simulation with an error, in units of those of the survey."""
    return (SURVEY_STDERR / max_stderr) ** 2
