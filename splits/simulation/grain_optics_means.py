"""Means over the grains of a medium, and their errors, from tallies of index nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splits.core.uncertainty import compute_leave_one_out_means
from splits.kernels.grains.single_grain import (
    N_SCATTERING_BATCHES,
)

MOMENT_SLOPE_RATIO = 2.0
"""Ratio of the largest slope of a Legendre moment to that of a reflectance: a forward lobe as wide
as the contrast c has χ_l ~ exp(−c² l²/2), and |dχ/d(ln c)| up to 2/e."""
WEIGHTED_MEANS = (
    "displacement_along_incident",
    "displacement_along_exit",
    "mean_square_displacement",
    "wet_fraction",
)
"""Other means weighted by scattered light, in the order of `tally_single_scattering`."""


@dataclass(frozen=True)
class NodeTally:
    """Tallies of one node, per ray, for the wavelengths that use it.

    Attributes
    ----------
    wavelength_mask : bool, shape (wavelengths,)
    weight : float, shape (used,)
        Weight of this node in the wavelengths' means.
    sums : float, shape (3, orders + 4, used)
    batch_sums : float, shape (N_SCATTERING_BATCHES, orders + 4, used)
        See `splits.kernels.grains.single_grain.tally_single_scattering`.
    """

    wavelength_mask: np.ndarray
    weight: np.ndarray
    sums: np.ndarray
    batch_sums: np.ndarray


def estimate_grain_means(
    node_tallies: list[NodeTally], interpolation_bound: np.ndarray, n_orders: int, n_rays: int
) -> dict[str, np.ndarray]:
    """Return means over grains and their standard errors, by name.

    All but the albedo are ratios of means, <w x>/<w>; the error is that of w (x − <w x>/<w>), to
    first order.
    """
    mean = np.zeros((n_orders + len(WEIGHTED_MEANS), len(interpolation_bound)))
    batch_means = np.zeros((N_SCATTERING_BATCHES, *mean.shape))
    for node_tally in node_tallies:
        mean[:, node_tally.wavelength_mask] += node_tally.weight * node_tally.sums[0]
        batch_means[:, :, node_tally.wavelength_mask] += node_tally.weight * node_tally.batch_sums
    albedo = mean[0]
    # Where nothing is scattered, the moments are 0 instead of NaN.
    scattered = np.maximum(albedo, np.finfo(float).tiny)
    ratio = mean / scattered
    variance = np.zeros(len(interpolation_bound))
    ratio_variance = np.zeros(mean.shape)
    for node_tally in node_tallies:
        mean_sum, product_sum, square_sum = node_tally.sums
        node_ratio = ratio[:, node_tally.wavelength_mask]
        variance[node_tally.wavelength_mask] += node_tally.weight**2 * np.maximum(
            square_sum[0] - mean_sum[0] ** 2, 0.0
        )
        residual = square_sum - 2.0 * node_ratio * product_sum + node_ratio**2 * square_sum[0]
        residual -= (mean_sum - node_ratio * mean_sum[0]) ** 2
        ratio_variance[:, node_tally.wavelength_mask] += node_tally.weight**2 * np.maximum(
            residual, 0.0
        )
    error_bound = MOMENT_SLOPE_RATIO * interpolation_bound * np.abs(ratio)
    error_bound[:n_orders] = (
        MOMENT_SLOPE_RATIO
        * interpolation_bound
        * np.clip(8.0 * np.abs(_bernoulli_variance(ratio[:n_orders])), 0.0, 1.0)
    )
    error = np.sqrt(ratio_variance / (n_rays * scattered**2) + error_bound**2)
    jackknife_means = compute_leave_one_out_means(batch_means)
    jackknife_ratios = jackknife_means / np.maximum(jackknife_means[:, :1], np.finfo(float).tiny)
    albedo_bound = interpolation_bound * np.clip(8.0 * _bernoulli_variance(albedo), 0.0, 1.0)
    values = {
        "single_scattering_albedo": albedo,
        "single_scattering_albedo_stderr": np.sqrt(variance / n_rays + albedo_bound**2),
        "single_scattering_albedo_jackknife": jackknife_means[:, 0],
        "single_scattering_albedo_interpolation_bound": albedo_bound,
    }
    rows = {"legendre_moment": slice(n_orders), "asymmetry_parameter": 1}
    rows |= {name: n_orders + row for row, name in enumerate(WEIGHTED_MEANS)}
    for name, row in rows.items():
        for suffix, table in (
            ("", ratio),
            ("_stderr", error),
            ("_interpolation_bound", error_bound),
        ):
            values[f"{name}{suffix}"] = table[row].T
        values[f"{name}_jackknife"] = np.moveaxis(jackknife_ratios[:, row], 1, -1)
    return values


def _bernoulli_variance(probability: np.ndarray) -> np.ndarray:
    """Return x (1 − x), which is 0 where a fraction cannot depend on the refractive index."""
    return probability * (1.0 - probability)
