"""The statistical lens: a ring of parallel rays through a wavy surface onto a screen.

Budak & Grimailo 2020, section 3.1 and Fig 2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import (
    as_1d_array,
    as_float_array,
    check_axis,
    find_labels,
    match_labels,
)
from splits.core.keywords import reject_unknown_arguments
from splits.core.validation import check_choice, check_integer, check_range, invalid
from splits.instruments.lens_dataset import (
    MIN_DETECTED_FRACTION,
    make_lens_dataset,
    make_ray_variables,
)
from splits.kernels.rough_surface.intersection import RefractedRays, refract_vertical_rays
from splits.kernels.rough_surface.realization import (
    AMPLITUDE,
    KX,
    N_WAVE_LANES,
    PHASE,
    WAVE_ROWS,
    compute_heights_and_slopes,
)
from splits.media.checks import check_medium
from splits.media.particle_layer import ParticleLayer
from splits.simulation.run_options import RunOptions, check_half_width

CENTRE_CHOICES = ("crest", "trough", "origin")
DEFAULT_RAYS = 360
MAX_SCREEN_POINTS = 10_000_000
"""Largest number of points on screens, and of images, in one result."""
N_SEARCH_POINTS = 161
"""Points per side of the grid on which the highest or lowest point is searched."""


@reject_unknown_arguments
def lens(
    medium: ParticleLayer,
    screen_depth_m: Any,
    radius_m: float,
    *,
    centre_on: str = "crest",
    half_width_m: float | None = None,
    rays: int = DEFAULT_RAYS,
    realizations: int = 1,
    seed: int = 1,
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
    depths = check_screen_depths("screen_depth_m", screen_depth_m)
    radius = check_ring_radius(radius_m)
    check_choice("centre_on", centre_on, CENTRE_CHOICES)
    if half_width_m is None and centre_on != "origin":
        hint = f"half the side of the square searched for the {centre_on}"
        hint += '; centre_on="origin" needs none'
        raise invalid("half_width_m", None, "given (m)", hint)
    width = 0.0 if half_width_m is None else check_half_width("lens", half_width_m)
    rays, realizations = check_ring_size(rays, realizations, depths.size)
    run = RunOptions.from_arguments(seed, threads=1)
    plane_waves = _get_plane_waves(medium, waves, realizations)
    angles = 2.0 * np.pi * np.arange(rays) / rays
    contraction = np.empty((realizations, depths.size))
    detected_fraction = np.empty_like(contraction)
    for realization in range(realizations):
        surface_waves = plane_waves
        if surface_waves is None:
            surface_waves = medium.surface.sample_realization(run.seed, realization)
        centre_x, centre_y, centre_z = find_centre(surface_waves, centre_on, width)
        ring = (centre_x + radius * np.cos(angles), centre_y + radius * np.sin(angles))
        hits = refract_vertical_rays(surface_waves, medium.refractive_index, *ring)
        points, detected = _intersect_screens(hits, centre_z - depths)
        detected_fraction[realization] = detected.mean(axis=1)
        contraction[realization] = _compute_rms_radius(points, detected) / radius
        if realization == 0:
            surface_points = hits.position - (centre_x, centre_y, centre_z)
            screen_points = points - (centre_x, centre_y)
            ray_variables = make_ray_variables(surface_points, screen_points, detected)
    is_valid = detected_fraction >= MIN_DETECTED_FRACTION
    if not is_valid.any(axis=0).all():
        raise invalid(
            "screen_depth_m", float(depths[~is_valid.any(axis=0)][0]),
            f"where a surface lets at least {MIN_DETECTED_FRACTION:g} of the ring through",
            "a smaller ring, or other depths",
        )  # fmt: skip
    attributes = {
        **run.make_attributes("Statistical lens", "lens", medium),
        "radius_m": radius, "centre_on": centre_on, "half_width_m": width,
        "realizations": realizations, "rays": rays * realizations,
    }  # fmt: skip
    return make_lens_dataset(contraction, detected_fraction, ray_variables, depths, attributes)


def _get_plane_waves(medium: ParticleLayer, waves: Any, realizations: int) -> np.ndarray | None:
    """Return given waves, None for realizations of the medium's surface, after checking them."""
    if waves is None and medium.surface is None:
        raise invalid("surface", None, "given: a lens needs waves")
    plane_waves = None if waves is None else check_plane_waves(waves)
    if plane_waves is not None and realizations > 1:
        raise invalid("realizations", realizations, "1 for given waves")
    return plane_waves


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


def _intersect_screens(
    hits: RefractedRays, screen_heights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return points on screens, shape (screens, rays, 2), and which rays reach them."""
    point, direction, next_hit = hits
    distance = (screen_heights[:, np.newaxis] - point[:, 2]) / direction[:, 2]
    points = point[:, :2] + distance[..., np.newaxis] * direction[:, :2]
    return points, (distance >= 0.0) & (distance < next_hit)


def _compute_rms_radius(points: np.ndarray, detected: np.ndarray) -> np.ndarray:
    """Return the root mean square distance of the detected rays from their centre."""
    count = np.maximum(detected.sum(axis=1), 1)
    weight = detected[..., np.newaxis]
    centre = (points * weight).sum(axis=1) / count[:, np.newaxis]
    square = (((points - centre[:, np.newaxis]) ** 2) * weight).sum(axis=(1, 2)) / count
    return np.sqrt(square)


def check_screen_depths(key: str, values: Any) -> np.ndarray:
    """Return increasing depths of screens (m), after checking them."""
    depths = as_1d_array(key, values, "numbers in metres")
    return check_axis(key, depths, 0.0, 1e9, "m", open_low=True)


def check_ring_radius(radius_m: Any) -> float:
    """Return the radius of a ring (m), after checking it."""
    return check_range("radius_m", radius_m, 0.0, 1e6, "m", open_low=True)


def check_ring_size(rays: Any, realizations: Any, n_screens: int) -> tuple[int, int]:
    """Return the numbers of rays and realizations, after checking that results fit into memory."""
    max_value = MAX_SCREEN_POINTS // n_screens
    return check_integer("rays", rays, 3, max_value), check_integer(
        "realizations", realizations, 1, max_value
    )
