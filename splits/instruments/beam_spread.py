"""Spatial spread of a thin beam, the dependence on position of a BSSRDF."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import xarray as xr

from splits.core.declarations import Quantity
from splits.core.inputs import BeamAngle, Kernel, RayCount, Seed, Threads, Wavelengths
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import (
    Variable,
    compute_jackknife_stderr,
    compute_leave_one_out_means,
    make_variable,
)
from splits.instruments.angular_estimate import N_ANGULAR_BATCHES
from splits.kernels.tallies.distributions import RadialSums, tally_radial
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate
from splits.simulation.scene import build_scene, compute_optical_constants
from splits.simulation.spectral_nodes import IndexNodes, choose_nodes
from splits.simulation.strata import StoppingRule, Stratum
from splits.simulation.tally import RAYS_PER_CHUNK, ExitTally

# --------------------------------------------------------------------------------------------------
# Tally of the spread of a thin beam, and its dataset.

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


class BeamSpreadTally(ExitTally):
    """Tally of exits by their distance and direction from the point of entry.

    Parameters
    ----------
    nodes, absorption
        See `Tally`.
    half_width : float
        Half of the side length of the maps (m).
    n_pixels : int
        Pixels of the maps along each edge; 0 for none.
    first_node : int
        Number of the first node, which determines the random streams.

    Attributes
    ----------
    radial_sums : float, shape (batches, 2, node rows, bins)
    moment_sums : float, shape (batches, 2, node rows)
    map_sums : float, shape (2, 2, node rows, pixels, pixels)
        See `splits.kernels.tallies.distributions.RadialSums`.
    """

    first_stream = 6_000_000
    rays_per_round = N_ANGULAR_BATCHES * RAYS_PER_CHUNK

    def __init__(
        self,
        nodes: IndexNodes,
        absorption: np.ndarray,
        half_width: float,
        n_pixels: int = N_MAP_PIXELS,
        first_node: int = 0,
    ) -> None:
        super().__init__(nodes, absorption)
        self.half_width, self.n_pixels = half_width, n_pixels
        n_rows = len(self.rows)
        self.radial_sums = np.zeros((N_ANGULAR_BATCHES, 2, n_rows, _N_FINE_BINS))
        self.moment_sums = np.zeros((N_ANGULAR_BATCHES, 2, n_rows))
        self.map_sums = np.zeros((2, 2, n_rows, n_pixels, n_pixels))
        self.values_per_row = 2 * (_N_FINE_BINS + 1) + 4 * n_pixels**2
        self.first_stream += first_node
        self.add_strata()

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> RadialSums:
        """Return the sums of a chunk of exits."""
        bins = (MIN_RADIUS_M, BINS_PER_DECADE, _N_FINE_BINS)
        return tally_radial(exits, stratum.absorption, *bins, self.half_width, self.n_pixels)

    def merge(self, stratum: Stratum, score: RadialSums) -> None:
        """Add the sums of the next chunk of a stratum."""
        batch, rows = self.get_batch(stratum, N_ANGULAR_BATCHES), stratum.node_rows
        self.radial_sums[batch, :, rows] += score.radial
        self.moment_sums[batch, :, rows] += score.first_moment
        self.map_sums[:, :, rows] += score.exit_map

    def to_dataset(self, wavelengths: np.ndarray, attributes: dict[str, Any]) -> xr.Dataset:
        """Return the labelled dataset of `splits.beam_spread`."""
        radial, moment = map(self.average_batches, (self.radial_sums, self.moment_sums))
        binned = radial[..., 1:-1].reshape(*radial.shape[:-1], -1, _FINE_BINS_PER_BIN).sum(axis=-1)
        edges = MIN_RADIUS_M * 10.0 ** (
            np.arange(binned.shape[-1] + 1) * _FINE_BINS_PER_BIN / BINS_PER_DECADE
        )
        annulus_area = np.pi * np.diff(edges**2)
        fraction = radial.sum(axis=-1)
        mean_fraction = fraction.mean(axis=0)
        fraction_error = self.compute_fraction_error(fraction, self.nodes.interpolation_bound)
        # Without the error of interpolation, which the fraction includes.
        binned_error = self.compute_fraction_error(binned, np.zeros(1))
        jackknife_radius = divide_or_zero(*map(compute_leave_one_out_means, (moment, fraction)))
        jackknife_quantile = compute_quantile_radii(
            compute_leave_one_out_means(radial), RADIUS_QUANTILES
        )
        pixel_area = (2.0 * self.half_width / self.n_pixels) ** 2
        map_mean, map_error = (
            np.moveaxis(one, -1, 1) / pixel_area
            for one in self.combine_moments(*np.moveaxis(self.map_sums, 2, -1))
        )
        results = {
            "fraction": ("fraction of light", "1", (), mean_fraction, fraction_error),
            "mean_radius": (
                "mean distance between entry and exit", "m", (),
                divide_or_zero(moment.mean(axis=0), mean_fraction),
                compute_jackknife_stderr(jackknife_radius),
            ),
            "quantile_radius": (
                "radius within which a part of the light leaves", "m", ("quantile",),
                compute_quantile_radii(radial.mean(axis=0), RADIUS_QUANTILES),
                compute_jackknife_stderr(jackknife_quantile),
            ),
            "profile": (
                "light leaving per area", "m-2", ("radius",),
                binned.mean(axis=0) / annulus_area, binned_error / annulus_area,
            ),
            "profile_map": ("light leaving per area", "m-2", ("x", "y"), map_mean, map_error),
        }  # fmt: skip
        variables: dict[str, Variable] = {}
        for name, (long_name, units, dims, values, stderr) in results.items():
            variable_dims = ("side", "wavelength", *dims)
            variables |= make_variable(name, variable_dims, values, stderr, long_name, units)
        radius = np.sqrt(edges[1:] * edges[:-1])
        pixels = (2.0 * np.arange(self.n_pixels) + 1.0) / self.n_pixels - 1.0
        positions = self.half_width * pixels
        coordinates = {
            "side": ("side", list(SIDES), {"long_name": "side of the sample where light leaves"}),
            "wavelength": make_wavelength_coordinate(wavelengths),
            "quantile": (
                "quantile", list(RADIUS_QUANTILES),
                {"long_name": "fraction of the light", "units": "1"},
            ),
            "radius": ("radius", radius, {"long_name": "distance from the entry", "units": "m"}),
            "x": ("x", positions, {"long_name": "distance along the beam's travel", "units": "m"}),
            "y": ("y", positions, {"long_name": "distance across the beam's travel", "units": "m"}),
        }  # fmt: skip
        return xr.Dataset(variables, coordinates, attributes)


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


def divide_or_zero(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
    """Return quotients, 0 where the denominator is not above 0."""
    shape = np.broadcast_shapes(numerator.shape, denominator.shape)
    return np.divide(numerator, denominator, out=np.zeros(shape), where=denominator > 0.0)


# --------------------------------------------------------------------------------------------------
# Spatial spread of a thin beam, the dependence on position of a BSSRDF.

NODE_TOLERANCE = 0.001
"""Bound on the error of a reflectance from interpolation between refractive indices."""


HALF_WIDTH_RANGE_M = (1e-9, 1e6)
MapHalfWidth = Annotated[
    float | None,
    Quantity(
        "half the side length of the map, by default from the spread", "m",
        low=HALF_WIDTH_RANGE_M[0], high=HALF_WIDTH_RANGE_M[1],
    ),
]  # fmt: skip


@declare_function
def beam_spread(
    medium: Medium,
    wavelength_nm: Wavelengths,
    incidence_deg: BeamAngle = 0.0,
    *,
    rays: RayCount = 200_000,
    half_width_m: MapHalfWidth = None,
    seed: Seed = 1,
    threads: Threads = None,
    kernel: Kernel = "auto",
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
    half_width_m : float, optional
        Half of the side length of the maps; by default the largest of the radii within which 75 %
        of the reflected light leaves, estimated from a first round of rays.
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
    wavelengths, incidence = np.asarray(wavelength_nm), incidence_deg
    run = RunOptions.start(seed, threads, kernel, progress)
    index, absorption = compute_optical_constants(medium, wavelengths)
    nodes = choose_nodes(index, medium.list_interfaces(), NODE_TOLERANCE)
    scene = build_scene(medium, incidence, False)
    if half_width_m is None:
        pilot = BeamSpreadTally(nodes, absorption, 0.0, 0, first_node=len(nodes.index))
        simulate(scene, pilot, StoppingRule(0.0, 1, fixed=True), run)
        radii = compute_quantile_radii(
            pilot.average_batches(pilot.radial_sums).mean(axis=0), (0.75,)
        )
        # One mean free path where no light leaves; the edge must be positive.
        radius = radii[0].max() or 1.0 / scene.layers.collision_coefficient.max()
        half_width_m = np.clip(radius, *HALF_WIDTH_RANGE_M)
    tally = BeamSpreadTally(nodes, absorption, float(half_width_m))
    evaluation = simulate(scene, tally, StoppingRule(0.0, rays, fixed=True), run)
    attributes = {
        **run.make_attributes("Spread of a beam", "beam_spread", medium),
        "incidence_deg": incidence,
        "half_width_m": tally.half_width,
        **tally.describe_run(evaluation.stop_reason),
    }
    return tally.to_dataset(wavelengths, attributes)
