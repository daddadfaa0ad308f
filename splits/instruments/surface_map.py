"""Height map of a realization of a rough surface, and the roughness of realizations."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import xarray as xr

from splits.core.declarations import Quantity
from splits.core.inputs import Seed
from splits.core.keywords import declare_function
from splits.core.uncertainty import make_variable
from splits.core.validation import invalid
from splits.kernels.rough_surface.realization import (
    compute_heights_and_slopes,
)
from splits.media.kinds import check_medium
from splits.media.particle_layer import ParticleLayer
from splits.simulation.run_options import RunOptions

MapHalfWidth = Annotated[
    float, Quantity("half the side length of the map", "m", low=1e-9, high=1e9)
]
MapPoints = Annotated[int, Quantity("number of points per side", low=2, high=3000)]
MapRealizations = Annotated[
    int, Quantity("number of realizations of the surface", low=2, high=10_000_000)
]


@declare_function
def surface_map(
    medium: ParticleLayer,
    *,
    half_width_m: MapHalfWidth,
    points: MapPoints = 201,
    realizations: MapRealizations = 100,
    seed: Seed = 1,
) -> xr.Dataset:
    """Return the heights of the rough surface of a layer around the origin.

    Parameters
    ----------
    medium : ParticleLayer
        A `splits.ParticleLayer` with a rough surface.
    half_width_m : float
        Half the side of the mapped square (m).
    points : int
        Number of points per side, at least 2.
    realizations : int
        Number of realizations, at least 2, from which the roughness is estimated; the first is
        mapped.
    seed : int

    Returns
    -------
    xarray.Dataset
        ``height`` (m) over ``x`` and ``y``; ``rms_height`` (m) and ``rms_slope`` (of the gradient)
        of each realization, over the square.

    Raises
    ------
    ValueError
        For a value outside its range, or a layer with a smooth surface.

    References
    ----------
    Budak & Grimailo 2020, Eq 3 and Fig 1.
    """
    check_medium(medium, ParticleLayer)
    run, width = RunOptions.start(seed, threads=1), half_width_m
    if medium.surface is None:
        raise invalid("surface", None, "given for a map")
    positions = np.linspace(-width, width, points)
    x, y = (axis.ravel() for axis in np.meshgrid(positions, positions, indexing="ij"))
    # Roughness needs fewer points than a map.
    coarse_line = np.linspace(-width, width, 41)
    u, v = (axis.ravel() for axis in np.meshgrid(coarse_line, coarse_line, indexing="ij"))
    roughness = np.empty((2, realizations))
    for realization in range(realizations):
        waves = medium.surface.sample_realization(run.seed, realization)
        if realization == 0:
            height = compute_heights_and_slopes(waves, x, y).height.reshape(points, points)
        z, slope = compute_heights_and_slopes(waves, u, v)
        roughness[:, realization] = np.sqrt([np.mean(z**2), np.mean(slope.x**2 + slope.y**2)])
    attributes = {
        **run.make_attributes("Rough surface", "surface_map", medium),
        "realizations": realizations,
        "rays": 0,
    }
    dim, (rms_height, rms_slope) = "realization", roughness
    variables = {
        **make_variable("height", ("x", "y"), height, None, "height of the surface", "m"),
        **make_variable("rms_height", dim, rms_height, None, "rms height of the square", "m"),
        **make_variable("rms_slope", dim, rms_slope, None, "rms slope of the square"),
    }
    distance = {"units": "m", "long_name": "horizontal distance"}
    coordinates = {"x": ("x", positions, distance), "y": ("y", positions, distance)}
    return xr.Dataset(variables, coordinates, attributes)
