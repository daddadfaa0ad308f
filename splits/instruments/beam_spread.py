"""Where light leaves: the spread of a thin beam, by which a BSSRDF differs from a BRDF."""

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
"""Parts of the light that leave within the quantile radii."""

N_MAP_PIXELS = 41
"""Of the map along each edge: odd, so that the point of entry lies in the middle of one."""

MIN_RADIUS_M = 1e-6
BINS_PER_DECADE, N_DECADES = 40, 9
_N_FINE_BINS = BINS_PER_DECADE * N_DECADES + 2
"""Fine bins of distance, from a micrometre to a kilometre, and one beyond each end."""

_FINE_BINS_PER_BIN = 5
"""Fine bins that a bin of the profile takes."""

_INTERPOLATION_TOLERANCE = 0.001
"""Bound on what interpolation between refractive indices may miss of a reflectance."""


SIDES = {"reflected": 0, "transmitted": 1}

RadialScore = tuple[int, np.ndarray, np.ndarray, np.ndarray]
"""What a batch yields: group, weights by distance, first moment, map."""


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
    """Measure how far from its point of entry the light of an infinitely thin beam leaves.

    Parameters
    ----------
    medium : GranularMedium
        For example `splits.Snow`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float
        Polar angle of the beam, 0 to 89.9999 degrees.
    rays : int
        Rounded up.
    seed : int
        Non-negative; the same seed gives the same numbers bit for bit on any number of threads.
    half_width_m : float, optional
        Half the edge of the maps; by default the largest of the radii within which 75 % of the
        reflected light leaves, as a first round of rays sees it.
    threads : int, optional
        Default: every CPU this process may use.
    kernel : {"auto", "vectorized", "scalar"}
        See `splits.spectrophotometer`.
    progress : callable or bool, optional
        True shows a bar; a function is called now and then with a `Progress`.

    Returns
    -------
    xarray.Dataset
        Of light that met a grain, over ``side`` ("reflected", "transmitted") and ``wavelength``:
        ``profile`` (m⁻²) over ``radius``, the BSSRDF integrated over directions of exit weighted
        with their cosine and averaged around the point of entry; ``profile_map`` (m⁻²), the same
        over ``x``, along the beam's direction of travel, and ``y``, across; ``mean_radius`` and
        ``quantile_radius`` (m), the latter over ``quantile``, 0 where no light leaves;
        ``share``, the light there is.  All with their standard errors ``…_stderr``; what
        interpolation between refractive indices may miss is in that of ``share``, and the
        attribute ``interpolation_error_bound`` bounds it.

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
    begun = time.perf_counter()
    index, absorption = compute_optical_constants(medium, wavelengths)
    nodes = choose_nodes(index, medium.list_interfaces(), _INTERPOLATION_TOLERANCE)
    runner = Runner(medium, incidence, seed, threads, False, kernel, progress)

    def spreads(start: int, half_width: float, cells: int) -> list[_BeamSpreadTally]:
        each = enumerate(zip(nodes.index, nodes.weights, strict=True), start=start)
        return [_BeamSpreadTally(n, m, absorption, w, half_width, cells) for n, (m, w) in each]

    def trace(ensembles: list[_BeamSpreadTally], rays: int) -> None:
        runner.trace([(e, level, rays) for e in ensembles for level in e.strata], 1.0, 0.0)

    if half_width_m is None:
        pilot = spreads(len(nodes.index), 0.0, 0)
        trace(pilot, RAYS_PER_ROUND)
        radii = _compute_quantile_radii(
            _compute_radial_fractions(pilot, len(wavelengths)).mean(axis=0), (0.75,)
        )
        # A free path where no light leaves; an edge that a map can be divided by in any case.
        found = radii[0].max() or 1.0 / runner.tracer.traits.attenuation
        half_width_m = np.clip(found, *HALF_WIDTH_RANGE_M["beam_spread"])
    half_width_m = float(half_width_m)
    ensembles = spreads(0, half_width_m, N_MAP_PIXELS)
    trace(ensembles, RAYS_PER_ROUND * -(-rays // (RAYS_PER_ROUND * len(ensembles))))
    facts = {
        **make_run_attributes("Spread of a beam", "beam_spread", medium, begun, seed, threads),
        "incidence_deg": incidence,
        "half_width_m": half_width_m,
        "rays": sum(level.n_rays for e in ensembles for level in e.strata),
        "ensembles": len(ensembles),
        "interpolation_error_bound": float(nodes.interpolation_bound.max()),
        "kernel": runner.list_kernels(ensembles),
    }
    return _make_dataset(ensembles, wavelengths, half_width_m, nodes.interpolation_bound, facts)


class _BeamSpreadTally:
    """Paths traced with one set of refractive indices, and where they leave."""

    def __init__(
        self,
        stream_index: int,
        index: np.ndarray,
        absorption: np.ndarray,
        weights: np.ndarray,
        half_width: float,
        n_pixels: int,
    ) -> None:
        served = weights > 0.0
        self.wavelength_mask = served
        self.absorption = absorption[served]
        self.weights = weights[served]
        self.half_width = half_width
        self.n_pixels = n_pixels
        optics = make_bounding_optics(index, self.absorption)
        self.strata = [Stratum(random_streams.BEAM_SPREAD + stream_index, optics, served, 400.0)]
        self.radial_sums = np.zeros((N_ANGULAR_BATCHES, 2, len(self.absorption), _N_FINE_BINS))
        self.moment_sums = np.zeros((N_ANGULAR_BATCHES, 2, len(self.absorption)))
        self.map_sums = np.zeros((2, 2, len(self.absorption), n_pixels, n_pixels))

    def count_score_values(self) -> int:
        """Return how many numbers a tally holds."""
        return int(self.radial_sums[0].size + self.moment_sums[0].size + self.map_sums.size)

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> RadialScore:
        """Return the sums of a batch of exits."""
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
        """Add the sums of batches one by one: they do not depend on who traced them."""
        stratum.n_rays += RAYS_PER_CHUNK * len(scores)
        for group, radial, moment, place in scores:
            self.radial_sums[group] += radial
            self.moment_sums[group] += moment
            self.map_sums += place


def _compute_radial_fractions(
    tallies: Sequence[_BeamSpreadTally], n_wavelengths: int
) -> np.ndarray:
    """Return the share of light by distance, by groups of rays."""
    total = np.zeros((N_ANGULAR_BATCHES, 2, n_wavelengths, _N_FINE_BINS))
    for e in tallies:
        share = e.weights[:, np.newaxis] / (e.strata[0].n_rays / N_ANGULAR_BATCHES)
        total[:, :, e.wavelength_mask] += share * e.radial_sums
    return total


def _compute_quantile_radii(radial_fractions: np.ndarray, quantiles: Sequence[float]) -> np.ndarray:
    """Return the radii (m) within which parts of the light leave, shape (…, quantiles).

    Between the edges of fine bins the logarithm is interpolated; 0 where there is no light.
    """
    within = np.cumsum(radial_fractions, axis=-1)
    edges = np.log(MIN_RADIUS_M) + np.log(10.0) / BINS_PER_DECADE * np.arange(_N_FINE_BINS - 1)
    found = np.zeros((*radial_fractions.shape[:-1], len(quantiles)))
    for place in np.ndindex(*radial_fractions.shape[:-1]):
        total = within[place][-1]
        if total > 0.0:
            found[place] = np.exp(np.interp(quantiles, within[place][:-1] / total, edges))
    return found


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
    for e in tallies:
        moment[:, :, e.wavelength_mask] += (
            e.weights * e.moment_sums / (e.strata[0].n_rays / N_ANGULAR_BATCHES)
        )
    place = _compute_maps(tallies, len(wavelengths))
    inner = radial[..., 1:-1].reshape(*radial.shape[:-1], -1, _FINE_BINS_PER_BIN).sum(axis=-1)
    edges = MIN_RADIUS_M * 10.0 ** (
        np.arange(inner.shape[-1] + 1) * _FINE_BINS_PER_BIN / BINS_PER_DECADE
    )
    profile = inner / (np.pi * np.diff(edges**2))
    radius = np.sqrt(edges[1:] * edges[:-1])
    share = radial.sum(axis=-1)
    left_out, less = compute_leave_one_out_means(radial), compute_leave_one_out_means(share)
    mean = _divide_or_zero(moment.mean(axis=0), share.mean(axis=0))
    quantile = _compute_quantile_radii(radial.mean(axis=0), RADIUS_QUANTILES)
    cell = (2.0 * half_width / N_MAP_PIXELS) ** 2
    # Nothing seen is not certainty: as if one more ray had come.
    unseen = max(1.0 / e.strata[0].n_rays for e in tallies)
    certain = np.where(share.mean(axis=0) > 0.0, compute_batch_stderr(share), unseen)
    certain = np.hypot(certain, bound_interpolation_error(interpolation_bound, share.mean(axis=0)))
    results = {
        "fraction": ("share of light", "1", (), share.mean(axis=0), certain),
        "mean_radius": (
            "mean distance between entry and exit", "m", (),
            mean, compute_jackknife_stderr(_divide_or_zero(compute_leave_one_out_means(moment), less)),
        ),
        "quantile_radius": (
            "radius within which a part of the light leaves", "m", ("quantile",),
            quantile, compute_jackknife_stderr(_compute_quantile_radii(left_out, RADIUS_QUANTILES)),
        ),
        "profile": (
            "light leaving per area", "m-2", ("radius",), profile.mean(axis=0), compute_batch_stderr(profile),
        ),
        "profile_map": (
            "light leaving per area", "m-2", ("x", "y"),
            place[0] / cell, np.sqrt(np.maximum(place[1], 0.0)) / cell,
        ),
    }  # fmt: skip
    variables: dict[str, Variable] = {}
    for name, (long_name, units, dims, values, stderr) in results.items():
        over = ("side", "wavelength", *dims)
        variables |= make_variable(name, over, values, stderr, long_name, units)
    across = half_width * ((2.0 * np.arange(N_MAP_PIXELS) + 1.0) / N_MAP_PIXELS - 1.0)
    coordinates = {
        "side": ("side", list(SIDES), {"long_name": "side of the sample that light leaves"}),
        "wavelength": make_wavelength_coordinate(wavelengths),
        "quantile": (
            "quantile",
            list(RADIUS_QUANTILES),
            {"long_name": "part of the light", "units": "1"},
        ),
        "radius": ("radius", radius, {"long_name": "distance from the entry", "units": "m"}),
        "x": ("x", across, {"long_name": "distance along the beam's travel", "units": "m"}),
        "y": ("y", across, {"long_name": "distance across the beam's travel", "units": "m"}),
    }
    return xr.Dataset(variables, coordinates, attributes)


def _compute_maps(tallies: Sequence[_BeamSpreadTally], n_wavelengths: int) -> np.ndarray:
    """Return the light that leaves through each cell, and its variance, in the first axis."""
    place = np.zeros((2, 2, n_wavelengths, N_MAP_PIXELS, N_MAP_PIXELS))
    for e in tallies:
        rays = e.strata[0].n_rays
        w = e.weights[:, np.newaxis, np.newaxis]
        place[0][:, e.wavelength_mask] += w * e.map_sums[0] / rays
        place[1][:, e.wavelength_mask] += (
            w**2 * (e.map_sums[1] - e.map_sums[0] ** 2 / rays) / rays**2
        )
    return place


def _divide_or_zero(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
    return np.divide(numerator, denominator, out=np.zeros_like(numerator), where=denominator > 0.0)
