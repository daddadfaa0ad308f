"""Return of a light pulse over time."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import InvalidValue, check_integer, invalid
from splits.instruments.delay_record import (
    SPEED_OF_LIGHT,
    Pulse,
    check_depths,
    check_granular_layers,
    check_record,
    compute_max_order,
    compute_slowness,
    describe_record,
    make_receiver,
)
from splits.instruments.delay_tally import DelayTally, make_delay_dataset
from splits.instruments.spectrophotometer import spectrophotometer
from splits.kernels.tallies.distributions import DelayRecord, Receiver
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions, check_incidence, check_wavelengths
from splits.simulation.scene import (
    add_recording_planes,
    build_scene,
    compute_optical_constants,
)
from splits.simulation.spectral_nodes import choose_nodes
from splits.simulation.strata import StoppingRule

CLEARANCE_MFP = 30.0
"""Mean free paths between the depths that matter and the end of a semi-infinite medium."""
MAX_DEPTH_M = 9_000.0
"""Largest depth that replaces an infinite one."""
LATE_LIGHT_ERRORS = (1e-4, 0.05)
"""Limits of the requested error of all reflected light."""
_INTERPOLATION_TOLERANCE = 0.001
"""Bound on the error of a reflectance from interpolation between refractive indices."""

NO_DEPTHS = np.zeros(0)
"""Depths of records that do not divide light by the largest depth reached."""


class DelayRequest(NamedTuple):
    """Validated settings of a record of delays.

    Attributes
    ----------
    incidence : float or "diffuse"
        Degrees.
    rays : int
    receiver : Receiver
    edges : float, shape (bins + 1,)
        Delays between bins (s).
    end_s : float
        End of the record (s).
    pulse : Pulse
    """

    incidence: float | str
    rays: int
    receiver: Receiver
    edges: np.ndarray
    end_s: float
    pulse: Pulse


@reject_unknown_arguments
def time_of_flight(
    medium: Medium,
    wavelength_nm: Any,
    incidence_deg: float | str = 0.0,
    rays: int = 200_000,
    seed: int = 1,
    *,
    delay_s: Any = None,
    end_s: float | None = None,
    pulse: Any = None,
    acceptance_deg: float | None = None,
    footprint_radius_m: float | None = None,
    depths_m: Any = None,
    threads: int | None = None,
    kernel: str = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the delays with which the light of a pulse leaves a medium.

    Light travels with the group velocity of the material in which it is.

    Parameters
    ----------
    medium : Medium
        Layers of grains, for example `splits.Snow`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float or "diffuse"
        Incidence angle of the beam, 0 to 89.9999 degrees, or isotropic light.
    rays : int
        Number of rays, rounded up.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
    delay_s : array_like, optional
        Increasing delays (s), the edges of the bins of `return_rate`, from 0, or from the beginning
        of the pulse.  By default, ten per decade from 1 ps to 100 ns.
    end_s : float, optional
        Delay (s) until which light counts in moments and path lengths, at least the last of
        `delay_s`, which is the default; rays are not traced beyond.  It may be infinite, except for
        media of infinite depth.
    pulse : float or mapping, optional
        Full width at half maximum (s) of a Gaussian pulse, or the columns ``delay_s`` and ``power``
        of any pulse.  Delays count from its centroid.  By default, the pulse is instantaneous.
    acceptance_deg : float, optional
        Largest angle (degrees) between received light and the direction towards the source, which
        is far away; the delay then includes the way from where light leaves to the plane through
        the point of entry perpendicular to the beam.  By default, all reflected light is received,
        at the surface.
    footprint_radius_m : float, optional
        Radius (m) around the point of entry of a beam within which reflected light is received.
    depths_m : array_like, optional
        Increasing depths (m) below the surface that divide reflected light by the largest depth
        that it has reached.
    threads : int, optional
        Default: every CPU that this process may use.
    kernel : {"auto", "vectorized", "scalar"}
        See `splits.spectrophotometer`.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress`.

    Returns
    -------
    xarray.Dataset
        Over ``side`` ("reflected", "transmitted") and ``wavelength``: ``return_rate`` (s⁻¹) over
        ``delay``, the fraction of the incident light per time, convolved with the pulse.  For an
        instantaneous pulse and delays before the end of the record: ``fraction`` of the incident
        light, ``mean_delay`` (s), ``delay_spread`` (s), the standard deviation,
        ``delay_skewness``, and ``path_length`` (m), the mean length of the path in each
        ``material``.  With `depths_m`, the first four also as ``…_by_depth`` over
        ``depth_interval`` for reflected light.  If all reflected light is received,
        ``late_fraction``, the fraction of the incident light that is reflected after the record:
        all reflected light as of `splits.spectrophotometer`, minus that in the record; it is left
        out where that instrument does not apply.  Moments and path lengths are NaN where light is
        in fewer than eight of 64 batches of rays, as for a ``fraction`` of 0; ``moments_flag`` is 1
        there.

        All have standard errors ``…_stderr``.  Those of fractions and of ``return_rate`` include
        the error of interpolation between refractive indices, which the attribute
        ``interpolation_error_bound`` bounds, and those of ``mean_delay`` and ``delay_spread`` the
        error of group indices.  The coordinate ``range`` (m) is half of the delay times the speed
        of light.  Light that a ground absorbs is not transmitted.

    Raises
    ------
    ValueError
        For a value outside its range, a medium with particle layers, or a wavelength at which a
        group index is not known.

    References
    ----------
    Blanco and Fournier (2003), Europhysics Letters 61, 168, for the mean path length.
    """
    check_medium(medium, allow_semi_infinite=True)
    check_granular_layers(medium)
    wavelengths = check_wavelengths(wavelength_nm)
    incidence = check_incidence(incidence_deg)
    rays = check_integer("rays", rays, 1)
    run = RunOptions.from_arguments(seed, threads, kernel, progress)
    record_pulse = Pulse.from_argument(pulse)
    edges, end = check_record(delay_s, end_s, record_pulse)
    receiver = make_receiver(incidence, acceptance_deg, footprint_radius_m)
    request = DelayRequest(incidence, rays, receiver, edges, end, record_pulse)
    dataset = simulate_delays(medium, wavelengths, request, run, check_depths(depths_m, medium))
    dataset.attrs |= describe_record(pulse, acceptance_deg, footprint_radius_m)
    if acceptance_deg is None and footprint_radius_m is None and math.isfinite(end):
        # Some semi-infinite media have no solution without an end of the record.
        with suppress(InvalidValue):
            return dataset.assign(_compute_late_light(dataset, medium, incidence, run))
    return dataset


def simulate_delays(
    medium: Medium, wavelengths: np.ndarray, request: DelayRequest, run: RunOptions,
    depths_m: np.ndarray = NO_DEPTHS,
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of `time_of_flight` without later light, from validated arguments.

    Parameters
    ----------
    medium : Medium
    wavelengths : float, shape (wavelengths,)
        nm.
    request : DelayRequest
    run : RunOptions
    depths_m : float, shape (depths,)
        Increasing depths (m) that divide light by the largest depth reached.
    """
    last_s = request.end_s - float(request.pulse.delay_s[0])
    traced = _limit_depth(medium, last_s, float(depths_m.max(initial=0.0)))
    slowness = compute_slowness(traced, wavelengths)
    index, absorption = compute_optical_constants(traced, wavelengths)
    nodes = choose_nodes(index, traced.list_interfaces(), _INTERPOLATION_TOLERANCE)
    scene = build_scene(traced, request.incidence, False)
    max_order = compute_max_order(traced, scene.layers, request.receiver, last_s)
    if depths_m.size:
        scene = add_recording_planes(scene, depths_m.tolist())
    interval = np.searchsorted(depths_m, -scene.layers.boundaries, side="right")
    record = DelayRecord(
        request.receiver, request.edges, request.end_s, np.stack(request.pulse), interval
    )
    tally = DelayTally(nodes, absorption, slowness.value, record, max_order)
    evaluation = simulate(scene, tally, StoppingRule(0.0, request.rays, fixed=True), run)
    attributes = {
        **run.make_attributes("Time of flight", "time_of_flight", medium),
        "incidence_deg": request.incidence,
        **tally.describe_run(evaluation.stop_reason),
    }
    return make_delay_dataset(tally, medium, wavelengths, slowness, depths_m, attributes)


def _compute_late_light(
    dataset: xr.Dataset, medium: Medium, incidence: float | str, run: RunOptions
) -> dict[str, Variable]:
    """Return the fraction of the light that is reflected after the record, with its error."""
    reflected = dataset.sel(side="reflected")
    recorded, stderr = reflected.fraction.values, reflected.fraction_stderr.values
    error = float(np.clip(stderr.max(), *LATE_LIGHT_ERRORS))
    total = spectrophotometer(
        medium, dataset.wavelength.values, incidence, error, run.seed, threads=run.threads,
        kernel=run.kernel, progress=run.progress,
    )  # fmt: skip
    return make_variable(
        "late_fraction", "wavelength", total.reflectance.values - recorded,
        np.hypot(total.reflectance_stderr.values, stderr),
        "fraction of the incident light that is reflected after the record",
    )  # fmt: skip


def _limit_depth(medium: Medium, end_s: float, recorded_depth_m: float) -> Medium:
    """Return a semi-infinite medium without the depths from which no light returns in time.

    In the pore space light has at most the speed of light in vacuum.  The end of the medium does
    not change light some mean free paths and grains above it.
    """
    if not medium.is_semi_infinite:
        return medium
    layer = medium.lowest_layer
    margin = 2.0 * layer.largest_grain_m + CLEARANCE_MFP / layer.extinction_per_m
    depth = margin + max(
        0.5 * SPEED_OF_LIGHT * end_s / layer.pore_fraction, recorded_depth_m * (1.0 + 1e-6)
    )
    if depth > MAX_DEPTH_M:
        allowed = f"below {2.0 * MAX_DEPTH_M * layer.pore_fraction / SPEED_OF_LIGHT:.3g} s"
        raise invalid("end_s", end_s, f"{allowed} for an infinite depth")
    return medium.truncate(depth, None)
