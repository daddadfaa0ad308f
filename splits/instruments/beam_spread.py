"""Spatial spread of a thin beam, the dependence on position of a BSSRDF."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.progress import ProgressCallback, with_progress
from splits.core.uncertainty import (
    Variable,
    compute_batch_stderr,
    compute_jackknife_stderr,
    compute_leave_one_out_means,
    make_variable,
)
from splits.core.validation import check_choice, reject_unknown_arguments
from splits.instruments.angular_estimate import bound_interpolation_error
from splits.instruments.angular_tally import N_ANGULAR_BATCHES, RAYS_PER_ROUND
from splits.kernels.grains.scene import make_bounding_optics
from splits.kernels.tallies.radial import tally_radial
from splits.media.medium import Medium
from splits.simulation import random_streams
from splits.simulation.arguments import (
    HALF_WIDTH_RANGE_M,
    check_beam_angle,
    check_half_width,
    check_integer,
    check_medium,
    check_threads,
    check_wavelengths,
)
from splits.simulation.attributes import make_run_attributes, make_wavelength_coordinate
from splits.simulation.runner import RAYS_PER_CHUNK, Runner
from splits.simulation.scene import compute_optical_constants
from splits.simulation.spectral_nodes import choose_nodes
from splits.simulation.tally import Stratum
from splits.simulation.tracer import KERNELS

RADIUS_QUANTILES = (0.25, 0.5, 0.75, 0.9)
"""Fractions of the light that leave within the quantile radii."""

N_MAP_PIXELS = 41
"""Pixels of the map along each edge: odd, so that the point of entry is the centre of one."""

MIN_RADIUS_M = 1e-6
BINS_PER_DECADE, N_DECADES = 40, 9
_N_FINE_BINS = BINS_PER_DECADE * N_DECADES + 2
"""Fine bins of distance, from a micrometre to a kilometre, and one outside at each end."""

_FINE_BINS_PER_BIN = 5
"""Fine bins per bin of the profile."""

_INTERPOLATION_TOLERANCE = 0.001
"""Bound on the error of a reflectance from interpolation between refractive indices."""


SIDES = {"reflected": 0, "transmitted": 1}

RadialScore = tuple[int, np.ndarray, np.ndarray, np.ndarray]
"""Score of a chunk: batch, weights by distance, first moment, map."""


@reject_unknown_arguments
@with_progress
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
    """Measure the distance between entry and exit of the light of an infinitely thin beam.

    Parameters
    ----------
    medium : GranularMedium
        For example `splits.Snow`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float
        Polar angle of the beam, 0 to 89.9999 degrees.
    rays : int
        Number of rays, rounded up.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
    half_width_m : float, optional
        Half the edge of the maps; by default the largest of the radii within which 75 % of the
        reflected light leaves, estimated from a first round of rays.
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
        ``profile`` (m⁻²) over ``radius``, the BSSRDF integrated over directions of exit weighted
        with their cosine and averaged around the point of entry; ``profile_map`` (m⁻²), the same
        over ``x``, along the beam's direction of travel, and ``y``, across; ``mean_radius`` and
        ``quantile_radius`` (m), the latter over ``quantile``, 0 where no light leaves;
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
    check_choice("kernel", kernel, KERNELS)
    check_integer("rays", rays, 1)
    seed = check_integer("seed", seed, 0)
    threads = check_threads(threads)
    if half_width_m is not None:
        check_half_width("beam_spread", half_width_m)
    start_time = time.perf_counter()
    index, absorption = compute_optical_constants(medium, wavelengths)
    nodes = choose_nodes(index, medium.list_interfaces(), _INTERPOLATION_TOLERANCE)
    runner = Runner(medium, incidence, seed, threads, False, kernel, progress)

    def make_tallies(first_number: int, half_width: float, n_pixels: int) -> list[_BeamSpreadTally]:
        numbered_nodes = enumerate(zip(nodes.index, nodes.weights, strict=True), start=first_number)
        return [
            _BeamSpreadTally(number, indices, absorption, weights, half_width, n_pixels)
            for number, (indices, weights) in numbered_nodes
        ]

    def trace(tallies: list[_BeamSpreadTally], rays: int) -> None:
        runner.trace(
            [(tally, stratum, rays) for tally in tallies for stratum in tally.strata], 1.0, 0.0
        )

    if half_width_m is None:
        pilot = make_tallies(len(nodes.index), 0.0, 0)
        trace(pilot, RAYS_PER_ROUND)
        radii = _compute_quantile_radii(
            _compute_radial_fractions(pilot, len(wavelengths)).mean(axis=0), (0.75,)
        )
        # One mean free path where no light leaves; the edge must be positive.
        radius = radii[0].max() or 1.0 / runner.tracer.traits.attenuation
        half_width_m = np.clip(radius, *HALF_WIDTH_RANGE_M["beam_spread"])
    half_width_m = float(half_width_m)
    tallies = make_tallies(0, half_width_m, N_MAP_PIXELS)
    trace(tallies, RAYS_PER_ROUND * -(-rays // (RAYS_PER_ROUND * len(tallies))))
    attributes = {
        **make_run_attributes("Spread of a beam", "beam_spread", medium, start_time, seed, threads),
        "incidence_deg": incidence,
        "half_width_m": half_width_m,
        "rays": sum(stratum.n_rays for tally in tallies for stratum in tally.strata),
        "ensembles": len(tallies),
        "interpolation_error_bound": float(nodes.interpolation_bound.max()),
        "kernel": runner.list_kernels(tallies),
    }
    return _make_dataset(tallies, wavelengths, half_width_m, nodes.interpolation_bound, attributes)


class _BeamSpreadTally:
    """Tally of paths traced with one set of refractive indices, by position of exit."""

    def __init__(
        self,
        stream_index: int,
        index: np.ndarray,
        absorption: np.ndarray,
        weights: np.ndarray,
        half_width: float,
        n_pixels: int,
    ) -> None:
        wavelength_mask = weights > 0.0
        self.wavelength_mask = wavelength_mask
        self.absorption = absorption[wavelength_mask]
        self.weights = weights[wavelength_mask]
        self.half_width = half_width
        self.n_pixels = n_pixels
        optics = make_bounding_optics(index, self.absorption)
        self.strata = [
            Stratum(random_streams.BEAM_SPREAD + stream_index, optics, wavelength_mask, 400.0)
        ]
        self.radial_sums = np.zeros((N_ANGULAR_BATCHES, 2, len(self.absorption), _N_FINE_BINS))
        self.moment_sums = np.zeros((N_ANGULAR_BATCHES, 2, len(self.absorption)))
        self.map_sums = np.zeros((2, 2, len(self.absorption), n_pixels, n_pixels))

    def count_score_values(self) -> int:
        """Return the number of values in the score of a chunk."""
        return int(self.radial_sums[0].size + self.moment_sums[0].size + self.map_sums.size)

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> RadialScore:
        """Return the sums of a chunk of exits."""
        sums = tally_radial(
            exits,
            self.absorption,
            MIN_RADIUS_M,
            BINS_PER_DECADE,
            _N_FINE_BINS,
            self.half_width,
            self.n_pixels,
        )
        return (first_ray // RAYS_PER_CHUNK) % N_ANGULAR_BATCHES, *sums

    def add_scores(self, stratum: Stratum, scores: Sequence[RadialScore]) -> None:
        """Add the sums of chunks one by one: they do not depend on the threads."""
        stratum.n_rays += RAYS_PER_CHUNK * len(scores)
        for batch, radial, moment, pixels in scores:
            self.radial_sums[batch] += radial
            self.moment_sums[batch] += moment
            self.map_sums += pixels


def _compute_radial_fractions(
    tallies: Sequence[_BeamSpreadTally], n_wavelengths: int
) -> np.ndarray:
    """Return the fraction of light by distance and batch."""
    total = np.zeros((N_ANGULAR_BATCHES, 2, n_wavelengths, _N_FINE_BINS))
    for tally in tallies:
        ray_weight = tally.weights[:, np.newaxis] / (tally.strata[0].n_rays / N_ANGULAR_BATCHES)
        total[:, :, tally.wavelength_mask] += ray_weight * tally.radial_sums
    return total


def _compute_quantile_radii(radial_fractions: np.ndarray, quantiles: Sequence[float]) -> np.ndarray:
    """Return the radii (m) within which fractions of the light leave, shape (…, quantiles).

    The logarithm is interpolated between the edges of fine bins; 0 without light.
    """
    cumulative = np.cumsum(radial_fractions, axis=-1)
    edges = np.log(MIN_RADIUS_M) + np.log(10.0) / BINS_PER_DECADE * np.arange(_N_FINE_BINS - 1)
    radii = np.zeros((*radial_fractions.shape[:-1], len(quantiles)))
    for index in np.ndindex(*radial_fractions.shape[:-1]):
        total = cumulative[index][-1]
        if total > 0.0:
            radii[index] = np.exp(np.interp(quantiles, cumulative[index][:-1] / total, edges))
    return radii


def _make_dataset(
    tallies: Sequence[_BeamSpreadTally],
    wavelengths: np.ndarray,
    half_width: float,
    interpolation_bound: np.ndarray,
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Return the sums as a labelled dataset."""
    radial = _compute_radial_fractions(tallies, len(wavelengths))
    moment = np.zeros(radial.shape[:-1])
    for tally in tallies:
        moment[:, :, tally.wavelength_mask] += (
            tally.weights * tally.moment_sums / (tally.strata[0].n_rays / N_ANGULAR_BATCHES)
        )
    maps = _compute_maps(tallies, len(wavelengths))
    binned = radial[..., 1:-1].reshape(*radial.shape[:-1], -1, _FINE_BINS_PER_BIN).sum(axis=-1)
    edges = MIN_RADIUS_M * 10.0 ** (
        np.arange(binned.shape[-1] + 1) * _FINE_BINS_PER_BIN / BINS_PER_DECADE
    )
    profile = binned / (np.pi * np.diff(edges**2))
    radius = np.sqrt(edges[1:] * edges[:-1])
    fraction = radial.sum(axis=-1)
    jackknife_radial = compute_leave_one_out_means(radial)
    jackknife_fraction = compute_leave_one_out_means(fraction)
    mean = _divide_or_zero(moment.mean(axis=0), fraction.mean(axis=0))
    quantile = _compute_quantile_radii(radial.mean(axis=0), RADIUS_QUANTILES)
    pixel_area = (2.0 * half_width / N_MAP_PIXELS) ** 2
    # Without any light recorded, the error is that of one more ray.
    single_ray_error = max(1.0 / tally.strata[0].n_rays for tally in tallies)
    fraction_error = np.where(
        fraction.mean(axis=0) > 0.0, compute_batch_stderr(fraction), single_ray_error
    )
    fraction_error = np.hypot(
        fraction_error, bound_interpolation_error(interpolation_bound, fraction.mean(axis=0))
    )
    jackknife_moment = compute_leave_one_out_means(moment)
    jackknife_quantile = _compute_quantile_radii(jackknife_radial, RADIUS_QUANTILES)
    results = {
        "fraction": ("fraction of light", "1", (), fraction.mean(axis=0), fraction_error),
        "mean_radius": (
            "mean distance between entry and exit", "m", (),
            mean, compute_jackknife_stderr(_divide_or_zero(jackknife_moment, jackknife_fraction)),
        ),
        "quantile_radius": (
            "radius within which a part of the light leaves", "m", ("quantile",),
            quantile, compute_jackknife_stderr(jackknife_quantile),
        ),
        "profile": (
            "light leaving per area", "m-2", ("radius",),
            profile.mean(axis=0), compute_batch_stderr(profile),
        ),
        "profile_map": (
            "light leaving per area", "m-2", ("x", "y"),
            maps[0] / pixel_area, np.sqrt(np.maximum(maps[1], 0.0)) / pixel_area,
        ),
    }  # fmt: skip
    variables: dict[str, Variable] = {}
    for name, (long_name, units, dims, values, stderr) in results.items():
        variable_dims = ("side", "wavelength", *dims)
        variables |= make_variable(name, variable_dims, values, stderr, long_name, units)
    coordinates = _make_coordinates(wavelengths, radius, half_width)
    return xr.Dataset(variables, coordinates, attributes)


def _make_coordinates(
    wavelengths: np.ndarray, radius: np.ndarray, half_width: float
) -> dict[str, Any]:
    """Return the coordinates of the dataset."""
    positions = half_width * ((2.0 * np.arange(N_MAP_PIXELS) + 1.0) / N_MAP_PIXELS - 1.0)
    return {
        "side": ("side", list(SIDES), {"long_name": "side of the sample where light leaves"}),
        "wavelength": make_wavelength_coordinate(wavelengths),
        "quantile": (
            "quantile",
            list(RADIUS_QUANTILES),
            {"long_name": "fraction of the light", "units": "1"},
        ),
        "radius": ("radius", radius, {"long_name": "distance from the entry", "units": "m"}),
        "x": ("x", positions, {"long_name": "distance along the beam's travel", "units": "m"}),
        "y": ("y", positions, {"long_name": "distance across the beam's travel", "units": "m"}),
    }


def _compute_maps(tallies: Sequence[_BeamSpreadTally], n_wavelengths: int) -> np.ndarray:
    """Return the light that leaves through each pixel, and its variance, along the first axis."""
    maps = np.zeros((2, 2, n_wavelengths, N_MAP_PIXELS, N_MAP_PIXELS))
    for tally in tallies:
        n_rays = tally.strata[0].n_rays
        w = tally.weights[:, np.newaxis, np.newaxis]
        maps[0][:, tally.wavelength_mask] += w * tally.map_sums[0] / n_rays
        maps[1][:, tally.wavelength_mask] += (
            w**2 * (tally.map_sums[1] - tally.map_sums[0] ** 2 / n_rays) / n_rays**2
        )
    return maps


def _divide_or_zero(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
    return np.divide(numerator, denominator, out=np.zeros_like(numerator), where=denominator > 0.0)
