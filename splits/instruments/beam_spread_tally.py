"""Tally of the spread of a thin beam, and its dataset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import (
    Variable,
    compute_batch_stderr,
    compute_jackknife_stderr,
    compute_leave_one_out_means,
    make_variable,
)
from splits.instruments.angular_estimate import bound_interpolation_error
from splits.instruments.angular_tally import N_ANGULAR_BATCHES
from splits.kernels.grains.scene import make_bounding_optics
from splits.kernels.tallies.radial import tally_radial
from splits.simulation import random_streams
from splits.simulation.attributes import make_wavelength_coordinate
from splits.simulation.runner import RAYS_PER_CHUNK
from splits.simulation.tally import Stratum

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
SIDES = {"reflected": 0, "transmitted": 1}
RadialScore = tuple[int, np.ndarray, np.ndarray, np.ndarray]
"""Score of a chunk: batch, weights by distance, first moment, map."""


class BeamSpreadTally:
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


def compute_radial_fractions(tallies: Sequence[BeamSpreadTally], n_wavelengths: int) -> np.ndarray:
    """Return the fraction of light by distance and batch."""
    total = np.zeros((N_ANGULAR_BATCHES, 2, n_wavelengths, _N_FINE_BINS))
    for tally in tallies:
        ray_weight = tally.weights[:, np.newaxis] / (tally.strata[0].n_rays / N_ANGULAR_BATCHES)
        total[:, :, tally.wavelength_mask] += ray_weight * tally.radial_sums
    return total


def compute_quantile_radii(radial_fractions: np.ndarray, quantiles: Sequence[float]) -> np.ndarray:
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


def make_beam_spread_dataset(
    tallies: Sequence[BeamSpreadTally],
    wavelengths: np.ndarray,
    half_width: float,
    interpolation_bound: np.ndarray,
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Return the sums as a labelled dataset."""
    radial = compute_radial_fractions(tallies, len(wavelengths))
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
    quantile = compute_quantile_radii(radial.mean(axis=0), RADIUS_QUANTILES)
    pixel_area = (2.0 * half_width / N_MAP_PIXELS) ** 2
    # Without any light recorded, the error is that of one more ray.
    single_ray_error = max(1.0 / tally.strata[0].n_rays for tally in tallies)
    mean_fraction = fraction.mean(axis=0)
    fraction_error = np.hypot(
        np.where(mean_fraction > 0.0, compute_batch_stderr(fraction), single_ray_error),
        bound_interpolation_error(interpolation_bound, mean_fraction),
    )
    jackknife_moment = compute_leave_one_out_means(moment)
    jackknife_quantile = compute_quantile_radii(jackknife_radial, RADIUS_QUANTILES)
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


def _compute_maps(tallies: Sequence[BeamSpreadTally], n_wavelengths: int) -> np.ndarray:
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
