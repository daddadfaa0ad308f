"""Grids of an experiment: labels, values, evenly spaced values, coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from splits.arrays import MOST_NUMBERS
from splits.checks import named, number, refuse
from splits.experiments.texts import LONGEST_LABEL, check_text

MOST_POINTS = 10_000
"""Points of a grid."""
STEPS = ("start", "stop", "step")
GEOMETRIC = "geomspace"


def evenly_spaced(key: str, start: float, stop: float, step: float) -> np.ndarray:
    """Return start, start + step, … up to stop, which belongs to them, or refuse the three."""
    if not step > 0.0:
        raise refuse(f"{key}.step", step, "above 0")
    if stop < start:
        raise refuse(f"{key}.stop", stop, f"at least start = {start:g}")
    # A step may be so small that the quotient is infinite.
    if (stop - start) / MOST_NUMBERS >= step:
        raise refuse(f"{key}.step", step, f"large enough for at most {MOST_NUMBERS} values")
    return start + step * np.arange(int((stop - start) / step + 1e-9) + 1)


def labelled(grid: Any) -> dict[str, dict[str, Any]]:
    """Return the grid of an experiment file with a label for every value.

    Parameters
    ----------
    grid : mapping
        From parameters to lists of values, mappings from labels to values,
        ``{start, stop, step}``, or ``{geomspace: [first, last, number]}``.

    Raises
    ------
    ValueError
        For a parameter without values, values given twice, and labels that cannot be shown.
    """
    if not isinstance(grid, Mapping):
        raise refuse("grid", grid, "a mapping from parameters to lists of values")
    return {str(parameter): _labelled(str(parameter), v) for parameter, v in grid.items()}


def _labelled(parameter: str, values: Any) -> dict[str, Any]:
    """Return the values of a parameter by label."""
    key = f"grid.{named(parameter)}"
    if not isinstance(values, (list, tuple, Mapping)) or not values:
        raise refuse(key, values, "a list of at least one value")
    if isinstance(values, Mapping) and _are_steps(values):
        values = _steps(key, values)
    elif isinstance(values, Mapping) and set(values) == {GEOMETRIC}:
        values = _geometric(f"{key}.{GEOMETRIC}", values[GEOMETRIC])
    if not isinstance(values, Mapping):
        labels = [label_of(key, value) for value in values]
        if len(set(labels)) < len(labels):
            raise refuse(key, values, "different values", "or name them")
        values = dict(zip(labels, values, strict=True))
    numbers = [v for v in values.values() if _is_number(v)]
    if len(set(numbers)) < len(numbers):
        raise refuse(key, dict(values), "different values")
    for label in values:
        check_text(f"{key} (label)", str(label), LONGEST_LABEL)
    return {str(label): value for label, value in values.items()}


def _are_steps(values: Mapping[Any, Any]) -> bool:
    """Tell whether a mapping's keys are of ``{start, stop, step}`` and its values numbers."""
    several = len(set(STEPS) & set(values)) >= 2 and set(values) <= {*STEPS, "also"}
    return several and all(_is_number(values[key]) for key in STEPS if key in values)


def _steps(key: str, values: Mapping[str, Any]) -> list[float]:
    """Return the evenly spaced values of a parameter."""
    for name in STEPS:
        if name not in values:
            hint = "start, stop and step give evenly spaced values; label others otherwise"
            raise refuse(f"{key}.{name}", None, "given", hint)
    if "also" in values:
        raise refuse(f"{key}.also", values["also"], "left out", "list the values instead")
    start, stop, step = (number(f"{key}.{name}", values[name]) for name in STEPS)
    # 0.30000000000000004 is nobody's value.
    return [float(f"{x:.12g}") for x in evenly_spaced(key, start, stop, step)]


def _geometric(key: str, given: Any) -> list[float]:
    """Return values of which each is as many times the one before."""
    allowed = "[first, last, number of values]: 0 < first < last, at least two"
    numbers = isinstance(given, (list, tuple)) and all(map(_is_number, given))
    if not numbers or len(given) != 3:
        raise refuse(key, given, allowed)
    first, last, count = given
    if not 0.0 < first < last or count != int(count) or not 2 <= count <= MOST_NUMBERS:
        raise refuse(key, given, allowed)
    # No figure has room for more digits.
    return [float(f"{x:.4g}") for x in np.geomspace(first, last, int(count))]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def label_of(key: str, value: Any) -> str:
    """Return a short label for a grid value: "300-750" for a range, the mean of a distribution."""
    if isinstance(value, (list, tuple)):
        if len(value) == 4:
            return _label(key, value[2])
        return "-".join(_label(key, v) for v in value)
    if isinstance(value, dict):
        raise refuse(key, value, "named: use a mapping from labels to values")
    return _label(key, value)


def _label(key: str, value: Any) -> str:
    if not _is_number(value):
        # A table by its name: where it lies is nobody's label.
        return PurePath(value).name if str(value).endswith(".csv") else str(value)
    return f"{value:g}" if isinstance(value, float) else f"{number(key, value):g}"


def label_at(parameter: str, values: Mapping[str, Any], given: float | str) -> str:
    """Return the label of the value that a figure is to hold fixed, or refuse what is none.

    Text is a label, or a value that is text; a number is a value, or the number that a label
    shows of a value that is none, such as a distribution's mean.

    Parameters
    ----------
    parameter : str
    values : mapping
        Of the parameter, by label.
    given : number or str
        What the figure section names.
    """
    if isinstance(given, str) and given in values:
        return given
    hits = [label for label, value in values.items() if _is_same(value, given)]
    if hits:
        return hits[0]
    shown = str(given) if isinstance(given, str) else f"{given:g}"
    if shown in values and not _is_number(values[shown]):
        return shown
    names = ", ".join(named(label) for label in list(values)[:12])
    more = f", … ({len(values)} in all)" if len(values) > 12 else ""
    raise refuse(f"figure.at.{named(parameter)}", given, f"one of {names}{more}")


def _is_same(value: Any, given: float | str) -> bool:
    if isinstance(given, str):
        return isinstance(value, str) and value == given
    return _is_number(value) and float(value) == float(given)
