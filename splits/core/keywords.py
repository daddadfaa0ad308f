"""Rejection of unknown keywords, with a message that lists the known ones."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from functools import wraps
from inspect import Parameter, signature
from os import PathLike
from typing import Any, ParamSpec, TypeVar

import numpy as np

from splits.core.convergence import ERROR_NAMES, nest_runs, warn_about_missed_error
from splits.core.progress import open_progress
from splits.core.validation import InvalidValue, short_repr, unknown_key

Class = TypeVar("Class", bound=type)
Given = ParamSpec("Given")
Result = TypeVar("Result")


def list_keywords(kind: Any) -> list[str]:
    """Return the keywords of a dataclass: its fields and those in `OTHER_KEYWORDS`."""
    return [field.name for field in fields(kind)] + list(getattr(kind, "OTHER_KEYWORDS", ()))


def reject_unknown_keywords(kind: Class) -> Class:
    """Decorate a dataclass to reject unknown keywords with a message that lists the known ones.

    Errors are raised from here; see `reject_unknown_arguments`.
    """
    construct: Callable[..., None] = kind.__init__  # type: ignore[misc]

    @wraps(construct)
    def checked(self: Any, *values: Any, **keywords: Any) -> None:
        _check_keywords(keywords, list_keywords(kind))
        try:
            construct(self, *values, **keywords)
        except (InvalidValue, FileNotFoundError) as error:
            raise error.with_traceback(None) from None

    kind.__init__ = checked  # type: ignore[misc]
    return kind


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
    """Return an error with the order of arguments as a hint if another one would suit its key.

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
    recognize = RECOGNIZED_ARGUMENTS.get(key, lambda value: True)
    if key not in given or recognize(given[key]) or not any(map(recognize, given.values())):
        return error
    order = f"the order is {name}({', '.join(one for one in given if one != 'self')})"
    return type(error)(error.key, error.value, error.allowed, order)


def reject_unknown_arguments(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Decorate a public function to reject unknown keywords with a list of the known ones.

    Errors of invalid values and missing files are raised from here, so that the traceback shows
    the line of the call without the internal calls between it and the check.  The keyword
    ``progress=True`` becomes a progress bar, see `splits.core.progress.open_progress`.  A function
    that is asked for an error warns once if its result does not reach it.
    """
    parameters = signature(function).parameters
    positional = [n for n, one in parameters.items() if one.kind is Parameter.POSITIONAL_OR_KEYWORD]
    keyword_only = [n for n, one in parameters.items() if one.kind is Parameter.KEYWORD_ONLY]
    requests_error = not parameters.keys().isdisjoint(ERROR_NAMES)
    takes_any = any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters.values())
    names = None if takes_any else [name for name in parameters if name not in ("self", "cls")]

    @wraps(function)
    def checked(*values: Given.args, **keywords: Given.kwargs) -> Result:
        _check_keywords(keywords, names)
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
                result = function(*values, **keywords)
        except InvalidValue as error:
            error = suggest_order(error, function.__name__, positional, values)
            raise error.with_traceback(None) from None
        except FileNotFoundError as error:
            raise error.with_traceback(None) from None
        if requests_error and is_outermost:
            warn_about_missed_error(function.__name__, result, stacklevel=2)
        return result

    return checked


def _check_keywords(keywords: Mapping[str, Any], names: list[str] | None) -> None:
    """Check that keywords are known; None allows all."""
    for key in keywords:
        if names is not None and key not in names:
            raise unknown_key(key, names)
