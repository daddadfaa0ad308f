"""Spatial spread of a thin beam, the dependence on position of a BSSRDF."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.progress import ProgressCallback
from splits.core.validation import check_integer
from splits.instruments.beam_spread_tally import BeamSpreadTally, compute_quantile_radii
from splits.media.checks import check_medium
from splits.media.medium import Medium
from splits.simulation.engine import simulate
from splits.simulation.run_options import (
    HALF_WIDTH_RANGE_M,
    RunOptions,
    check_beam_angle,
    check_half_width,
    check_wavelengths,
)
from splits.simulation.scene import build_scene, compute_optical_constants
from splits.simulation.spectral_nodes import choose_nodes
from splits.simulation.strata import StoppingRule

_INTERPOLATION_TOLERANCE = 0.001
"""Bound on the error of a reflectance from interpolation between refractive indices."""


@reject_unknown_arguments
def beam_spread(
    medium: Medium,
    wavelength_nm: Any,
    incidence_deg: float = 0.0,
    rays: int = 200_000,
    seed: int = 1,
    *,
    half_width_m: float | None = None,
    threads: int | None = None,
    kernel: str = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the distances from an infinitely thin beam at which its light leaves the medium.

    Parameters
    ----------
    medium : Medium
        For example `splits.Snow`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float
        Incidence angle of the beam, 0 to 89.9999 degrees.
    rays : int
        Number of rays, rounded up.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
    half_width_m : float, optional
        Half of the side length of the maps; by default the largest of the radii within which 75 %
        of the reflected light leaves, estimated from a first round of rays.
    threads : int, optional
        Default: every CPU that this process may use.
    kernel : {"auto", "vectorized", "scalar"}
        See `splits.spectrophotometer`.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress`.

    Returns
    -------
    xarray.Dataset
        For scattered light, over ``side`` ("reflected", "transmitted") and ``wavelength``:
        ``profile`` (m⁻²) over ``radius``, the BSSRDF integrated over exit directions, weighted with
        their cosine, and averaged over azimuth around the entry point; ``profile_map`` (m⁻²), the
        same over ``x``, along the horizontal direction in which the beam travels, and ``y``,
        perpendicular to it; ``mean_radius`` and ``quantile_radius`` (m), the latter over
        ``quantile``, 0 where no light leaves;
        ``fraction``, the fraction of the incident light.  All with their standard errors
        ``…_stderr``; that of ``fraction`` includes the error of interpolation between refractive
        indices, which the attribute ``interpolation_error_bound`` bounds.

    Raises
    ------
    ValueError
        For a value outside its range.

    References
    ----------
    Nicodemus et al. (1977), section III; SPLITSnow section 4.1.
    """
    check_medium(medium)
    wavelengths = check_wavelengths(wavelength_nm)
    incidence = check_beam_angle(incidence_deg)
    check_integer("rays", rays, 1)
    run = RunOptions.from_arguments(seed, threads, kernel, progress)
    if half_width_m is not None:
        check_half_width("beam_spread", half_width_m)
    index, absorption = compute_optical_constants(medium, wavelengths)
    nodes = choose_nodes(index, medium.list_interfaces(), _INTERPOLATION_TOLERANCE)
    scene = build_scene(medium, incidence, False)
    if half_width_m is None:
        pilot = BeamSpreadTally(nodes, absorption, 0.0, 0, first_node=len(nodes.index))
        simulate(scene, pilot, StoppingRule(0.0, 1, fixed=True), run)
        radii = compute_quantile_radii(pilot.compute_radial_fractions().mean(axis=0), (0.75,))
        # One mean free path where no light leaves; the edge must be positive.
        radius = radii[0].max() or 1.0 / scene.layers.collision_coefficient.max()
        half_width_m = np.clip(radius, *HALF_WIDTH_RANGE_M["beam_spread"])
    tally = BeamSpreadTally(nodes, absorption, float(half_width_m))
    evaluation = simulate(scene, tally, StoppingRule(0.0, rays, fixed=True), run)
    attributes = {
        **run.make_attributes("Spread of a beam", "beam_spread", medium),
        "incidence_deg": incidence,
        "half_width_m": tally.half_width,
        **tally.describe_run(evaluation.stop_reason),
    }
    return tally.to_dataset(wavelengths, attributes)
