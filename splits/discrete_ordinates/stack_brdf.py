"""BRDF and BTDF of snowpacks: number of streams, and errors.

Errors are

- truncation: the difference from twice as many streams, by direction;
- the table of the grains, for light scattered several times: the error of the reflectance or of the
  transmittance; of the anisotropy factor, the change that comes with this error;
- the phase function of light scattered once: the noise of the highest orders of the table, which
  is s/√(2l + 1) for every order l as the number of paths is limited; the change if the last of
  these orders are left out; and half of the forward peak beyond the table, for light in wet pores.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import MIN_REFERENCE_FRACTION, ErrorTarget
from splits.discrete_ordinates.adding import WET, Budget
from splits.discrete_ordinates.granular_layers import (
    N_PEAK_ORDERS,
    estimate_phase_error,
)
from splits.discrete_ordinates.granular_stack import (
    AIR,
    STREAM_NUMBERS,
    GranularStack,
    SpectrumSolution,
    choose_trial_wavelengths,
    solve_with_exponent_error,
    spread_truncation,
)
from splits.discrete_ordinates.homogeneous_layer import TINY, Streams
from splits.discrete_ordinates.radiance import (
    DirectLight,
    Geometry,
    PlaneLayers,
    compute_bidirectional,
    scatter_once,
    sum_legendre,
    trace_direct_light,
)

MAX_BRDF_STREAMS = 32
"""Largest number of streams of a BRDF: the number of moments of the table minus 1."""
MODE_TOLERANCE = 1e-9
"""Fraction of the BRDF and of the BTDF below which azimuthal modes are left out."""
PEAK_ERROR = 0.5
"""Error of the extrapolated forward peak, relative to it."""
MAX_CHUNK_VALUES = 1_000_000
"""Largest number of layers, wavelengths and directions at once."""
ADDED_ABSORPTION = 1e-5
"""Absorption of dry pores, per collision with grains, from which follows how the anisotropy factor
changes with the reflectance."""
MAX_SENSITIVITY = 2.0
"""Largest relative change of the anisotropy factor, over that of the reflectance."""


class BidirectionalSolution(NamedTuple):
    """BRDF and BTDF of scattered light, with their errors.

    Attributes
    ----------
    values, error : float, shape (2, wavelengths, beams, views, azimuths)
        1/sr, reflected and transmitted; error due to the number of streams, and due to the table
        of the grains.
    anisotropy, anisotropy_error : float, shape (wavelengths, beams, views, azimuths)
        Anisotropy factor, with the reflectance of the same solution, and its error.
    n_streams : int
    spectrum : SpectrumSolution
        Hemispherical values.
    direct : DirectLight
        Light of the beams that is not scattered.
    """

    values: np.ndarray
    error: np.ndarray
    anisotropy: np.ndarray
    anisotropy_error: np.ndarray
    n_streams: int
    spectrum: SpectrumSolution
    direct: DirectLight


def solve_bidirectional(
    snowpack: GranularStack,
    geometry: Geometry,
    max_error: float,
    target: ErrorTarget,
) -> BidirectionalSolution:
    """Return the BRDF and the BTDF of a snowpack by as many streams as an error requires.

    Parameters
    ----------
    snowpack : GranularStack
    geometry : Geometry
    max_error : float
        The number of streams is the first whose truncation error is at most half of this.
    target : ErrorTarget
        What the error applies to; directions are the views, with the azimuth fastest.
    """
    spectrum = solve_relative_spectrum(snowpack, geometry.beams, max_error, target.side)
    direct = trace_direct_light(_stack_layers(snowpack, 1), geometry.beams)[0]
    totals = _stack_sides(spectrum.budget)
    unscattered = np.stack([direct.reflected, direct.transmitted])
    scattered = np.maximum(totals - unscattered, 0.0)
    n_streams, relative, of_factor = _choose_streams(
        snowpack, geometry, max_error, target, scattered
    )
    values = _solve(snowpack, geometry, n_streams)
    reference = _compute_relative_reference(values, scattered)
    by_total = _compute_relative_errors(snowpack, geometry, spectrum, totals)
    once = _compute_single_scattering_error(snowpack, geometry, n_streams)
    scale, sensitivity = _compute_anisotropy_scale(snowpack, geometry, n_streams, values[0])
    own = np.hypot(of_factor * reference[0], once[0])
    error = np.hypot(relative * reference, np.hypot(values * by_total, once))
    return BidirectionalSolution(
        values, error, scale * values[0],
        scale * np.hypot(own, sensitivity * values[0] * by_total[0]), n_streams, spectrum, direct,
    )  # fmt: skip


def _choose_streams(
    snowpack: GranularStack,
    geometry: Geometry,
    max_error: float,
    target: ErrorTarget,
    scattered: np.ndarray,
) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the number of streams, and the relative errors of truncation of all directions.

    They are those of the BRDF and the BTDF, and that of the anisotropy factor, which is the ratio
    of the BRDF to a reflectance with an error of its own.

    Parameters
    ----------
    snowpack : GranularStack
    geometry : Geometry
    max_error : float
    target : ErrorTarget
        See `solve_bidirectional`.
    scattered : float, shape (2, wavelengths, beams)
        Reflectance and transmittance of scattered light.
    """
    n_wavelengths, side = snowpack.ground.size, target.side
    trial = choose_trial_wavelengths(n_wavelengths)
    few, scattered = snowpack.select(trial), scattered[:, trial]
    for n_streams in (number for number in STREAM_NUMBERS if number <= MAX_BRDF_STREAMS):
        coarse, fine = (_solve(few, geometry, number) for number in (n_streams, 2 * n_streams))
        change = np.abs(coarse - fine)
        limited, values = (
            one[side].reshape(*scattered.shape[1:], -1)[..., target.direction_mask]
            for one in (change, fine)
        )
        allowed = 0.5 * max_error * target.compute_reference(values, scattered[side])
        if (limited <= allowed).all():
            break
    in_air = few._replace(equilibrium=AIR)
    less, more = (
        in_air.solve(geometry.beams, number).reflectance[:, :-1, np.newaxis, np.newaxis]
        for number in (n_streams, 2 * n_streams)
    )
    of_ratio = np.abs(coarse[0] - fine[0] * less / np.maximum(more, TINY))
    reference = _compute_relative_reference(coarse, scattered)[[0, 1, 0]]
    relative = np.stack([*change, of_ratio]) / np.where(reference > 0.0, reference, 1.0)
    by_wavelength = spread_truncation(np.moveaxis(relative, 1, -1), trial, n_wavelengths)
    errors = np.moveaxis(by_wavelength, -1, 1)
    return n_streams, errors[:2], errors[2]


def _compute_relative_reference(values: np.ndarray, scattered: np.ndarray) -> np.ndarray:
    """Return the reference of relative errors, in the shape of a BRDF and a BTDF."""
    isotropic = scattered[..., np.newaxis, np.newaxis] / np.pi
    return np.maximum(values, MIN_REFERENCE_FRACTION * isotropic)


def _stack_sides(budget: Budget) -> np.ndarray:
    """Return reflectance and transmittance of the beams, shape (2, wavelengths, beams)."""
    return np.stack([budget.reflectance, budget.transmittance])[..., :-1]


def _compute_relative_errors(
    snowpack: GranularStack, geometry: Geometry, spectrum: SpectrumSolution, totals: np.ndarray
) -> np.ndarray:
    """Return the relative errors of reflectance and transmittance, shape (2, ..., beams, 1, 1)."""
    errors = np.stack(
        [spectrum.bound_errors(totals[..., beam]) for beam in range(totals.shape[-1])], axis=-1
    )
    if snowpack.is_wet:
        # Distributions assume the equilibrium of air in all layers.
        in_air = snowpack._replace(equilibrium=AIR).solve(geometry.beams, spectrum.n_streams)
        errors = np.hypot(errors, _stack_sides(in_air) - totals)
    return (errors / np.maximum(totals, TINY))[..., np.newaxis, np.newaxis]


def _compute_anisotropy_scale(
    snowpack: GranularStack, geometry: Geometry, n_streams: int, brdf: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the ratio of the anisotropy factor to the BRDF, and its relative sensitivity.

    The reflectance is that of the same equation and number of streams as the BRDF.  Errors of
    single scattering change both as a little absorption does: the sensitivity is the relative
    change of the anisotropy factor over that of the reflectance.

    Parameters
    ----------
    snowpack : GranularStack
    geometry : Geometry
    n_streams : int
    brdf : float, shape (wavelengths, beams, views, azimuths)

    Returns
    -------
    float, shape (wavelengths, beams, 1, 1), and float, as the BRDF
    """
    in_air = snowpack._replace(equilibrium=AIR)
    darker = in_air._replace(layers=[
        layer._replace(
            pore_absorption=layer.pore_absorption + ADDED_ABSORPTION * layer.collisions_per_m
        )
        for layer in snowpack.layers
    ])  # fmt: skip
    reflectance, less = (
        one.solve(geometry.beams, n_streams).reflectance[..., :-1, np.newaxis, np.newaxis]
        for one in (in_air, darker)
    )
    change = less / np.maximum(reflectance, TINY) - 1.0
    brdf_change = _solve(darker, geometry, n_streams)[0] / np.maximum(brdf, TINY) - 1.0
    ratio = np.divide(brdf_change, change, out=np.ones_like(brdf), where=change < 0.0)
    scale = np.divide(np.pi, reflectance, out=np.zeros_like(reflectance), where=reflectance > 0.0)
    return scale, np.minimum(np.abs(ratio - 1.0), MAX_SENSITIVITY)


def solve_relative_spectrum(
    snowpack: GranularStack, cosines: np.ndarray, relative_error: float, side: int
) -> SpectrumSolution:
    """Return the budget of light to a relative error of one side, see `solve_spectrum`."""
    trial = choose_trial_wavelengths(snowpack.ground.size)
    budget = snowpack.select(trial).solve(cosines, STREAM_NUMBERS[0])
    smallest = float((budget.reflectance, budget.transmittance)[side].min())
    return solve_with_exponent_error(snowpack, cosines, relative_error * smallest)


def _solve(snowpack: GranularStack, geometry: Geometry, n_streams: int) -> np.ndarray:
    """Return the BRDF and the BTDF, shape (2, wavelengths, beams, views, azimuths)."""
    streams, n_known = Streams.from_number(n_streams), _count_orders(snowpack)
    values = []
    for part in _divide_wavelengths(snowpack, geometry):
        layers = _stack_layers(part, n_known)
        scattering = layers.optics.scattering

        def evaluate(
            a: int, b: int, cosines: np.ndarray, scattering: np.ndarray = scattering
        ) -> np.ndarray:
            n_orders = None if a == b == WET else n_known
            return sum_legendre(scattering[..., a, b, :n_orders], cosines)

        values.append(compute_bidirectional(layers, streams, geometry, evaluate, MODE_TOLERANCE))
    return np.concatenate(values, axis=1)


def _divide_wavelengths(snowpack: GranularStack, geometry: Geometry) -> list[GranularStack]:
    """Return the snowpack at parts of its wavelengths, which fit into memory."""
    n_directions = geometry.beams.size * geometry.views.size * geometry.azimuths.size
    size = max(1, MAX_CHUNK_VALUES // (len(snowpack.layers) * n_directions))
    wavelengths = np.arange(snowpack.ground.size)
    return [
        snowpack.select(wavelengths[first : first + size])
        for first in range(0, wavelengths.size, size)
    ]


def _compute_single_scattering_error(
    snowpack: GranularStack, geometry: Geometry, n_streams: int
) -> np.ndarray:
    """Return the error of light scattered once, shape (2, wavelengths, beams, views, azimuths)."""
    n_known = _count_orders(snowpack)
    errors = []
    for part in _divide_wavelengths(snowpack, geometry):
        layers = _stack_layers(part, n_known)
        scattering = layers.optics.scattering

        def evaluate(
            a: int, b: int, cosines: np.ndarray, scattering: np.ndarray = scattering
        ) -> np.ndarray:
            moments = scattering[..., a, b, :]
            known, error = estimate_phase_error(moments[..., :n_known], cosines, has_peak=a == b)
            if not a == b == WET:
                return error
            peak = sum_legendre(moments, cosines) - known
            return np.hypot(error, PEAK_ERROR * peak)

        errors.append(scatter_once(layers.truncate(n_streams), geometry, evaluate))
    return np.concatenate(errors, axis=1)


def _count_orders(snowpack: GranularStack) -> int:
    return max(layer.grains.n_orders for layer in snowpack.layers)


def _stack_layers(snowpack: GranularStack, orders: int) -> PlaneLayers:
    """Return the layers with a number of moments, and with the forward peak of wet layers."""
    if snowpack.is_wet and orders > 1:
        orders = N_PEAK_ORDERS
    optics = snowpack._replace(equilibrium=AIR).compute_optics(orders)
    return PlaneLayers(optics, snowpack.ground, snowpack.wet_fractions, snowpack.water_index)
