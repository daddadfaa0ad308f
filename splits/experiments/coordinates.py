"""What the parameters of a grid are called in datasets, and their units."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from splits.names import parameter_about, path_of

MEANS: dict[str, Callable[[Sequence[float]], float]] = {
    "facetness": lambda given: given[2],
    "grain_size_um": lambda given: 0.5 * (given[0] + given[1]),
    "roundness": lambda given: given[0],
    "sphericity": lambda given: given[2],
}
"""The number that stands for a range or a distribution, by its parameter."""

Coordinate = tuple[str, np.ndarray, dict[str, str]]
"""Dimension, values and attributes, as `xarray.Dataset` takes them."""


def grid_coordinates(grid: Mapping[str, Mapping[str, Any]]) -> dict[str, Coordinate]:
    """Return the coordinates of an experiment's grid.

    Parameters
    ----------
    grid : mapping
        Per parameter its values by label.

    Returns
    -------
    dict
        Per parameter numbers in the parameter's unit where all values are numbers, and labels
        otherwise; labels have no units, so that their long name says the unit.  Beside labels of
        ranges and distributions stand their means as ``…_mean``, so that one can interpolate.
    """
    found = {}
    for parameter, choices in grid.items():
        long_name, units = parameter_about(parameter)
        values = coordinate_values(choices)
        if values.dtype.kind == "f":
            about = {"long_name": long_name, "units": units}
        else:
            about = {"long_name": long_name + (f" ({units})" if units != "1" else "")}
        found[parameter] = (parameter, values, about)
        means = means_of(parameter, choices)
        if means is not None:
            about = {"long_name": f"mean of: {long_name}", "units": units}
            found[f"{parameter}_mean"] = (parameter, means, about)
    return found


def means_of(parameter: str, choices: Mapping[str, Any]) -> np.ndarray | None:
    """Return the mean of each value of a grid, None where values are no ranges."""
    path = path_of(parameter)
    mean = MEANS.get(path[1] if path else parameter)
    several = all(isinstance(value, (list, tuple)) for value in choices.values())
    if mean is None or not several:
        return None
    return np.array([float(mean(value)) for value in choices.values()])


def coordinate_values(choices: Mapping[str, Any]) -> np.ndarray:
    """Return numbers where all grid values are numbers, and labels otherwise."""
    if all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in choices.values()):
        return np.array([float(v) for v in choices.values()])
    return np.array(list(choices), dtype=object).astype(str)
