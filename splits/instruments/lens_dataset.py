"""Dataset of the statistical lens."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.uncertainty import make_variable

MIN_DETECTED_FRACTION = 0.5
"""Fraction of a ring that must reach a screen for a realization to be included there."""


class FirstRealization(NamedTuple):
    """Rays at the first realization of the surface, for figures.

    Attributes
    ----------
    surface_point : float, shape (rays, 3)
        Where rays hit the surface (m).
    screen_point : float, shape (screens, rays, 2)
        Where they hit the screens (m).
    reaches_screen : bool, shape (screens, rays)
        Whether they reach them.
    """

    surface_point: np.ndarray
    screen_point: np.ndarray
    reaches_screen: np.ndarray


def make_lens_dataset(
    contraction: np.ndarray,
    detected_fraction: np.ndarray,
    first_realization: FirstRealization,
    depths: np.ndarray,
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Return the results as a labelled dataset."""
    is_valid = detected_fraction >= MIN_DETECTED_FRACTION
    contraction_estimate = _average_realizations(contraction, is_valid)
    concentration_estimate = _invert_with_error(*_average_realizations(contraction**2, is_valid))
    dim, by_ray = "screen_depth", ("screen_depth", "ray", "axis")
    reaches_screen = first_realization.reaches_screen.astype(float)
    variables = {
        **make_variable(
            "contraction", dim, *contraction_estimate, "size of the image over the ring's"
        ),
        **make_variable(
            "concentration", dim, *concentration_estimate, "inverse mean square size of the image"
        ),
        **make_variable(
            "detected_fraction",
            ("realization", dim),
            detected_fraction,
            None,
            "fraction of rays on the screen",
        ),
        **make_variable(
            "surface_position",
            ("ray", "point"),
            first_realization.surface_point,
            None,
            "point of the surface",
            "m",
        ),
        **make_variable(
            "screen_position",
            by_ray,
            first_realization.screen_point,
            None,
            "position on the screen",
            "m",
        ),
        **make_variable("detected", by_ray[:2], reaches_screen, None, "whether a ray reaches it"),
    }
    coordinates = {
        dim: (dim, depths, {"long_name": "depth of the screen below the surface", "units": "m"}),
        "axis": ("axis", ["x", "y"], {"long_name": "axis on the screen"}),
        "point": ("point", ["x", "y", "z"], {"long_name": "axis in space"}),
    }
    return xr.Dataset(variables, coordinates, attributes)


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
