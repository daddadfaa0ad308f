"""Heights of a realisation of a rough surface, on a grid, and how rough realisations are."""

from __future__ import annotations

import time

import numpy as np
import xarray as xr

from splits.checks import known_arguments, refuse
from splits.instruments.arguments import check_half_width, check_medium, check_whole
from splits.instruments.labels import run_facts
from splits.media.turbid import SurfaceMedium
from splits.transport.rough.waves import reliefs_at
from splits.uncertainty import quantity

POINTS = 201
MOST_REALISATIONS = 10_000_000


@known_arguments
def surface_map(
    medium: SurfaceMedium,
    half_width_m: float,
    *,
    points: int = POINTS,
    realisations: int = 100,
    seed: int = 1,
) -> xr.Dataset:
    """Return the heights of a layer's surface around the origin.

    Parameters
    ----------
    medium : SurfaceMedium
        A `splits.Layer` with a rough surface.
    half_width_m : float
        Half the side of the square shown (m).
    points : int
        Per side, at least 2.
    realisations : int
        At least 2, from which roughness is estimated; the first is shown.
    seed : int

    Returns
    -------
    xarray.Dataset
        ``height`` (m) over ``x`` and ``y``; ``rms_height`` (m) and ``rms_slope`` (of the gradient)
        of each realisation, over the square.

    Raises
    ------
    ValueError
        For a value outside its range, or a layer with a smooth surface.

    References
    ----------
    Budak & Grimailo 2020, Eq 3 and Fig 1.
    """
    begun = time.perf_counter()
    check_medium(medium, SurfaceMedium)
    width = check_half_width("surface", half_width_m)
    points = check_whole("points", points, 2, 3000)
    realisations = check_whole("realisations", realisations, 2, MOST_REALISATIONS)
    seed = check_whole("seed", seed, 0)
    if medium.surface is None:
        raise refuse("surface", None, "given: there is nothing to map")
    line = np.linspace(-width, width, points)
    x, y = (part.ravel() for part in np.meshgrid(line, line, indexing="ij"))
    # Roughness needs fewer points than a picture.
    few = np.linspace(-width, width, 41)
    u, v = (part.ravel() for part in np.meshgrid(few, few, indexing="ij"))
    rough = np.empty((2, realisations))
    for number in range(realisations):
        waves = medium.surface.realisation(seed, number)
        if number == 0:
            height = reliefs_at(waves, x, y).height.reshape(points, points)
        z, slope = reliefs_at(waves, u, v)
        rough[:, number] = np.sqrt(np.mean(z**2)), np.sqrt(np.mean(slope.x**2 + slope.y**2))
    facts = {
        **run_facts("Rough surface", "surface", medium, begun, seed),
        "realisations": realisations,
        "rays": 0,
    }
    variables = {
        **quantity("height", ("x", "y"), height, None, "height of the surface", "m"),
        **quantity("rms_height", "realisation", rough[0], None, "rms height of the square", "m"),
        **quantity("rms_slope", "realisation", rough[1], None, "rms slope of the square"),
    }
    about = {"units": "m", "long_name": "horizontal distance"}
    return xr.Dataset(variables, {"x": ("x", line, about), "y": ("y", line, about)}, facts)
