"""Return of a light pulse over time."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np
import xarray as xr

from splits.core.inputs import Incidence, Kernel, RayCount, Seed, Threads, Wavelengths
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import (
    Variable,
    compute_jackknife_stderr,
    compute_leave_one_out_means,
    make_variable,
)
from splits.core.validation import InvalidValue, invalid
from splits.instruments.angular_estimate import N_ANGULAR_BATCHES
from splits.instruments.beam_spread import NODE_TOLERANCE, SIDES, divide_or_zero
from splits.instruments.delay_record import (
    DEFAULT_EDGES_S,
    SPEED_OF_LIGHT,
    AcceptanceAngle,
    DelayEdges,
    FootprintRadius,
    Pulse,
    PulseInput,
    RecordDepths,
    RecordEnd,
    Slowness,
    check_granular_layers,
    check_record,
    compute_max_order,
    compute_slowness,
    describe_record,
    limit_depths,
    make_receiver,
)
from splits.instruments.spectrophotometer import spectrophotometer
from splits.io.netcdf import ANCILLARY_ATTRIBUTE
from splits.kernels.tallies.distributions import (
    N_MOMENTS,
    DelayRecord,
    DelaySums,
    Receiver,
    tally_delays,
)
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate
from splits.simulation.scene import (
    add_recording_planes,
    build_scene,
    compute_optical_constants,
)
from splits.simulation.spectral_nodes import IndexNodes, choose_nodes
from splits.simulation.strata import StoppingRule, Stratum
from splits.simulation.tally import RAYS_PER_CHUNK, ExitTally

CLEARANCE_MFP = 30.0
"""Mean free paths between the depths that matter and the end of a semi-infinite medium."""
MAX_DEPTH_M = 9_000.0
"""Largest depth that replaces an infinite one."""
LATE_LIGHT_ERRORS = (1e-4, 0.05)
"""Limits of the requested error of all reflected light."""


@declare_function
def time_of_flight(
    medium: Medium,
    wavelength_nm: Wavelengths,
    incidence_deg: Incidence = 0.0,
    *,
    rays: RayCount = 200_000,
    delay_s: DelayEdges = DEFAULT_EDGES_S,
    end_s: RecordEnd = None,
    pulse: PulseInput = None,
    acceptance_deg: AcceptanceAngle = None,
    footprint_radius_m: FootprintRadius = None,
    depth_m: RecordDepths = None,
    seed: Seed = 1,
    threads: Threads = None,
    kernel: Kernel = "auto",
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
    depth_m : array_like, optional
        Increasing depths (m) below the surface that divide reflected light by the largest depth
        that it has reached.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
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
        ``delay_s``, the fraction of the incident light per time, convolved with the pulse.  For an
        instantaneous pulse and delays before the end of the record: ``fraction`` of the incident
        light, ``mean_delay`` (s), ``delay_spread`` (s), the standard deviation,
        ``delay_skewness``, and ``path_length`` (m), the mean length of the path in each
        ``material``.  With `depth_m`, the first four also as ``…_by_depth`` over
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
    wavelengths, incidence = np.asarray(wavelength_nm), incidence_deg
    run = RunOptions.start(seed, threads, kernel, progress)
    record_pulse = Pulse.from_argument(pulse)
    edges, end = check_record(np.asarray(delay_s), end_s, record_pulse)
    receiver = make_receiver(incidence, acceptance_deg, footprint_radius_m)
    dataset = simulate_delays(
        medium, wavelengths, incidence, rays, receiver, edges, end, record_pulse, run,
        limit_depths(depth_m, medium),
    )  # fmt: skip
    dataset.attrs |= describe_record(pulse, acceptance_deg, footprint_radius_m)
    if acceptance_deg is None and footprint_radius_m is None and math.isfinite(end):
        # Some semi-infinite media have no solution without an end of the record.
        with suppress(InvalidValue):
            return dataset.assign(_compute_late_light(dataset, medium, incidence, run))
    return dataset


def simulate_delays(
    medium: Medium, wavelengths: np.ndarray, incidence: float | str, rays: int,
    receiver: Receiver, edges: np.ndarray, end_s: float, pulse: Pulse, run: RunOptions,
    depths_m: np.ndarray,
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of `time_of_flight` without later light, from validated arguments.

    Parameters
    ----------
    medium : Medium
    wavelengths : float, shape (wavelengths,)
        nm.
    incidence : float or "diffuse"
        Degrees.
    rays : int
    receiver : Receiver
    edges : float, shape (bins + 1,)
        Delays between bins (s).
    end_s : float
        End of the record (s).
    pulse : Pulse
    run : RunOptions
    depths_m : float, shape (depths,)
        Increasing depths (m) that divide light by the largest depth reached.
    """
    last_s = end_s - float(pulse.delay_s[0])
    traced = _limit_depth(medium, last_s, float(depths_m.max(initial=0.0)))
    slowness = compute_slowness(traced, wavelengths)
    index, absorption = compute_optical_constants(traced, wavelengths)
    nodes = choose_nodes(index, traced.list_interfaces(), NODE_TOLERANCE)
    scene = build_scene(traced, incidence, False)
    max_order = compute_max_order(traced, scene.layers, receiver, last_s)
    if depths_m.size:
        scene = add_recording_planes(scene, depths_m.tolist())
    interval = np.searchsorted(depths_m, -scene.layers.boundaries, side="right")
    record = DelayRecord(receiver, edges, end_s, np.stack(pulse), interval)
    tally = DelayTally(nodes, absorption, slowness.value, record, max_order)
    evaluation = simulate(scene, tally, StoppingRule(0.0, rays, fixed=True), run)
    attributes = {
        **run.make_attributes("Time of flight", "time_of_flight", medium),
        "incidence_deg": incidence,
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
        medium, dataset.wavelength.values, incidence, max_stderr=error, seed=run.seed,
        threads=run.threads, kernel=run.kernel, progress=run.progress,
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


# --------------------------------------------------------------------------------------------------
# Tally of the delays of rays.

MAX_TALLY_VALUES = 100_000_000
"""Largest number of sums of a tally."""


class DelayTally(ExitTally):
    """Tally of exits by their delay.

    Parameters
    ----------
    nodes, absorption
        See `Tally`.
    slowness : float, shape (rows, columns)
        Inverse of the group velocity along recorded paths (s/m).
    record : DelayRecord
    max_order : int
        Order of scattering that no light reaches within the record.

    Raises
    ------
    ValueError
        If the sums do not fit into memory.

    Attributes
    ----------
    histogram_sums : float, shape (batches, 2, node rows, bins)
    moment_sums : float, shape (batches, 2, node rows, intervals, 4)
    length_sums : float, shape (batches, 2, node rows, columns)
        See `splits.kernels.tallies.distributions.DelaySums`.
    """

    first_stream = 10_000_000
    rays_per_round = N_ANGULAR_BATCHES * RAYS_PER_CHUNK

    def __init__(
        self, nodes: IndexNodes, absorption: np.ndarray, slowness: np.ndarray,
        record: DelayRecord, max_order: int,
    ) -> None:  # fmt: skip
        super().__init__(nodes, absorption)
        self.slowness, self.record = slowness, record
        n_bins, n_intervals = record.edges.size - 1, int(record.interval[-1]) + 1
        shape = N_ANGULAR_BATCHES, 2, len(self.rows)
        # The sums must fit into memory if two nodes serve each wavelength.
        n_wavelengths, per_row = len(absorption), 2 * (n_bins + n_intervals * N_MOMENTS)
        n_values = 2 * N_ANGULAR_BATCHES * n_wavelengths * per_row
        if n_values > MAX_TALLY_VALUES:
            raise invalid(
                "wavelength_nm", f"{n_wavelengths} wavelengths",
                f"at most {n_wavelengths * MAX_TALLY_VALUES // n_values} with {n_bins} bins of "
                f"delay and {n_intervals} intervals of depth",
                "use fewer bins, or several calls",
            )  # fmt: skip
        self.histogram_sums = np.zeros((*shape, n_bins))
        self.moment_sums = np.zeros((*shape, n_intervals, N_MOMENTS))
        self.length_sums = np.zeros((*shape, absorption.shape[1]))
        self.values_per_row = per_row + 2 * absorption.shape[1]
        self.add_strata((max_order,))

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> DelaySums:
        """Return the sums of a chunk of exits."""
        slowness = self.slowness[self.rows[stratum.node_rows]]
        return tally_delays(exits, crossings, stratum.absorption, slowness, self.record)

    def merge(self, stratum: Stratum, score: DelaySums) -> None:
        """Add the sums of the next chunk of a stratum."""
        batch, rows = self.get_batch(stratum, N_ANGULAR_BATCHES), stratum.node_rows
        self.histogram_sums[batch, :, rows] += score.histogram
        self.moment_sums[batch, :, rows] += score.moments
        self.length_sums[batch, :, rows] += score.lengths


# --------------------------------------------------------------------------------------------------
# Dataset of the delays of light.

MIN_BATCHES = 8
"""Least number of batches with light for moments to have known errors."""
ROUNDING = 1e-12
"""Rounding error of a variance, relative to the mean square."""
FLAG_NAME = "moments_flag"
"""Flag of moments and path lengths that are not known."""
MOMENT_LABELS = {
    "mean_delay": ("mean delay", "s"),
    "delay_spread": ("standard deviation of the delay", "s"),
    "delay_skewness": ("skewness of the delay", "1"),
}


def make_delay_dataset(
    tally: DelayTally, medium: Medium, wavelengths: np.ndarray, slowness: Slowness,
    depths_m: np.ndarray, attributes: dict[str, Any],
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of `splits.time_of_flight`.

    Parameters
    ----------
    tally : DelayTally
        At the end of its run.
    medium : Medium
    wavelengths : float, shape (wavelengths,)
        nm.
    slowness : Slowness
    depths_m : float, shape (depths,)
        Depths between the intervals of the largest depth (m).
    attributes : dict
    """
    edges, bound = tally.record.edges, tally.nodes.interpolation_bound
    histogram, moments, lengths = map(
        tally.average_batches, (tally.histogram_sums, tally.moment_sums, tally.length_sums)
    )
    total, dims, width = moments.sum(axis=-2), ("side", "wavelength"), np.diff(edges)
    rate_error = tally.compute_fraction_error(histogram, bound[:, np.newaxis])
    variables = make_variable(
        "return_rate", (*dims, "delay_s"), histogram.mean(axis=0) / width, rate_error / width,
        "fraction of the incident light per time", "s-1",
    )  # fmt: skip
    recorded = lengths.mean(axis=0)
    # Errors of group indices are taken as fully correlated between materials.
    index_error = divide_or_zero(
        (slowness.stderr * recorded).sum(axis=-1), (slowness.value * recorded).sum(axis=-1)
    )
    variables |= _make_moment_variables(tally, total, dims, "", index_error)
    materials, fractions = medium.list_materials(), total[..., :1]
    in_materials = (lengths * slowness.path_fractions)[..., : len(materials)]
    jackknife = divide_or_zero(*map(compute_leave_one_out_means, (in_materials, fractions)))
    is_known = (fractions > 0.0).sum(axis=0) >= MIN_BATCHES
    mean, error = (
        np.where(is_known, one, np.nan)
        for one in (
            divide_or_zero(in_materials.mean(axis=0), fractions.mean(axis=0)),
            compute_jackknife_stderr(jackknife),
        )
    )
    path_length = make_variable(
        "path_length", (*dims, "material"), mean, error, "mean length of the path in a material",
        "m",
    )  # fmt: skip
    variables |= _add_moment_flag(path_length, FLAG_NAME, dims, is_known[..., 0])
    centres = 0.5 * (edges[1:] + edges[:-1])
    coordinates: dict[str, Any] = {
        "side": ("side", list(SIDES), {"long_name": "side of the sample where light leaves"}),
        "wavelength": make_wavelength_coordinate(wavelengths),
        "delay_s": (
            "delay_s", centres, {"long_name": "delay", "units": "s", "bounds": "delay_bounds"},
        ),
        "delay_bounds": (("delay_s", "bounds"), np.column_stack([edges[:-1], edges[1:]])),
        "range": (
            "delay_s", 0.5 * SPEED_OF_LIGHT * centres,
            {"long_name": "apparent depth below the surface", "units": "m"},
        ),
        "material": ("material", list(materials), {"long_name": "material"}),
    }  # fmt: skip
    if depths_m.size:
        by_depth, depth_dims = moments[:, 0].swapaxes(1, 2), ("depth_interval", "wavelength")
        variables |= _make_moment_variables(
            tally, by_depth, depth_dims, "_by_depth", index_error[0]
        )
        coordinates["depth_interval"] = (
            "depth_interval", [0.0, *depths_m],
            {"long_name": "smallest depth of the interval of the largest depth reached",
             "units": "m"},
        )  # fmt: skip
    return xr.Dataset(variables, coordinates, attributes)


def _make_moment_variables(
    tally: DelayTally, moments: np.ndarray, dims: tuple[str, ...], suffix: str,
    index_error: np.ndarray,
) -> dict[str, Variable]:  # fmt: skip
    """Return fractions and moments with errors, from moments by batch, shape (batches, ..., 4)."""
    fractions = moments[..., 0]
    fraction = make_variable(
        f"fraction{suffix}", dims, fractions.mean(axis=0),
        tally.compute_fraction_error(fractions, tally.nodes.interpolation_bound),
        "fraction of the incident light that returns within the record",
    )  # fmt: skip
    variables: dict[str, Variable] = {}
    is_known = (fractions > 0.0).sum(axis=0) >= MIN_BATCHES
    results = _compute_central_moments(moments.mean(axis=0))
    jackknife = _compute_central_moments(compute_leave_one_out_means(moments))
    for (name, (label, units)), result, left_out in zip(
        MOMENT_LABELS.items(), results, jackknife, strict=True
    ):
        values = np.where(is_known, result, np.nan)
        error = np.where(is_known, compute_jackknife_stderr(left_out), np.nan)
        if units == "s":
            error = np.hypot(error, index_error * values)
        variables |= make_variable(f"{name}{suffix}", dims, values, error, label, units)
    return fraction | _add_moment_flag(variables, f"{FLAG_NAME}{suffix}", dims, is_known)


def _compute_central_moments(moments: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return mean (s), standard deviation (s) and skewness of the delay, 0 without light.

    `moments` are those about 0, shape (..., 4).
    """
    first, second, third = (
        divide_or_zero(moments[..., order], moments[..., 0]) for order in range(1, 4)
    )
    variance = np.where(second - first**2 > ROUNDING * second, second - first**2, 0.0)
    spread = np.sqrt(variance)
    centred = third - 3.0 * first * second + 2.0 * first**3
    return first, spread, divide_or_zero(centred, variance * spread)


def _add_moment_flag(
    variables: dict[str, Variable], name: str, dims: tuple[str, ...], is_known: np.ndarray
) -> dict[str, Variable]:
    """Return variables with a flag of moments, which are NaN where it is not 0.

    Parameters
    ----------
    variables : dict
        Moments and their errors.
    name : str
        Name of the flag.
    dims : tuple of str
        Dimensions of the flag.
    is_known : bool, shape (...)
        Whether the moments are known.
    """
    for _, _, attributes in variables.values():
        own = attributes.get(ANCILLARY_ATTRIBUTE, "")
        attributes[ANCILLARY_ATTRIBUTE] = f"{own} {name}".strip()
    flag_attributes: dict[str, Any] = {
        "long_name": "quality of the moments of the delay",
        "flag_values": np.array([0, 1], dtype=np.int8),
        "flag_meanings": "known too_little_light",
    }
    return {**variables, name: (dims, (~is_known).astype(np.int8), flag_attributes)}
