"""Warnings about results whose error is larger than the requested one."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import xarray as xr

from splits.core.progress import LogCallback

ERROR_NAMES = {
    "max_stderr": "standard error",
    "relative_stderr": "relative standard error",
}
"""Keywords of requested errors."""
REACHED_ATTRIBUTES = tuple(f"{key}_reached" for key in ERROR_NAMES)
"""Attributes of the errors that results reach."""
REMEDIES = {
    "max_rays": "max_rays ended the run after {rays} rays, and about {needed:.2g} are necessary: "
    "set a larger max_rays, or a larger {key}",
    "solver_error": "the error of discrete ordinates is larger: set a larger {key}, or "
    "solver='monte_carlo' where the medium has paths",
    "interpolation_bound": "more rays do not reduce the error of the interpolation between "
    "refractive indices, or of the truncation of a deep medium: set a larger {key}",
    "unresolved_lobe": "the expansion does not resolve all of a lobe: set a smaller {key}, or "
    "estimator='bins' of the goniophotometer",
    "max_degree": "lobes are too narrow for the expansion, and more rays do not change this: set "
    "estimator='bins' of the goniophotometer, or a larger {key}",
    "no_light": "no ray contributed to the requested directions: set other directions, or "
    "estimator='bins' of the goniophotometer",
}
"""What to do where a run ended before it reached the requested error, by ``stop_reason``."""

_is_nested: ContextVar[bool] = ContextVar("is_nested", default=False)


@contextmanager
def nest_runs() -> Iterator[bool]:
    """Mark the runs in the block as parts of another one, which warns about their errors.

    Yields whether the block itself is not a part of another run.
    """
    is_outermost = not _is_nested.get()
    token = _is_nested.set(True)
    try:
        yield is_outermost
    finally:
        _is_nested.reset(token)


def describe_missed_error(attributes: Mapping[Any, Any]) -> str:
    """Return what a result's attributes say on a requested error that is not reached, or ""."""
    remedy = REMEDIES.get(attributes.get("stop_reason", ""))
    key = next((key for key in ERROR_NAMES if {key, f"{key}_reached"} <= attributes.keys()), None)
    if remedy is None or key is None:
        return ""
    reached, requested = float(attributes[f"{key}_reached"]), float(attributes[key])
    # The error decreases with the square root of the number of rays.
    rays = int(attributes["rays"])
    advice = remedy.format(key=key, rays=rays, needed=rays * (reached / requested) ** 2)
    return (
        f"the largest {ERROR_NAMES[key]} is {reached:.3g}, more than the requested "
        f"{key} = {requested:g}; {advice}"
    )


def warn_about_missed_error(name: str, result: object, stacklevel: int) -> None:
    """Warn if the result of a public function, a dataset, has a larger error than requested.

    Parameters
    ----------
    name : str
        Name of the function.
    result : object
    stacklevel : int
        As for `warnings.warn`, counted from the caller.
    """
    message = describe_missed_error(getattr(result, "attrs", {}))
    if message:
        warnings.warn(f"{name}: {message}", stacklevel=stacklevel + 1)


def log_missed_error(log: LogCallback, name: str, dataset: xr.Dataset) -> None:
    """Log a line if the dataset of an experiment has a larger error than requested."""
    message = describe_missed_error(dataset.attrs)
    if message:
        log(f"{name}: note: {message}")
