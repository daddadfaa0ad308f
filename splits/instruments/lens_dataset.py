"""Dataset of the statistical lens."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import Variable, make_variable

MIN_DETECTED_FRACTION = 0.5
"""Fraction of a ring that must reach a screen for a realization to be included there."""


def make_ray_variables(
    hit_points: np.ndarray, screen_points: np.ndarray, detected: np.ndarray
) -> dict[str, Variable]:
    """Return the rays at one realization of the surface as variables, for figures.

    Parameters
    ----------
    hit_points : float, shape (rays, 3)
        Where rays hit the surface (m).
    screen_points : float, shape (screens, rays, 2)
        Where they hit the screens (m); 0 where they do not reach one.
    detected : bool, shape (screens, rays)
        Whether they reach them.
    """
    points = np.where(detected[..., np.newaxis], screen_points, 0.0)
    by_ray, is_detected = ("screen_depth", "ray"), detected.astype(float)
    return _make_variables(
        {
            "surface_position": (("ray", "point"), hit_points, None, "point of the surface", "m"),
            "screen_position": ((*by_ray, "axis"), points, None, "position on the screen", "m"),
            "detected": (by_ray, is_detected, None, "whether a ray reaches it"),
        }
    )


def make_lens_dataset(
    contraction: np.ndarray,
    detected_fraction: np.ndarray,
    ray_variables: dict[str, Variable],
    depths: np.ndarray,
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Return the results as a labelled dataset."""
    is_valid, dim = detected_fraction >= MIN_DETECTED_FRACTION, "screen_depth"
    size = _average_realizations(contraction, is_valid)
    concentration = _invert_with_error(*_average_realizations(contraction**2, is_valid))
    by_realization = (("realization", dim), detected_fraction, None)
    variables = _make_variables(
        {
            "contraction": (dim, *size, "size of the image over the ring's"),
            "concentration": (dim, *concentration, "inverse mean square size of the image"),
            "detected_fraction": (*by_realization, "fraction of rays on the screen"),
        }
    )
    coordinates = {
        dim: (dim, depths, {"long_name": "depth of the screen below the surface", "units": "m"}),
        "axis": ("axis", ["x", "y"], {"long_name": "axis on the screen"}),
        "point": ("point", ["x", "y", "z"], {"long_name": "axis in space"}),
    }
    return xr.Dataset(variables | ray_variables, coordinates, attributes)


def _make_variables(results: dict[str, tuple[Any, ...]]) -> dict[str, Variable]:
    """Return variables from the arguments of `make_variable` after the name."""
    variables: dict[str, Variable] = {}
    for name, result in results.items():
        variables |= make_variable(name, *result)
    return variables


def _average_realizations(
    values: np.ndarray, valid: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the mean over valid realizations with its standard error, None for a single one."""
    count = valid.sum(axis=0)
    mean = np.where(valid, values, 0.0).sum(axis=0) / count
    if len(values) == 1:
        return mean, None
    square = np.where(valid, (values - mean) ** 2, 0.0).sum(axis=0)
    # Of a single valid realization the error is its value.
    stderr = np.sqrt(square / np.maximum(count - 1, 1) / count)
    return mean, np.where(count > 1, stderr, mean)


def _invert_with_error(
    mean: np.ndarray, stderr: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return 1/mean and its standard error to first order."""
    inverse = 1.0 / np.maximum(mean, np.finfo(float).tiny)
    return inverse, None if stderr is None else stderr * inverse**2
