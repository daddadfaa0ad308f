"""Calls of public functions: unknown keywords, progress, and errors larger than requested."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import wraps
from inspect import Parameter, signature
from os import PathLike
from typing import Any, ParamSpec, TypeVar

import numpy as np
import xarray as xr

from splits.core.declarations import list_inputs
from splits.core.progress import LogCallback, open_progress
from splits.core.validation import InvalidValue, short_repr, unknown_key

Given = ParamSpec("Given")
Result = TypeVar("Result")


def _are_wavelengths(value: object) -> bool:
    # Rows of different lengths form no array.
    with suppress(ValueError):
        numbers = np.asarray(value)
        return numbers.dtype.kind in "iuf" and bool((numbers >= 200).all())
    return False


RECOGNIZED_ARGUMENTS: dict[str, Callable[[Any], bool]] = {
    **dict.fromkeys(("medium", "model"), lambda value: hasattr(value, "scene_layers")),
    "sky": lambda value: isinstance(value, str) or hasattr(value, "compute_direct_fraction"),
    "wavelength_nm": _are_wavelengths,
    "grid": lambda value: isinstance(value, Mapping),
    "make": callable,
    "path": lambda value: isinstance(value, str | PathLike),
}
"""Functions that recognize a value of an argument, by its name."""


def suggest_order(
    error: InvalidValue, name: str, names: Sequence[str], values: Sequence[Any]
) -> InvalidValue:
    """Return an error with the order of arguments as a hint if some of them are exchanged.

    Parameters
    ----------
    error : InvalidValue
    name : str
        Name of the function.
    names : sequence of str
        Its arguments in order.
    values : sequence
        Values without a keyword.
    """
    given = dict(zip(names, values, strict=False))
    key = re.split(r"\W", error.key, maxsplit=1)[0]
    # Another argument than that of the error may be recognized.
    is_exchanged = any(
        not recognize(given[one]) and any(map(recognize, given.values()))
        for one, recognize in RECOGNIZED_ARGUMENTS.items() if one in given
    )  # fmt: skip
    if key in given and is_exchanged:
        arguments = ", ".join(one for one in given if one != "self")
        error.hint = f"the order is {name}({arguments})"
    return error


def declare_function(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Decorate a public function to check its declared inputs, and to reject unknown keywords.

    The function receives its inputs in their final form, also their defaults other than None; see
    `splits.core.declarations`.  Errors of invalid values and missing files are raised from here, so
    that the traceback shows the line of the call without the internal calls between it and the
    check.  The keyword ``progress=True`` becomes a progress bar, see
    `splits.core.progress.open_progress`.  A function that is asked for an error warns once if its
    result does not reach it.
    """
    parameters = signature(function).parameters
    positional = [n for n, one in parameters.items() if one.kind is Parameter.POSITIONAL_OR_KEYWORD]
    keyword_only = [n for n, one in parameters.items() if one.kind is Parameter.KEYWORD_ONLY]
    requests_error = not parameters.keys().isdisjoint(ERROR_NAMES)
    takes_any = any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters.values())
    names = [name for name in parameters if name not in ("self", "cls")]

    @wraps(function)
    def checked(*values: Given.args, **keywords: Given.kwargs) -> Result:
        unknown = [key for key in keywords if key not in names and not takes_any]
        if unknown:
            raise unknown_key(unknown[0], names)
        if len(values) > len(positional) and keyword_only:
            surplus = short_repr(values[len(positional)])
            raise TypeError(f"{surplus}: must have a keyword, such as {keyword_only[0]}={surplus}")
        try:
            with (
                open_progress(function.__name__, keywords.get("progress")) as callback,
                nest_runs() as is_outermost,
            ):
                if "progress" in keywords:
                    keywords["progress"] = callback
                given = dict(zip(positional, values, strict=False))
                if len(given) == len(values) and given.keys().isdisjoint(keywords):
                    given |= keywords
                    inputs = list_inputs(function)
                    given |= {
                        name: one.check(name, given.get(name, one.default))
                        for name, one in inputs.items() if name in given or one.has_default
                    }  # fmt: skip
                    result = function(**given)  # type: ignore[arg-type,call-arg]
                else:
                    # Python raises an error for what is given twice.
                    result = function(*values, **keywords)
        except InvalidValue as error:
            error = suggest_order(error, function.__name__, positional, values)
            raise error.with_traceback(None) from None
        except FileNotFoundError as error:
            raise error.with_traceback(None) from None
        if requests_error and is_outermost:
            message = describe_missed_error(getattr(result, "attrs", {}))
            if message:
                warnings.warn(f"{function.__name__}: {message}", stacklevel=2)
        return result

    return checked


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


def log_missed_error(log: LogCallback, name: str, dataset: xr.Dataset) -> None:
    """Log a line if the dataset of an experiment has a larger error than requested."""
    message = describe_missed_error(dataset.attrs)
    if message:
        log(f"{name}: note: {message}")
