"""Systematic errors of radiative fluxes inside a medium, besides the scatter of batches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.instruments.flux_tally import FluxPathTally
from splits.kernels.grains.scene import WET_PORE
from splits.kernels.tallies.flux import DOWNWARD
from splits.media.medium import GranularMedium, LayeredMedium, compute_pore_fraction
from splits.media.stacked_particle_layer import StackedParticleLayer
from splits.simulation.spectral_nodes import MAX_LOG_SLOPE

MIN_NONZERO_BATCHES = 8
"""Number of batches with light below which an error includes that of one more ray."""


MAX_BRIGHTENING = 4.0
"""Largest ratio of the light at a plane, or along paths below it, to that at the plane above."""


class SystematicError(NamedTuple):
    """Errors other than the scatter of batches.

    Attributes
    ----------
    irradiance : float, shape (2, depths, wavelengths)
        Of irradiances.
    absorptance : float, shape (intervals, wavelengths)
        Of absorptances.
    irreducible : list of float
        The part of both that more rays do not reduce: of interpolation, and of truncation.
    interpolation_bound : float, shape (wavelengths,)
        See `bound_flux_interpolation_error`.
    unsampled_light : float, shape (intervals, wavelengths)
        See `bound_unsampled_light`.
    """

    irradiance: np.ndarray
    absorptance: np.ndarray
    irreducible: list[np.ndarray]
    interpolation_bound: np.ndarray
    unsampled_light: np.ndarray


def estimate_systematic_error(
    estimates: Sequence[np.ndarray],
    perturbed_estimates: Sequence[np.ndarray] | None,
    interpolation_bound: np.ndarray,
    single_ray_error: np.ndarray,
) -> SystematicError:
    """Return the errors of irradiances and absorptances other than scatter.

    Parameters
    ----------
    estimates, perturbed_estimates : sequence of float
        Irradiance and absorptance, see `splits.instruments.flux_estimate.FluxEstimate`; the same
        with a more absorbing substrate, None without truncation.
    interpolation_bound : float, shape (wavelengths,)
        Bound on the interpolation error, see `splits.simulation.spectral_nodes.IndexNodes`.
    single_ray_error : float, shape (wavelengths,)
        Contribution of one more ray to a mean.
    """
    unsampled = bound_unsampled_light(estimates[0][:, DOWNWARD], single_ray_error)
    unsampled_below = unsampled[1 : estimates[1].shape[1] + 1]
    irreducible = [
        bound_flux_interpolation_error(interpolation_bound, batch_means.mean(axis=0))
        for batch_means in estimates
    ]
    if perturbed_estimates is not None:
        irreducible = [
            np.hypot(error, (batch_means - perturbed).mean(axis=0))
            for error, batch_means, perturbed in zip(
                irreducible, estimates, perturbed_estimates, strict=True
            )
        ]
    rare_event_errors = [
        estimate_rare_event_error(*batch_means_and_light)
        for batch_means_and_light in zip(estimates, (unsampled[:-1], unsampled_below), strict=True)
    ]
    irradiance, absorptance = (
        np.hypot(error, rare_event_error)
        for error, rare_event_error in zip(irreducible, rare_event_errors, strict=True)
    )
    return SystematicError(
        irradiance, absorptance, irreducible, interpolation_bound, unsampled_below
    )


def estimate_rare_event_error(batch_means: np.ndarray, unsampled_light: np.ndarray) -> np.ndarray:
    """Return the errors of means that few batches dominate.

    A quantity with fewer than `MIN_NONZERO_BATCHES` nonzero batches may be wrong by one ray.  Where
    as few batches contribute most of it, an allowance is made for one more like the largest.

    Parameters
    ----------
    batch_means : float, shape (N_BATCHES, ..., wavelengths)
    unsampled_light : float, shape (..., wavelengths)
        Largest contribution of unsampled rays, see `bound_unsampled_light`.
    """
    total, square = np.abs(batch_means).sum(axis=0), (batch_means**2).sum(axis=0)
    largest = np.abs(batch_means).max(axis=0) / len(batch_means)
    largest_error = np.where(total**2 < MIN_NONZERO_BATCHES * square, largest, 0.0)
    error: np.ndarray = np.hypot(
        np.where(is_sparse(batch_means), unsampled_light, 0.0), largest_error
    )
    return error


def is_sparse(batch_means: np.ndarray) -> np.ndarray:
    """Return where only few batches are nonzero."""
    sparse: np.ndarray = (batch_means != 0.0).sum(axis=0) < MIN_NONZERO_BATCHES
    return sparse


def bound_unsampled_light(
    downward_irradiance: np.ndarray, single_ray_error: np.ndarray
) -> np.ndarray:
    """Return a bound on the light of unsampled rays at each depth and below it.

    It is that of one more ray, and at most a multiple of the light that reaches the plane above,
    since unsampled rays are absorbed on the way to it, too.

    Parameters
    ----------
    downward_irradiance : float, shape (N_BATCHES, depths, wavelengths)
        Irradiance downwards.
    single_ray_error : float, shape (wavelengths,)

    Returns
    -------
    float, shape (depths + 1, wavelengths)
        The last below the last depth.
    """
    sparse = is_sparse(downward_irradiance)
    mean_irradiance = downward_irradiance.mean(axis=0)
    bounds, ceiling = [single_ray_error], single_ray_error
    for is_rare, mean in zip(sparse, mean_irradiance, strict=True):
        ceiling = mean + np.where(is_rare, np.minimum(ceiling, single_ray_error), 0.0)
        bounds.append(np.minimum(single_ray_error, MAX_BRIGHTENING * ceiling))
    return np.stack(bounds)


class AbsorptionSteps(NamedTuple):
    """Steps in which weights decrease inside a medium, each of shape (intervals, wavelengths).

    Attributes
    ----------
    optical_depth : float
        Largest optical depth of a mean step: through a grain, or through a pore from one grain to
        the next.
    unscored_path_m : float
        Mean segment before a ray's first step (m), times the fraction of its light absorbed there.
    absorption_rate : float
        Fraction of the light absorbed in steps, per metre of path.
    """

    optical_depth: np.ndarray
    unscored_path_m: np.ndarray
    absorption_rate: np.ndarray


def compute_absorption_steps(
    medium: GranularMedium | LayeredMedium, absorption: np.ndarray, planes_m: np.ndarray
) -> AbsorptionSteps:
    """Return the steps in which weights decrease inside a medium.

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
    absorption : float, shape (wavelengths, columns)
        1/m; see `splits.simulation.scene.OpticalConstants`.
    planes_m : float, shape (intervals + 1,)
        Depths between which intervals lie (m).
    """
    first, top = 0, 0.0
    by_interval: list[list[AbsorptionSteps]] = [[] for _ in planes_m[1:]]
    for layer in medium.scene_layers if isinstance(medium, LayeredMedium) else (medium,):
        last, bottom = first + len(layer.list_materials()), top + float(layer.depth_m)
        layer_steps = _compute_layer_steps(layer, absorption[:, first:last])
        for interval_steps, begin, end in zip(
            by_interval, planes_m[:-1], planes_m[1:], strict=True
        ):
            if begin < bottom and end > top:
                interval_steps.append(layer_steps)
        first, top = last, bottom
    return AbsorptionSteps(
        np.array(
            [
                np.max([s.optical_depth for s in interval_steps], axis=0)
                for interval_steps in by_interval
            ]
        ),
        np.array(
            [
                np.max([s.unscored_path_m for s in interval_steps], axis=0)
                for interval_steps in by_interval
            ]
        ),
        np.array(
            [
                np.min([s.absorption_rate for s in interval_steps], axis=0)
                for interval_steps in by_interval
            ]
        ),
    )


def _compute_layer_steps(
    medium: GranularMedium | StackedParticleLayer, absorption: np.ndarray
) -> AbsorptionSteps:
    """Return the steps in a layer by wavelength; 0 where particles absorb along paths.

    The mean chord of convex grains is their volume over their projected area; the mean segment
    between two of them is that of a ray in the pore space.  A ray crosses some three thicknesses of
    a coating on its way in and out; the chord of a sphere is two thirds of the diameter.
    """
    if isinstance(medium, StackedParticleLayer):
        zeros = np.zeros(len(absorption))
        return AbsorptionSteps(zeros, zeros, absorption[:, WET_PORE])
    grains, types = medium.make_grain_population(), medium.make_grain_population().types
    segment = 1.0 / grains.attenuation
    pore = segment * compute_pore_fraction(medium)
    per_solid_fraction = (
        getattr(medium.interpretation, "attenuation_factor", "solid_fraction") == "solid_fraction"
    )
    chord = medium.mean_grain_distance_m * (1.0 - medium.porosity if per_solid_fraction else 1.0)
    fractions = np.diff(grains.type_cdf, prepend=0.0)
    depths, step_fractions = [], []
    for grain_type in np.flatnonzero(fractions > 0.0):
        n_coatings = types.n_shells[grain_type] - 1
        coating = (
            absorption[:, types.material[grain_type, :n_coatings]]
            @ types.coating_thickness[grain_type, :n_coatings]
        )
        core = absorption[:, types.material[grain_type, n_coatings]]
        depths.append(chord * (core + 4.5 * coating))
        step_fractions.append(fractions[grain_type])
    pore_fractions = [1.0 - medium.wet_fraction - sum(medium.pores.values()), medium.wet_fraction]
    for pore, fraction in enumerate([*pore_fractions, *medium.pores.values()]):
        if fraction > 0.0:
            depths.append(segment * absorption[:, pore])
            step_fractions.append(fraction)
    absorbed = np.array(step_fractions) @ -np.expm1(-np.array(depths))
    return AbsorptionSteps(
        np.max(depths, axis=0), pore * np.minimum(absorbed, 1.0), absorbed / pore
    )


def _compute_path_excess(optical_depth: np.ndarray) -> np.ndarray:
    """Return the relative excess of a path over one along which weights decrease evenly."""
    d = np.maximum(optical_depth, 1e-9)
    excess: np.ndarray = d / -np.expm1(-d) - 1.0
    return excess


def bound_actinic_flux_error(
    steps: AbsorptionSteps, actinic_flux: np.ndarray, absorption: np.ndarray, incident: np.ndarray
) -> np.ndarray:
    """Return a bound on the error of the actinic flux, shape (intervals, wavelengths).

    Between two planes weights are assumed to decrease evenly along the path.  They decrease in
    steps of optical depth d, so that a path by weight may be d/(1 − exp(−d)) times as long.  Where
    steps are so large that a ray ends in its first one, the segment before it is not scored.  Where
    that error is large, the path also follows from the absorptance of the interval, which is known
    independently: twice the difference, plus a tenth, is then the smaller bound.

    Parameters
    ----------
    steps : AbsorptionSteps
    actinic_flux : float, shape (intervals, wavelengths)
    absorption, incident : float, shape (intervals, wavelengths)
        Light absorbed in an interval, and light incident through its planes, over its thickness
        (1/m).
    """
    step_bound = (
        _compute_path_excess(steps.optical_depth) * actinic_flux + steps.unscored_path_m * incident
    )
    absorbed = np.maximum(absorption, 0.0)
    path = np.divide(
        absorbed,
        steps.absorption_rate,
        out=np.full_like(actinic_flux, np.inf),
        where=steps.absorption_rate > 0.0,
    )
    bound: np.ndarray = np.minimum(
        step_bound, 2.0 * np.abs(path - actinic_flux) + 0.1 * actinic_flux
    )
    return bound


def bound_material_absorptance_error(
    steps: AbsorptionSteps,
    absorptance: np.ndarray,
    total_absorptance: np.ndarray,
    unscored_absorptance: np.ndarray,
) -> np.ndarray:
    """Return a bound on the error of the absorptances of materials.

    It follows from the effect of steps on paths (see `bound_actinic_flux_error`), and is at most
    the total absorptance; an excess of one material is a deficit of the others.

    Parameters
    ----------
    steps : AbsorptionSteps
    absorptance : float, shape (intervals, materials, wavelengths)
        Absorptance of each material.
    total_absorptance, unscored_absorptance : float, shape (intervals, wavelengths)
        Absorptance of all materials, and its part that no path scores.
    """
    total_absorptance, unscored_absorptance = (
        total_absorptance[:, np.newaxis],
        unscored_absorptance[:, np.newaxis],
    )
    exchangeable = np.minimum(absorptance, np.maximum(total_absorptance - absorptance, 0.0))
    excess = (
        _compute_path_excess(steps.optical_depth)[:, np.newaxis] * exchangeable
        + unscored_absorptance
    )
    bound: np.ndarray = np.minimum(excess, np.maximum(total_absorptance, 0.0))
    return bound


def compute_nonstatistical_error(
    batch_means: np.ndarray, interpolation_bound: np.ndarray, unsampled_light: np.ndarray
) -> np.ndarray:
    """Return the errors of means over batches other than their scatter.

    Parameters
    ----------
    batch_means : float, shape (N_BATCHES, ..., wavelengths)
    interpolation_bound : float, shape (wavelengths,)
        See `bound_flux_interpolation_error`.
    unsampled_light : float, shape (..., wavelengths)
        See `estimate_rare_event_error`.
    """
    error: np.ndarray = np.hypot(
        bound_flux_interpolation_error(interpolation_bound, batch_means.mean(axis=0)),
        estimate_rare_event_error(batch_means, unsampled_light),
    )
    return error


def bound_flux_interpolation_error(
    interpolation_bound: np.ndarray, value: np.ndarray
) -> np.ndarray:
    """Return a bound on the interpolation error of irradiances and similar quantities.

    It is that of a reflectance (`splits.simulation.spectral_nodes`), with the elasticity |ln f| of
    quantities that decay exponentially with depth, where that is larger.

    Parameters
    ----------
    interpolation_bound : float, shape (wavelengths,)
    value : float, shape (..., wavelengths)
        Value of the quantity.
    """
    size = np.clip(np.abs(value), np.finfo(float).tiny, None)
    elastic = size * np.maximum(8.0, np.abs(np.log(size)) / MAX_LOG_SLOPE)
    bound: np.ndarray = interpolation_bound * np.minimum(np.maximum(1.0, size), elastic)
    return bound


def compute_single_ray_error(tallies: Sequence[FluxPathTally], weights: np.ndarray) -> np.ndarray:
    """Return the contribution of one more ray to the mean by wavelength, shape (wavelengths,)."""
    n_rays = np.stack([np.maximum(tally.n_rays, 1.0) for tally in tallies])
    contribution: np.ndarray = (weights / n_rays).max(axis=0)
    return contribution
