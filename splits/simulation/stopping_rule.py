"""When and why tracing stops."""

from __future__ import annotations

from typing import Any, NamedTuple

STOP_REASONS = (
    "converged", "fixed_rays", "unresolved_lobe", "interpolation_bound", "solver_error", "no_light",
    "max_degree", "max_rays",
)  # fmt: skip
"""Why runs stop; "solver_error": discrete ordinates have a larger error than the requested one.
Where several runs serve one result, the last of their reasons is stated."""


class StoppingRule(NamedTuple):
    """When tracing stops.

    Attributes
    ----------
    max_error : float
        Largest error, absolute or relative as the tally defines it.
    max_rays : int
        Number of rays at which tracing stops in any case.
    fixed : bool
        Whether `max_rays` rays are traced whatever the error is.
    """

    max_error: float
    max_rays: int
    fixed: bool = False

    def find_reason(self, evaluation: Evaluation, n_rays: int) -> str:
        """Return why tracing stops after a number of rays, or an empty string."""
        exhausted = n_rays >= self.max_rays
        if self.fixed:
            return "fixed_rays" if exhausted else ""
        if evaluation.stop_reason:
            return evaluation.stop_reason
        if evaluation.error <= self.max_error:
            return "converged"
        return "max_rays" if exhausted else ""


class Evaluation(NamedTuple):
    """State of a run after a round of rays, and its result after the last.

    Attributes
    ----------
    error : float
        Largest error reached, as the tally defines it.
    estimate : object
        Estimate from all rays so far, which the tally defines.
    stop_reason : str
        One of `STOP_REASONS` once a run has stopped.  Before, a reason of the tally other than the
        error and the number of rays, or an empty string.
    """

    error: float
    estimate: Any = None
    stop_reason: str = ""
