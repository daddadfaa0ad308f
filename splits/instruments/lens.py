"""The statistical lens: a ring of parallel rays through a wavy surface onto a screen.

Budak & Grimailo 2020, section 3.1 and Fig 2.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr

from splits.core.arrays import (
    as_float_array,
    find_labels,
    match_labels,
)
from splits.core.declarations import Quantity
from splits.core.inputs import Numbers, Seed, declare_numbers
from splits.core.keywords import declare_function
from splits.core.uncertainty import make_variable
from splits.core.validation import check_integer, invalid
from splits.kernels.rough_surface.intersection import refract_vertical_rays
from splits.kernels.rough_surface.realization import (
    AMPLITUDE,
    KX,
    N_WAVE_LANES,
    PHASE,
    WAVE_ROWS,
    compute_heights_and_slopes,
)
from splits.media.kinds import check_medium
from splits.media.particle_layer import ParticleLayer
from splits.simulation.run_options import RunOptions

MAX_SCREEN_POINTS = 10_000_000
"""Largest number of points on screens, and of images, in one result."""
MIN_DETECTED_FRACTION = 0.5
"""Fraction of a ring that must reach a screen for a realization to be included there."""
N_SEARCH_POINTS = 161
"""Points per side of the grid on which the highest or lowest point is searched."""


ScreenDepths = Annotated[
    Numbers,
    declare_numbers("depths of the screens", "m", "metres", 0.0, 1e9, open_low=True),
]
RingRadius = Annotated[
    float, Quantity("radius of the ring of rays", "m", low=0.0, high=1e6, open_low=True)
]
RingCentre = Annotated[
    Literal["crest", "trough", "origin"],
    Quantity("point of the surface above which the ring is centred"),
]
SearchHalfWidth = Annotated[
    float | None,
    Quantity(
        "half the side length of the square in which the crest is searched", "m",
        low=1e-9, high=1e6,
    ),
]  # fmt: skip
RingRays = Annotated[int, Quantity("number of rays in the ring", low=3)]
Realizations = Annotated[int, Quantity("number of realizations of the surface", low=1)]


@declare_function
def lens(
    medium: ParticleLayer,
    *,
    screen_depth_m: ScreenDepths,
    radius_m: RingRadius,
    centre_on: RingCentre = "crest",
    half_width_m: SearchHalfWidth = None,
    rays: RingRays = 360,
    realizations: Realizations = 1,
    seed: Seed = 1,
    waves: Any = None,
) -> xr.Dataset:
    """Simulate the image of a ring of vertical rays, through a rough surface, on screens below.

    Parameters
    ----------
    medium : ParticleLayer
        A `splits.ParticleLayer` with a rough surface.  Only its surface and its refractive index
        have an effect.
    screen_depth_m : array_like
        Distances of screens below the surface under the ring's centre (m), increasing from above 0.
    radius_m : float
        Radius of the ring (m).
    centre_on : {"crest", "trough", "origin"}
        Centre of the ring: the highest or lowest point within `half_width_m`, or the origin.
    half_width_m : float
        Half the side of the square that is searched (m); not needed for the origin.
    rays : int
        Number of rays, at least 3, evenly distributed around the ring.
    realizations : int
        Number of realizations of the surface; at least 2 for standard errors.
    seed : int
    waves : array_like, shape (waves, 4), optional
        Amplitudes (m), wave numbers along x and y (1/m) and phases (radians) of cosines, instead
        of realizations of the layer's surface.

    Returns
    -------
    xarray.Dataset
        Over ``screen_depth``: ``contraction``, the root mean square distance of the rays from their
        centre over the radius of the ring, and ``concentration``, the inverse of its mean square: 1
        without waves, otherwise the reduction in area of an image that remains a ring; over
        realizations that transmit at least half of the ring, with standard errors.  Over
        ``realization``, too: ``detected_fraction``, the fraction of rays that reach the screen
        without hitting the surface again; the others are excluded.  Of the first realization, over
        ``ray``: ``surface_position``, where it hits the surface, ``screen_position`` on the screens
        (m) and whether it is ``detected``.

    Raises
    ------
    ValueError
        For a value outside its range, or a layer with a smooth surface.
    """
    check_medium(medium, ParticleLayer)
    depths, radius = np.asarray(screen_depth_m), radius_m
    if half_width_m is None and centre_on != "origin":
        hint = f"half the side of the square searched for the {centre_on}"
        hint += '; centre_on="origin" needs none'
        raise invalid("half_width_m", None, "given (m)", hint)
    width = 0.0 if half_width_m is None else half_width_m
    # Results must fit into memory.
    max_value = MAX_SCREEN_POINTS // depths.size
    for key, number in (("rays", rays), ("realizations", realizations)):
        check_integer(key, number, 1, max_value)
    run = RunOptions.start(seed, threads=1)
    if waves is not None:
        surface_waves = check_plane_waves(waves)
        if realizations > 1:
            raise invalid("realizations", realizations, "1 for given waves")
    elif medium.surface is None:
        raise invalid("surface", None, "given: a lens needs waves")
    angles = 2.0 * np.pi * np.arange(rays) / rays
    contraction = np.empty((realizations, depths.size))
    detected_fraction = np.empty_like(contraction)
    for realization in range(realizations):
        if waves is None:
            surface_waves = medium.surface.sample_realization(run.seed, realization)
        centre_x, centre_y, centre_z = find_centre(surface_waves, centre_on, width)
        ring = (centre_x + radius * np.cos(angles), centre_y + radius * np.sin(angles))
        position, direction, next_hit = refract_vertical_rays(
            surface_waves, medium.refractive_index, *ring
        )
        # Where rays reach the screens, unless they hit the surface before.
        screen_heights = (centre_z - depths)[:, np.newaxis]
        distance = (screen_heights - position[:, 2]) / direction[:, 2]
        points = position[:, :2] + distance[..., np.newaxis] * direction[:, :2]
        detected = (distance >= 0.0) & (distance < next_hit)
        detected_fraction[realization] = detected.mean(axis=1)
        # Root mean square distance of the detected rays from their centre.
        count, weight = np.maximum(detected.sum(axis=1), 1), detected[..., np.newaxis]
        image_centre = (points * weight).sum(axis=1) / count[:, np.newaxis]
        square = ((points - image_centre[:, np.newaxis]) ** 2 * weight).sum(axis=(1, 2)) / count
        contraction[realization] = np.sqrt(square) / radius
        if realization == 0:
            surface_points = position - (centre_x, centre_y, centre_z)
            screen_points = np.where(weight, points - (centre_x, centre_y), 0.0)
            is_detected = detected.astype(float)
    is_valid = detected_fraction >= MIN_DETECTED_FRACTION
    if not is_valid.any(axis=0).all():
        raise invalid(
            "screen_depth_m", float(depths[~is_valid.any(axis=0)][0]),
            f"where a surface lets at least {MIN_DETECTED_FRACTION:g} of the ring through",
            "a smaller ring, or other depths",
        )  # fmt: skip
    size = _average_realizations(contraction, is_valid)
    mean_square, square_stderr = _average_realizations(contraction**2, is_valid)
    inverse = 1.0 / np.maximum(mean_square, np.finfo(float).tiny)
    inverse_stderr = None if square_stderr is None else square_stderr * inverse**2
    dim, on_screen = "screen_depth", ("screen_depth", "ray")
    variables = {
        **make_variable("contraction", dim, *size, "size of the image over the ring's"),
        **make_variable(
            "concentration", dim, inverse, inverse_stderr, "inverse mean square size of the image"
        ),
        **make_variable(
            "detected_fraction", ("realization", dim), detected_fraction, None,
            "fraction of rays on the screen",
        ),
        **make_variable(
            "surface_position", ("ray", "point"), surface_points, None, "point of the surface", "m"
        ),
        **make_variable(
            "screen_position", (*on_screen, "axis"), screen_points, None,
            "position on the screen", "m",
        ),
        **make_variable("detected", on_screen, is_detected, None, "whether a ray reaches it"),
    }  # fmt: skip
    coordinates = {
        dim: (dim, depths, {"long_name": "depth of the screen below the surface", "units": "m"}),
        "axis": ("axis", ["x", "y"], {"long_name": "axis on the screen"}),
        "point": ("point", ["x", "y", "z"], {"long_name": "axis in space"}),
    }
    attributes = {
        **run.make_attributes("Statistical lens", "lens", medium),
        "radius_m": radius, "centre_on": centre_on, "half_width_m": width,
        "realizations": realizations, "rays": rays * realizations,
    }  # fmt: skip
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


def check_plane_waves(waves: Any) -> np.ndarray:
    """Return plane waves in the form of kernels, after checking them; see `lens`."""
    allowed = "rows of amplitude, wave numbers along x and y, and phase"
    table = as_float_array("waves", waves, allowed)
    if table.ndim != 2 or table.shape[1] != 4 or not len(table):
        raise invalid("waves", waves, allowed)
    names = [("amplitude", "wave_number_x", "wave_number_y", "phase")]
    table = table[:, match_labels("waves", find_labels(waves, 1), names)]
    # Kernels use cycles instead of radians, and the order of wave numbers.
    table = table[np.argsort(np.hypot(table[:, 1], table[:, 2]))]
    rows = np.zeros((len(WAVE_ROWS), -(-len(table) // N_WAVE_LANES) * N_WAVE_LANES))
    rows[:, : len(table)] = table.T
    rows[KX:] /= 2.0 * np.pi
    # Bounds of the surface are sums of positive amplitudes.
    rows[PHASE] += 0.5 * (rows[AMPLITUDE] < 0.0)
    rows[AMPLITUDE] = np.abs(rows[AMPLITUDE])
    return rows


def find_centre(waves: np.ndarray, centre_on: str, half_width: float) -> tuple[float, float, float]:
    """Return the centre of the ring, a point of the surface."""
    line = np.linspace(-half_width, half_width, 1 if centre_on == "origin" else N_SEARCH_POINTS)
    x, y = (0.0 * line[:1],) * 2 if centre_on == "origin" else np.meshgrid(line, line)
    x, y = np.ravel(x), np.ravel(y)
    height = compute_heights_and_slopes(waves, x, y).height
    row = int(height.argmin() if centre_on == "trough" else height.argmax())
    return float(x[row]), float(y[row]), float(height[row])
