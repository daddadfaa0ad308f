"""The statistical lens: a ring of parallel rays through a wavy surface onto a screen.

Budak & Grimailo 2020, section 3.1 and Fig 2.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.arrays import (
    as_1d_array,
    as_float_array,
    check_array_range,
    check_increasing,
    find_labels,
    match_labels,
)
from splits.core.uncertainty import make_variable
from splits.core.validation import check_choice, check_range, invalid, reject_unknown_arguments
from splits.kernels.rough_surface.lens import RefractedRays, refract_vertical_rays
from splits.kernels.rough_surface.realization import compute_heights_and_slopes
from splits.kernels.rough_surface.wave_sums import AMPLITUDE, KX, N_WAVE_LANES, PHASE, WAVE_ROWS
from splits.media.medium import SurfaceMedium
from splits.simulation.arguments import check_half_width, check_integer, check_medium
from splits.simulation.attributes import make_run_attributes

MIN_DETECTED_FRACTION = 0.5
"""Share of a ring that must reach a screen for a realisation to count there."""
CENTRE_CHOICES = ("crest", "trough", "origin")
DEFAULT_RAYS = 360
MAX_SCREEN_POINTS = 10_000_000
"""Places on screens, and images, that one result holds at most."""
N_SEARCH_POINTS = 161
"""Points per side of the grid on which the highest or lowest point is looked for."""


@reject_unknown_arguments
def lens(
    medium: SurfaceMedium,
    screen_depth_m: Any,
    radius_m: float,
    *,
    centre_on: str = "crest",
    half_width_m: float | None = None,
    rays: int = DEFAULT_RAYS,
    realisations: int = 1,
    seed: int = 1,
    waves: Any = None,
) -> xr.Dataset:
    """Send a ring of vertical rays through the surface of a layer and catch it on screens.

    Parameters
    ----------
    medium : SurfaceMedium
        A `splits.ParticleLayer` with a rough surface; only the surface and the refractive index matter.
    screen_depth_m : array_like
        Distances of screens below the surface under the ring's centre (m), increasing from above 0.
    radius_m : float
        Of the ring (m).
    centre_on : {"crest", "trough", "origin"}
        Where the ring stands: over the highest or lowest point within `half_width_m`, or there.
    half_width_m : float
        Half the side of the square that is searched (m); needed but over the origin.
    rays : int
        At least 3, evenly around.
    realisations : int
        Of the surface; at least 2 for standard errors.
    seed : int
    waves : array_like, shape (waves, 4), optional
        Amplitudes (m), wave numbers along x and y (1/m) and phases (radians) of cosines, instead
        of realisations of the layer's surface.

    Returns
    -------
    xarray.Dataset
        Over ``screen_depth``: ``contraction``, the root mean square distance of the rays from their
        centre over the radius of the ring, and ``concentration``, the inverse of its mean square:
        1 without waves, and how much smaller, by area, an image that stays a ring has become; over
        realisations that let half of the ring through, with standard errors.
        Over ``realisation``, too: ``caught``, the share of rays that reach the screen without
        meeting the surface again; the others do not count.  Of the first realisation, over ``ray``:
        ``path``, where it met the surface, ``place`` on the screens (m) and whether it is ``seen``.

    Raises
    ------
    ValueError
        For a value outside its range, or a layer with a smooth surface.
    """
    begun = time.perf_counter()
    check_medium(medium, SurfaceMedium)
    depths = check_screen_depths("screen_depth_m", screen_depth_m)
    radius = check_ring_radius(radius_m)
    check_choice("centre_on", centre_on, CENTRE_CHOICES)
    if half_width_m is None and centre_on != "origin":
        hint = f'half the side of the square searched for the {centre_on}; centre_on="origin" needs none'
        raise invalid("half_width_m", None, "given (m)", hint)
    width = 0.0 if half_width_m is None else check_half_width("lens", half_width_m)
    rays, realisations = check_ring_size(rays, realisations, depths.size)
    seed = check_integer("seed", seed, 0)
    if waves is None and medium.surface is None:
        raise invalid("surface", None, "given: a lens needs waves")
    given = None if waves is None else check_plane_waves(waves)
    if given is not None and realisations > 1:
        raise invalid("realisations", realisations, "1 for given waves")
    angle = 2.0 * np.pi * np.arange(rays) / rays
    contraction = np.empty((realisations, depths.size))
    caught = np.empty_like(contraction)
    for number in range(realisations):
        drawn = medium.surface.sample_realization(seed, number) if given is None else given
        x0, y0, z0 = find_centre(drawn, centre_on, width)
        ring = (x0 + radius * np.cos(angle), y0 + radius * np.sin(angle))
        landed = refract_vertical_rays(drawn, medium.refractive_index, *ring)
        place, seen = _intersect_screens(landed, z0 - depths)
        caught[number] = seen.mean(axis=1)
        contraction[number] = _compute_rms_radius(place, seen) / radius
        if number == 0:
            start = landed.position - (x0, y0, z0)
            shown = np.where(seen[..., np.newaxis], place - (x0, y0), 0.0)
            reached = seen
    enough = caught >= MIN_DETECTED_FRACTION
    if not enough.any(axis=0).all():
        raise invalid(
            "screen_depth_m", float(depths[~enough.any(axis=0)][0]),
            f"where a surface lets at least {MIN_DETECTED_FRACTION:g} of the ring through",
            "a smaller ring, or other depths",
        )  # fmt: skip
    facts = {
        **make_run_attributes("Statistical lens", "lens", medium, begun, seed),
        "radius_m": radius, "centre_on": centre_on, "half_width_m": width, "realisations": realisations,
        "rays": rays * realisations,
    }  # fmt: skip
    return _make_dataset(
        contraction, caught, _FirstRealization(start, shown, reached), depths, facts
    )


class _FirstRealization(NamedTuple):
    """What the first surface did to the ring, to be shown.

    Attributes
    ----------
    surface_point : float, shape (rays, 3)
        Where rays met the surface (m).
    screen_point : float, shape (screens, rays, 2)
        Where they came to on the screens (m).
    reaches_screen : bool, shape (screens, rays)
        Whether they did.
    """

    surface_point: np.ndarray
    screen_point: np.ndarray
    reaches_screen: np.ndarray


def _make_dataset(
    contraction: np.ndarray,
    detected_fraction: np.ndarray,
    first_realization: _FirstRealization,
    depths: np.ndarray,
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Return what surfaces did to the ring as a labelled dataset."""
    enough = detected_fraction >= MIN_DETECTED_FRACTION
    size = _average_realizations(contraction, enough)
    density = _invert_with_error(*_average_realizations(contraction**2, enough))
    at, by_ray = "screen_depth", ("screen_depth", "ray", "axis")
    seen = first_realization.reaches_screen.astype(float)
    variables = {
        **make_variable("contraction", at, *size, "size of the image over the ring's"),
        **make_variable("concentration", at, *density, "inverse mean square size of the image"),
        **make_variable(
            "detected_fraction",
            ("realisation", at),
            detected_fraction,
            None,
            "share of rays on the screen",
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
            "place on the screen",
            "m",
        ),
        **make_variable("detected", by_ray[:2], seen, None, "whether a ray reaches it"),
    }
    coordinates = {
        at: (at, depths, {"long_name": "depth of the screen below the surface", "units": "m"}),
        "axis": ("axis", ["x", "y"], {"long_name": "axis on the screen"}),
        "point": ("point", ["x", "y", "z"], {"long_name": "axis in space"}),
    }
    return xr.Dataset(variables, coordinates, attributes)


def check_plane_waves(waves: Any) -> np.ndarray:
    """Return given waves as kernels take them, or refuse them; see `lens`."""
    allowed = "rows of amplitude, wave numbers along x and y, and phase"
    table = as_float_array("waves", waves, allowed)
    if table.ndim != 2 or table.shape[1] != 4 or not len(table):
        raise invalid("waves", waves, allowed)
    names = [("amplitude", "wave_number_x", "wave_number_y", "phase")]
    table = table[:, match_labels("waves", find_labels(waves, 1), names)]
    # Kernels count in cycles, and in the order of wave numbers.
    table = table[np.argsort(np.hypot(table[:, 1], table[:, 2]))]
    found = np.zeros((len(WAVE_ROWS), -(-len(table) // N_WAVE_LANES) * N_WAVE_LANES))
    found[:, : len(table)] = table.T
    found[KX:] /= 2.0 * np.pi
    # Bounds of the surface add up amplitudes.
    found[PHASE] += 0.5 * (found[AMPLITUDE] < 0.0)
    found[AMPLITUDE] = np.abs(found[AMPLITUDE])
    return found


def find_centre(waves: np.ndarray, centre_on: str, half_width: float) -> tuple[float, float, float]:
    """Return where the ring stands: a point of the surface."""
    line = np.linspace(-half_width, half_width, 1 if centre_on == "origin" else N_SEARCH_POINTS)
    x, y = (0.0 * line[:1],) * 2 if centre_on == "origin" else np.meshgrid(line, line)
    x, y = np.ravel(x), np.ravel(y)
    height = compute_heights_and_slopes(waves, x, y).height
    best = int(height.argmin() if centre_on == "trough" else height.argmax())
    return float(x[best]), float(y[best]), float(height[best])


def _intersect_screens(
    hits: RefractedRays, screen_heights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return places, shape (screens, rays, 2), and which rays reach them."""
    point, direction, again = hits
    way = (screen_heights[:, np.newaxis] - point[:, 2]) / direction[:, 2]
    place = point[:, :2] + way[..., np.newaxis] * direction[:, :2]
    return place, (way >= 0.0) & (way < again)


def _compute_rms_radius(points: np.ndarray, detected: np.ndarray) -> np.ndarray:
    """Return the root mean square distance from the centre of the rays that are seen."""
    count = np.maximum(detected.sum(axis=1), 1)
    weight = detected[..., np.newaxis]
    middle = (points * weight).sum(axis=1) / count[:, np.newaxis]
    square = (((points - middle[:, np.newaxis]) ** 2) * weight).sum(axis=(1, 2)) / count
    return np.sqrt(square)


def _average_realizations(
    values: np.ndarray, valid: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the mean over realisations that count with its standard error, of one without."""
    count = valid.sum(axis=0)
    mean = np.where(valid, values, 0.0).sum(axis=0) / count
    if len(values) == 1:
        return mean, None
    square = np.where(valid, (values - mean) ** 2, 0.0).sum(axis=0)
    # A single one says nothing of its scatter: as far off as it is large.
    stderr = np.sqrt(square / np.maximum(count - 1, 1) / count)
    return mean, np.where(count > 1, stderr, mean)


def _invert_with_error(
    mean: np.ndarray, stderr: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return 1/mean and its standard error to first order."""
    inverse = 1.0 / np.maximum(mean, np.finfo(float).tiny)
    return inverse, None if stderr is None else stderr * inverse**2


def check_screen_depths(key: str, values: Any) -> np.ndarray:
    """Return increasing depths of screens (m), or refuse them."""
    depths = as_1d_array(key, values, "numbers in metres")
    return check_increasing(key, check_array_range(key, depths, 0.0, 1e9, "m", open_low=True))


def check_ring_radius(radius_m: Any) -> float:
    """Return the radius of a ring (m), or refuse it."""
    return check_range("radius_m", radius_m, 0.0, 1e6, "m", open_low=True)


def check_ring_size(rays: Any, realisations: Any, n_screens: int) -> tuple[int, int]:
    """Return numbers of rays and of surfaces whose results fit into memory, or refuse them."""
    most = MAX_SCREEN_POINTS // n_screens
    return check_integer("rays", rays, 3, most), check_integer(
        "realisations", realisations, 1, most
    )
