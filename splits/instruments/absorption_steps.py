"""Errors of path lengths inside a medium, where weights decrease in steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.base.scene import MATRIX
from splits.media.medium import Layer, Medium

MAX_RATE_ERROR = 0.1
"""Relative error of the absorption per path, which is computed from mean chords."""


class AbsorptionSteps(NamedTuple):
    """Steps in which weights decrease inside a medium, each of shape (intervals, wavelengths).

    Attributes
    ----------
    optical_depth : float
        Largest optical depth of a mean step: through a grain, or through a pore from one grain to
        the next.
    unscored_path_m : float
        Mean segment before a ray's first step (m), times the fraction of its light absorbed there.
    absorption_rate, max_absorption_rate : float
        Smallest and largest fraction of the light absorbed in steps, per metre of path, in the
        layers of an interval.
    """

    optical_depth: np.ndarray
    unscored_path_m: np.ndarray
    absorption_rate: np.ndarray
    max_absorption_rate: np.ndarray


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
    layers = medium.scene_layers
    columns = np.cumsum([len(layer.list_materials()) for layer in layers])
    by_layer = zip(layers, np.split(absorption, columns, axis=1), strict=False)
    steps = np.stack([_compute_layer_steps(*one) for one in by_layer], axis=1)
    bottoms = np.cumsum([float(layer.depth_m) for layer in layers])
    begin, end = planes_m[:-1, np.newaxis], planes_m[1:, np.newaxis]
    in_interval = (begin < bottoms) & (end > np.append(0.0, bottoms[:-1]))
    return AbsorptionSteps(
        *(
            np.array([reduce(table[inside], axis=0) for inside in in_interval])
            for table, reduce in zip(steps, (np.max, np.max, np.min, np.max), strict=True)
        )
    )


def _compute_layer_steps(medium: Layer, absorption: np.ndarray) -> AbsorptionSteps:
    """Return the steps in a layer by wavelength; 0 where particles absorb along paths.

    The mean segment between two grains is that of a ray in the pore space.  A ray crosses some
    three thicknesses of a coating on its way in and out; the chord of a sphere is two thirds of the
    diameter.
    """
    if not medium.has_grains:
        zeros = np.zeros(len(absorption))
        return AbsorptionSteps(zeros, zeros, absorption[:, MATRIX], absorption[:, MATRIX])
    grains = medium.make_grain_population()
    segment, types = 1.0 / grains.collision_coefficient, grains.types
    pore_path = segment * medium.pore_fraction
    type_fractions = np.diff(grains.type_cdf, prepend=0.0)
    depths, fractions = [], []
    for grain_type in np.flatnonzero(type_fractions > 0.0):
        n_coatings = types.n_shells[grain_type] - 1
        materials, thicknesses = types.material[grain_type], types.coating_thickness[grain_type]
        coating = absorption[:, materials[:n_coatings]] @ thicknesses[:n_coatings]
        core = absorption[:, materials[n_coatings]]
        depths.append(medium.mean_chord_m * (core + 4.5 * coating))
        fractions.append(type_fractions[grain_type])
    dry_fraction = 1.0 - medium.wet_fraction - sum(medium.pores.values())
    for pore, fraction in enumerate([dry_fraction, medium.wet_fraction, *medium.pores.values()]):
        if fraction > 0.0:
            depths.append(segment * absorption[:, pore])
            fractions.append(fraction)
    absorbed = np.array(fractions) @ -np.expm1(-np.array(depths))
    rate = absorbed / pore_path
    return AbsorptionSteps(
        np.max(depths, axis=0), pore_path * np.minimum(absorbed, 1.0), rate, rate
    )


def _compute_path_excess(optical_depth: np.ndarray) -> np.ndarray:
    """Return the relative excess of a path over one along which weights decrease evenly."""
    d = np.maximum(optical_depth, 1e-9)
    return d / -np.expm1(-d) - 1.0


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
    excess = _compute_path_excess(steps.optical_depth)
    step_bound = excess * actinic_flux + steps.unscored_path_m * incident
    path, rate = np.full_like(actinic_flux, np.inf), steps.absorption_rate
    np.divide(np.maximum(absorption, 0.0), rate, out=path, where=rate > 0.0)
    return np.minimum(step_bound, 2.0 * np.abs(path - actinic_flux) + 0.1 * actinic_flux)


def estimate_rare_path_error(
    steps: AbsorptionSteps, actinic_flux: np.ndarray, absorption: np.ndarray
) -> np.ndarray:
    """Return the error of the actinic flux by paths that a run does not contain.

    A segment counts with the weight at its end, which Russian roulette raised if the ray survived
    much absorption.  Few such segments make much of the actinic flux of an interval that absorbs
    most of the light, and a run may contain none.  The absorptance of an interval does not depend
    on them.  The error is the deviation from the range of paths that follows from it, within
    `MAX_RATE_ERROR`.

    Parameters
    ----------
    steps : AbsorptionSteps
    actinic_flux : float, shape (intervals, wavelengths)
    absorption : float, shape (intervals, wavelengths)
        Light absorbed in an interval over its thickness (1/m).

    Returns
    -------
    float, shape (intervals, wavelengths)
        0 where nothing absorbs.
    """
    shortest, longest = actinic_flux.copy(), actinic_flux.copy()
    absorbed, rates = (
        np.maximum(absorption, 0.0),
        (steps.max_absorption_rate, steps.absorption_rate),
    )
    for path, rate in zip((shortest, longest), rates, strict=True):
        np.divide(absorbed, rate, out=path, where=rate > 0.0)
    shortest, longest = (1.0 - MAX_RATE_ERROR) * shortest, (1.0 + MAX_RATE_ERROR) * longest
    return np.asarray(np.maximum(shortest - actinic_flux, actinic_flux - longest).clip(0.0))


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
    total = np.maximum(total_absorptance, 0.0)[:, np.newaxis]
    exchangeable = np.minimum(
        absorptance, np.maximum(total_absorptance[:, np.newaxis] - absorptance, 0.0)
    )
    excess = _compute_path_excess(steps.optical_depth)[:, np.newaxis] * exchangeable
    return np.minimum(excess + unscored_absorptance[:, np.newaxis], total)
