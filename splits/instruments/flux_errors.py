"""What errors of the light inside hold besides the scatter of groups of rays."""

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
"""Groups of rays with light up to which an error allows for one ray more."""


MAX_BRIGHTENING = 4.0
"""Times that light at a plane, or along paths below it, may exceed what reaches the plane above."""


class SystematicError(NamedTuple):
    """What errors hold besides the scatter of groups of rays.

    Attributes
    ----------
    irradiance : float, shape (2, depths, wavelengths)
        Of irradiances.
    absorptance : float, shape (intervals, wavelengths)
        Of absorptances.
    irreducible : list of float
        The part of both that more rays do not lower: of interpolation, and of a cut.
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
    """Return what the errors of irradiances and absorptances hold besides scatter.

    Parameters
    ----------
    estimates, perturbed_estimates : sequence of float
        Light and what is absorbed, see `splits.instruments.flux_estimate.FluxEstimate`; the same if what lies
        below a cut kept more, None where there is no cut.
    interpolation_bound : float, shape (wavelengths,)
        Bound on what interpolation misses, see `splits.simulation.spectral_nodes.IndexNodes`.
    single_ray_error : float, shape (wavelengths,)
        What one ray more would add to a mean.
    """
    unseen = bound_unsampled_light(estimates[0][:, DOWNWARD], single_ray_error)
    below = unseen[1 : estimates[1].shape[1] + 1]
    lasting = [
        bound_flux_interpolation_error(interpolation_bound, groups.mean(axis=0))
        for groups in estimates
    ]
    if perturbed_estimates is not None:
        lasting = [
            np.hypot(one, (groups - other).mean(axis=0))
            for one, groups, other in zip(lasting, estimates, perturbed_estimates, strict=True)
        ]
    rare = [
        estimate_rare_event_error(*each)
        for each in zip(estimates, (unseen[:-1], below), strict=True)
    ]
    light, absorbed = (np.hypot(one, more) for one, more in zip(lasting, rare, strict=True))
    return SystematicError(light, absorbed, lasting, interpolation_bound, below)


def estimate_rare_event_error(batch_means: np.ndarray, unsampled_light: np.ndarray) -> np.ndarray:
    """Return what errors hold of means that few groups decide.

    Nothing seen is not certainty: what fewer than `MIN_NONZERO_BATCHES` groups have seen may be off by one ray.
    Where as few hold most of it, one more like the largest is allowed for.

    Parameters
    ----------
    batch_means : float, shape (GROUPS, ..., wavelengths)
    unsampled_light : float, shape (..., wavelengths)
        What rays that were not seen may add, see `bound_unsampled_light`.
    """
    total, square = np.abs(batch_means).sum(axis=0), (batch_means**2).sum(axis=0)
    largest = np.abs(batch_means).max(axis=0) / len(batch_means)
    more = np.where(total**2 < MIN_NONZERO_BATCHES * square, largest, 0.0)
    found: np.ndarray = np.hypot(np.where(is_sparse(batch_means), unsampled_light, 0.0), more)
    return found


def is_sparse(batch_means: np.ndarray) -> np.ndarray:
    """Tell where only few groups have seen anything."""
    seen: np.ndarray = (batch_means != 0.0).sum(axis=0) < MIN_NONZERO_BATCHES
    return seen


def bound_unsampled_light(
    downward_irradiance: np.ndarray, single_ray_error: np.ndarray
) -> np.ndarray:
    """Return the most that rays which few groups have seen may add at each depth and below it.

    One ray more, and never much more than the light that reaches the plane above: what is
    absorbed on the way to it is absorbed of rays that were not seen, too.

    Parameters
    ----------
    downward_irradiance : float, shape (GROUPS, depths, wavelengths)
        Irradiance downwards.
    single_ray_error : float, shape (wavelengths,)

    Returns
    -------
    float, shape (depths + 1, wavelengths)
        The last below the last depth.
    """
    few = is_sparse(downward_irradiance)
    reaching = downward_irradiance.mean(axis=0)
    unseen, ceiling = [single_ray_error], single_ray_error
    for rare, mean in zip(few, reaching, strict=True):
        ceiling = mean + np.where(rare, np.minimum(ceiling, single_ray_error), 0.0)
        unseen.append(np.minimum(single_ray_error, MAX_BRIGHTENING * ceiling))
    return np.stack(unseen)


class AbsorptionSteps(NamedTuple):
    """In what steps weights fall inside a medium, each of shape (intervals, wavelengths).

    Attributes
    ----------
    optical_depth : float
        Largest optical depth of a mean step: through a grain, or through a pore from one grain to
        the next.
    unscored_path_m : float
        Mean leg before a ray's first step (m), times the part of its light that stays there.
    absorption_rate : float
        Light that steps keep, as a part of it and per metre of path.
    """

    optical_depth: np.ndarray
    unscored_path_m: np.ndarray
    absorption_rate: np.ndarray


def compute_absorption_steps(
    medium: GranularMedium | LayeredMedium, absorption: np.ndarray, planes_m: np.ndarray
) -> AbsorptionSteps:
    """Return the steps in which weights fall inside a medium.

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
    absorption : float, shape (wavelengths, columns)
        1/m; see `splits.simulation.scene.OpticalConstants`.
    planes_m : float, shape (intervals + 1,)
        Depths between which intervals lie (m).
    """
    first, top = 0, 0.0
    found: list[list[AbsorptionSteps]] = [[] for _ in planes_m[1:]]
    for part in medium.scene_layers if isinstance(medium, LayeredMedium) else (medium,):
        last, bottom = first + len(part.list_materials()), top + float(part.depth_m)
        here = _compute_layer_steps(part, absorption[:, first:last])
        for inside, begin, end in zip(found, planes_m[:-1], planes_m[1:], strict=True):
            if begin < bottom and end > top:
                inside.append(here)
        first, top = last, bottom
    return AbsorptionSteps(
        np.array([np.max([s.optical_depth for s in inside], axis=0) for inside in found]),
        np.array([np.max([s.unscored_path_m for s in inside], axis=0) for inside in found]),
        np.array([np.min([s.absorption_rate for s in inside], axis=0) for inside in found]),
    )


def _compute_layer_steps(
    medium: GranularMedium | StackedParticleLayer, absorption: np.ndarray
) -> AbsorptionSteps:
    """Return the steps in a layer, one value per wavelength; where particles absorb along paths, 0.

    The mean chord of convex grains is their volume over their projected area; the mean leg between
    two of them is that of a ray in the pore space.  Of a coating a ray crosses some three
    thicknesses on its way in and out; of a sphere the chord is two thirds of the diameter.
    """
    if isinstance(medium, StackedParticleLayer):
        none = np.zeros(len(absorption))
        return AbsorptionSteps(none, none, absorption[:, WET_PORE])
    grains, types = medium.make_grain_population(), medium.make_grain_population().types
    leg = 1.0 / grains.attenuation
    pore = leg * compute_pore_fraction(medium)
    packed = (
        getattr(medium.interpretation, "attenuation_factor", "solid_fraction") == "solid_fraction"
    )
    chord = medium.mean_grain_distance_m * (1.0 - medium.porosity if packed else 1.0)
    shares = np.diff(grains.type_cdf, prepend=0.0)
    depths, of_all = [], []
    for kind in np.flatnonzero(shares > 0.0):
        coats = types.n_shells[kind] - 1
        film = absorption[:, types.material[kind, :coats]] @ types.coating_thickness[kind, :coats]
        core = absorption[:, types.material[kind, coats]]
        depths.append(chord * (core + 4.5 * film))
        of_all.append(shares[kind])
    filled = [1.0 - medium.wet_fraction - sum(medium.pores.values()), medium.wet_fraction]
    for pore, share in enumerate([*filled, *medium.pores.values()]):
        if share > 0.0:
            depths.append(leg * absorption[:, pore])
            of_all.append(share)
    kept = np.array(of_all) @ -np.expm1(-np.array(depths))
    return AbsorptionSteps(np.max(depths, axis=0), pore * np.minimum(kept, 1.0), kept / pore)


def _compute_path_excess(optical_depth: np.ndarray) -> np.ndarray:
    """Return by which part of itself a path may be longer than if weights fell evenly along it."""
    d = np.maximum(optical_depth, 1e-9)
    more: np.ndarray = d / -np.expm1(-d) - 1.0
    return more


def bound_actinic_flux_error(
    steps: AbsorptionSteps, actinic_flux: np.ndarray, absorption: np.ndarray, incident: np.ndarray
) -> np.ndarray:
    """Return what the mean path over thickness may miss, shape (intervals, wavelengths).

    Between two planes weights are taken to fall evenly along the path.  They fall in steps, of
    optical depth d, so that a path by weight may be d/(1 − exp(−d)) times as long.  Where steps are
    so large that a ray ends in its first one, nobody hears of the leg that it came.  Where that is
    much, what is absorbed in the interval, which is known without paths, says about how long they
    are: twice the difference, and a tenth, are then less.

    Parameters
    ----------
    steps : AbsorptionSteps
    actinic_flux : float, shape (intervals, wavelengths)
    absorption, incident : float, shape (intervals, wavelengths)
        Light absorbed in an interval, and light that comes to it through its planes, over its
        thickness (1/m).
    """
    most = (
        _compute_path_excess(steps.optical_depth) * actinic_flux + steps.unscored_path_m * incident
    )
    kept = np.maximum(absorption, 0.0)
    path = np.divide(
        kept,
        steps.absorption_rate,
        out=np.full_like(actinic_flux, np.inf),
        where=steps.absorption_rate > 0.0,
    )
    missed: np.ndarray = np.minimum(most, 2.0 * np.abs(path - actinic_flux) + 0.1 * actinic_flux)
    return missed


def bound_material_absorptance_error(
    steps: AbsorptionSteps,
    absorptance: np.ndarray,
    total_absorptance: np.ndarray,
    unscored_absorptance: np.ndarray,
) -> np.ndarray:
    """Return how far a material's absorbed share of an interval's may be off.

    By what steps do to a path (see `bound_actinic_flux_error`), and never by more than there is; what one
    material has too much of, the others have too little.

    Parameters
    ----------
    steps : AbsorptionSteps
    absorptance : float, shape (intervals, materials, wavelengths)
        What the material absorbs.
    total_absorptance, unscored_absorptance : float, shape (intervals, wavelengths)
        What all of them absorb, and how much of that no path tells of.
    """
    total_absorptance, unscored_absorptance = (
        total_absorptance[:, np.newaxis],
        unscored_absorptance[:, np.newaxis],
    )
    moved = np.minimum(absorptance, np.maximum(total_absorptance - absorptance, 0.0))
    off = _compute_path_excess(steps.optical_depth)[:, np.newaxis] * moved + unscored_absorptance
    missed: np.ndarray = np.minimum(off, np.maximum(total_absorptance, 0.0))
    return missed


def compute_nonstatistical_error(
    batch_means: np.ndarray, interpolation_bound: np.ndarray, unsampled_light: np.ndarray
) -> np.ndarray:
    """Return what standard errors of means of groups hold besides their scatter.

    Parameters
    ----------
    batch_means : float, shape (GROUPS, ..., wavelengths)
    interpolation_bound : float, shape (wavelengths,)
        See `bound_flux_interpolation_error`.
    unsampled_light : float, shape (..., wavelengths)
        See `estimate_rare_event_error`.
    """
    found: np.ndarray = np.hypot(
        bound_flux_interpolation_error(interpolation_bound, batch_means.mean(axis=0)),
        estimate_rare_event_error(batch_means, unsampled_light),
    )
    return found


def bound_flux_interpolation_error(
    interpolation_bound: np.ndarray, value: np.ndarray
) -> np.ndarray:
    """Return what interpolation between refractive indices may miss of irradiances and the like.

    As of a reflectance (`splits.simulation.spectral_nodes`), with the elasticity |ln f| of what decays
    exponentially with depth, where that is more.

    Parameters
    ----------
    interpolation_bound : float, shape (wavelengths,)
    value : float, shape (..., wavelengths)
        What may be missed of.
    """
    size = np.clip(np.abs(value), np.finfo(float).tiny, None)
    elastic = size * np.maximum(8.0, np.abs(np.log(size)) / MAX_LOG_SLOPE)
    bound: np.ndarray = interpolation_bound * np.minimum(np.maximum(1.0, size), elastic)
    return bound


def compute_single_ray_error(tallies: Sequence[FluxPathTally], weights: np.ndarray) -> np.ndarray:
    """Return what one ray more would add to the mean at every wavelength, shape (wavelengths,)."""
    counts = np.stack([np.maximum(one.n_rays, 1.0) for one in tallies])
    added: np.ndarray = (weights / counts).max(axis=0)
    return added
