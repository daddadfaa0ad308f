"""Errors of path lengths inside a medium, where weights decrease in steps."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from splits.kernels.base.scene import WET_PORE
from splits.media.medium import Medium


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
    medium: Medium, absorption: np.ndarray, planes_m: np.ndarray
) -> AbsorptionSteps:
    """Return the steps in which weights decrease inside a medium.

    Parameters
    ----------
    medium : Medium
    absorption : float, shape (wavelengths, columns)
        1/m; see `splits.simulation.scene.OpticalConstants`.
    planes_m : float, shape (intervals + 1,)
        Depths between which intervals lie (m).
    """
    first, top = 0, 0.0
    by_interval: list[list[AbsorptionSteps]] = [[] for _ in planes_m[1:]]
    for layer in medium.scene_layers:
        last, bottom = first + len(layer.list_materials()), top + float(layer.depth_m)
        layer_steps = _compute_layer_steps(layer, absorption[:, first:last])
        for interval_steps, begin, end in zip(
            by_interval, planes_m[:-1], planes_m[1:], strict=True
        ):
            if begin < bottom and end > top:
                interval_steps.append(layer_steps)
        first, top = last, bottom
    return AbsorptionSteps(
        np.array([np.max([s.optical_depth for s in steps], axis=0) for steps in by_interval]),
        np.array([np.max([s.unscored_path_m for s in steps], axis=0) for steps in by_interval]),
        np.array([np.min([s.absorption_rate for s in steps], axis=0) for steps in by_interval]),
    )


def _compute_layer_steps(medium: Any, absorption: np.ndarray) -> AbsorptionSteps:
    """Return the steps in a layer by wavelength; 0 where particles absorb along paths.

    The mean chord of convex grains is their volume over their projected area; the mean segment
    between two of them is that of a ray in the pore space.  A ray crosses some three thicknesses of
    a coating on its way in and out; the chord of a sphere is two thirds of the diameter.
    """
    if not medium.has_grains:
        zeros = np.zeros(len(absorption))
        return AbsorptionSteps(zeros, zeros, absorption[:, WET_PORE])
    grains, types = medium.make_grain_population(), medium.make_grain_population().types
    segment = 1.0 / grains.collision_coefficient
    pore_path = segment * medium.pore_fraction
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
        np.max(depths, axis=0), pore_path * np.minimum(absorbed, 1.0), absorbed / pore_path
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
