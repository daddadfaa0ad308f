"""Heights of a realisation of a rough surface, on a grid, and how rough realisations are."""

from __future__ import annotations

import time

import numpy as np
import xarray as xr

from splits.core.uncertainty import make_variable
from splits.core.validation import invalid, reject_unknown_arguments
from splits.kernels.rough_surface.realization import compute_heights_and_slopes
from splits.media.medium import SurfaceMedium
from splits.simulation.arguments import check_half_width, check_integer, check_medium
from splits.simulation.attributes import make_run_attributes

DEFAULT_POINTS = 201
MAX_REALIZATIONS = 10_000_000


@reject_unknown_arguments
def surface_map(
    medium: SurfaceMedium,
    half_width_m: float,
    *,
    points: int = DEFAULT_POINTS,
    realisations: int = 100,
    seed: int = 1,
) -> xr.Dataset:
    """Return the heights of a layer's surface around the origin.

    Parameters
    ----------
    medium : SurfaceMedium
        A `splits.ParticleLayer` with a rough surface.
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
    width = check_half_width("surface_map", half_width_m)
    points = check_integer("points", points, 2, 3000)
    realisations = check_integer("realisations", realisations, 2, MAX_REALIZATIONS)
    seed = check_integer("seed", seed, 0)
    if medium.surface is None:
        raise invalid("surface", None, "given: there is nothing to map")
    line = np.linspace(-width, width, points)
    x, y = (part.ravel() for part in np.meshgrid(line, line, indexing="ij"))
    # Roughness needs fewer points than a picture.
    few = np.linspace(-width, width, 41)
    u, v = (part.ravel() for part in np.meshgrid(few, few, indexing="ij"))
    rough = np.empty((2, realisations))
    for number in range(realisations):
        waves = medium.surface.sample_realization(seed, number)
        if number == 0:
            height = compute_heights_and_slopes(waves, x, y).height.reshape(points, points)
        z, slope = compute_heights_and_slopes(waves, u, v)
        rough[:, number] = np.sqrt(np.mean(z**2)), np.sqrt(np.mean(slope.x**2 + slope.y**2))
    facts = {
        **make_run_attributes("Rough surface", "surface_map", medium, begun, seed),
        "realisations": realisations,
        "rays": 0,
    }
    variables = {
        **make_variable("height", ("x", "y"), height, None, "height of the surface", "m"),
        **make_variable(
            "rms_height", "realisation", rough[0], None, "rms height of the square", "m"
        ),
        **make_variable("rms_slope", "realisation", rough[1], None, "rms slope of the square"),
    }
    about = {"units": "m", "long_name": "horizontal distance"}
    return xr.Dataset(variables, {"x": ("x", line, about), "y": ("y", line, about)}, facts)
