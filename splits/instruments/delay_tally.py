"""Tally of the delays of rays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.uncertainty import (
    Variable,
    compute_batch_stderr,
    compute_jackknife_stderr,
    compute_leave_one_out_means,
    make_variable,
)
from splits.core.validation import invalid
from splits.instruments.angular_estimate import N_ANGULAR_BATCHES
from splits.instruments.beam_spread import SIDES, divide_or_zero
from splits.instruments.delay_record import SPEED_OF_LIGHT, Slowness
from splits.io.netcdf import ANCILLARY_ATTRIBUTE
from splits.kernels.tallies.distributions import (
    N_MOMENTS,
    DelayRecord,
    DelaySums,
    tally_delays,
)
from splits.media.medium import Medium
from splits.simulation.run_options import make_wavelength_coordinate
from splits.simulation.spectral_nodes import IndexNodes, bound_fraction_error
from splits.simulation.strata import Stratum
from splits.simulation.tally import RAYS_PER_CHUNK, ExitTally, allow_for_unseen_rays

MAX_TALLY_VALUES = 100_000_000
"""Largest number of sums of a tally."""


def check_tally_size(n_wavelengths: int, n_bins: int, n_intervals: int = 1) -> None:
    """Check that the sums of a tally fit into memory, if two nodes serve each wavelength."""
    n_values = 2 * N_ANGULAR_BATCHES * 2 * n_wavelengths * (n_bins + n_intervals * N_MOMENTS)
    if n_values > MAX_TALLY_VALUES:
        raise invalid(
            "wavelength_nm", f"{n_wavelengths} wavelengths",
            f"at most {n_wavelengths * MAX_TALLY_VALUES // n_values} with {n_bins} bins of "
            f"delay and {n_intervals} intervals of depth",
            "use fewer bins, or several calls",
        )  # fmt: skip


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
        check_tally_size(len(absorption), n_bins, n_intervals)
        self.histogram_sums = np.zeros((*shape, n_bins))
        self.moment_sums = np.zeros((*shape, n_intervals, N_MOMENTS))
        self.length_sums = np.zeros((*shape, absorption.shape[1]))
        self.values_per_row = 2 * (n_bins + n_intervals * N_MOMENTS + absorption.shape[1])
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

    def compute_batch_histograms(self) -> np.ndarray:
        """Return the fraction of the incident light, shape (batches, 2, wavelengths, bins)."""
        return self._combine_batches(self.histogram_sums)

    def compute_batch_moments(self) -> np.ndarray:
        """Return moments (sᵏ), shape (batches, 2, wavelengths, intervals, 4)."""
        return self._combine_batches(self.moment_sums)

    def compute_batch_lengths(self) -> np.ndarray:
        """Return the recorded path lengths (m) of received light times its fraction.

        Returns
        -------
        float, shape (batches, 2, wavelengths, columns)
        """
        return self._combine_batches(self.length_sums)

    def _combine_batches(self, batch_sums: np.ndarray) -> np.ndarray:
        """Return means by batch, from sums whose third axis is the node row."""
        per_batch = np.moveaxis(batch_sums, 2, -1) / (self.count_rays() / N_ANGULAR_BATCHES)
        return np.moveaxis(self.combine_nodes(per_batch), -1, 2)


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


class RayErrors(NamedTuple):
    """Errors that do not follow from the scatter of batches.

    Attributes
    ----------
    interpolation_bound : float, shape (wavelengths,)
        Bound on interpolation between refractive indices, see `IndexNodes`.
    single_ray : float
        Fraction of the light that a single ray may carry.
    """

    interpolation_bound: np.ndarray
    single_ray: float


class DelayEstimate(NamedTuple):
    """Fraction of the light that arrives within the record, and moments of its delay.

    Attributes
    ----------
    fraction, mean_delay, delay_spread, delay_skewness : float, shape (...)
        Delays in s; 0 without light.
    """

    fraction: np.ndarray
    mean_delay: np.ndarray
    delay_spread: np.ndarray
    delay_skewness: np.ndarray

    @classmethod
    def from_moments(cls, moments: np.ndarray) -> DelayEstimate:
        """Return the estimate from moments about 0, shape (..., 4)."""
        fraction = moments[..., 0]
        first, second, third = (
            divide_or_zero(moments[..., order], fraction) for order in range(1, 4)
        )
        variance = np.where(second - first**2 > ROUNDING * second, second - first**2, 0.0)
        spread = np.sqrt(variance)
        centred = third - 3.0 * first * second + 2.0 * first**3
        return cls(fraction, first, spread, divide_or_zero(centred, variance * spread))


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
    rays = RayErrors(tally.nodes.interpolation_bound, 1.0 / tally.stratum_rays.min())
    edges = tally.record.edges
    moments, lengths = tally.compute_batch_moments(), tally.compute_batch_lengths()
    total, dims, width = moments.sum(axis=-2), ("side", "wavelength"), np.diff(edges)
    rate, rate_error = _compute_fractions(
        tally.compute_batch_histograms(), rays._replace(
            interpolation_bound=rays.interpolation_bound[:, np.newaxis]
        ),
    )  # fmt: skip
    variables = make_variable(
        "return_rate", (*dims, "delay"), rate / width, rate_error / width,
        "fraction of the incident light per time", "s-1",
    )  # fmt: skip
    recorded = lengths.mean(axis=0)
    # Errors of group indices are taken as fully correlated between materials.
    index_error = divide_or_zero(
        (slowness.stderr * recorded).sum(axis=-1), (slowness.value * recorded).sum(axis=-1)
    )
    variables |= _make_moment_variables(total, dims, "", index_error, rays)
    materials = medium.list_materials()
    variables |= _make_length_variables(
        total[..., :1], (lengths * slowness.path_fractions)[..., : len(materials)]
    )
    if depths_m.size:
        by_depth, depth_dims = moments[:, 0].swapaxes(1, 2), ("depth_interval", "wavelength")
        variables |= _make_moment_variables(by_depth, depth_dims, "_by_depth", index_error[0], rays)
    coordinates = _make_coordinates(wavelengths, edges, depths_m, materials)
    return xr.Dataset(variables, coordinates, attributes)


def _compute_fractions(batches: np.ndarray, rays: RayErrors) -> tuple[np.ndarray, np.ndarray]:
    """Return mean fractions and their errors, from means by batch."""
    mean = batches.mean(axis=0)
    variance = allow_for_unseen_rays(
        compute_batch_stderr(batches) ** 2, (rays.single_ray * (1.0 - mean)) ** 2
    )
    return mean, np.hypot(np.sqrt(variance), bound_fraction_error(rays.interpolation_bound, mean))


def _make_moment_variables(
    moments: np.ndarray, dims: tuple[str, ...], suffix: str, index_error: np.ndarray,
    rays: RayErrors,
) -> dict[str, Variable]:  # fmt: skip
    """Return fractions and moments with errors, from moments by batch, shape (batches, ..., 4)."""
    estimate = DelayEstimate.from_moments(moments.mean(axis=0))
    jackknife = DelayEstimate.from_moments(compute_leave_one_out_means(moments))
    mean, error = _compute_fractions(moments[..., 0], rays)
    label = "fraction of the incident light that returns within the record"
    fraction = make_variable(f"fraction{suffix}", dims, mean, error, label)
    variables: dict[str, Variable] = {}
    is_known = (moments[..., 0] > 0.0).sum(axis=0) >= MIN_BATCHES
    for name, (label, units) in MOMENT_LABELS.items():
        values = np.where(is_known, getattr(estimate, name), np.nan)
        error = np.where(is_known, compute_jackknife_stderr(getattr(jackknife, name)), np.nan)
        if units == "s":
            error = np.hypot(error, index_error * values)
        variables |= make_variable(f"{name}{suffix}", dims, values, error, label, units)
    return fraction | add_moment_flag(variables, f"{FLAG_NAME}{suffix}", dims, is_known)


def _make_length_variables(fractions: np.ndarray, lengths: np.ndarray) -> dict[str, Variable]:
    """Return mean path lengths with errors, from their sums by batch, divided by fractions."""
    mean = divide_or_zero(lengths.mean(axis=0), fractions.mean(axis=0))
    jackknife = divide_or_zero(*map(compute_leave_one_out_means, (lengths, fractions)))
    is_known = (fractions > 0.0).sum(axis=0) >= MIN_BATCHES
    mean, error = (
        np.where(is_known, one, np.nan) for one in (mean, compute_jackknife_stderr(jackknife))
    )
    variables = make_variable(
        "path_length", ("side", "wavelength", "material"), mean, error,
        "mean length of the path in a material", "m",
    )  # fmt: skip
    return add_moment_flag(variables, FLAG_NAME, ("side", "wavelength"), is_known[..., 0])


def add_moment_flag(
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


def _make_coordinates(
    wavelengths: np.ndarray, edges: np.ndarray, depths_m: np.ndarray, materials: Sequence[str]
) -> dict[str, Any]:
    """Return the coordinates of the dataset."""
    centres = 0.5 * (edges[1:] + edges[:-1])
    delay_attributes = {"long_name": "delay", "units": "s", "bounds": "delay_bounds"}
    coordinates = {
        "side": ("side", list(SIDES), {"long_name": "side of the sample where light leaves"}),
        "wavelength": make_wavelength_coordinate(wavelengths),
        "delay": ("delay", centres, delay_attributes),
        "delay_bounds": (("delay", "bounds"), np.column_stack([edges[:-1], edges[1:]])),
        "range": (
            "delay", 0.5 * SPEED_OF_LIGHT * centres,
            {"long_name": "apparent depth below the surface", "units": "m"},
        ),
        "material": ("material", list(materials), {"long_name": "material"}),
    }  # fmt: skip
    if depths_m.size:
        attributes = {
            "long_name": "smallest depth of the interval of the largest depth reached",
            "units": "m",
        }
        coordinates["depth_interval"] = ("depth_interval", [0.0, *depths_m], attributes)
    return coordinates
