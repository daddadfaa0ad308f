"""BRDF and BTDF of snowpacks: number of streams, and errors.

Errors are

- truncation: the difference from twice as many streams, by direction;
- the table of the grains, for light scattered several times: the error of the reflectance or of the
  transmittance;
- the phase function of light scattered once: the noise of the highest orders of the table, which
  is s/√(2l + 1) for every order l as the number of paths is limited; the change if the last of
  these orders are left out; and half of the forward peak beyond the table, for light in wet pores.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.direct_light import DirectLight, scatter_once, trace_direct_light
from splits.discrete_ordinates.geometry import Geometry, PlaneLayers
from splits.discrete_ordinates.granular_layers import MIN_WET_FRACTION
from splits.discrete_ordinates.granular_stack import (
    AIR,
    STREAM_NUMBERS,
    GranularStack,
    SpectrumSolution,
    choose_trial_wavelengths,
    spread_truncation,
)
from splits.discrete_ordinates.integrals import TINY
from splits.discrete_ordinates.layer_optics import LayerOptics
from splits.discrete_ordinates.pores import WET
from splits.discrete_ordinates.radiance import compute_bidirectional, sum_legendre
from splits.discrete_ordinates.streams import Streams
from splits.discrete_ordinates.transmittance_error import solve_with_exponent_error

MAX_BRDF_STREAMS = 32
"""Largest number of streams of a BRDF: the number of moments of the table minus 1."""
MODE_TOLERANCE = 1e-9
"""Fraction of the BRDF and of the BTDF below which azimuthal modes are left out."""
N_TAIL_ORDERS = 8
"""Number of the highest orders, which give the error of the phase function."""
N_PEAK_ORDERS, MAX_PEAK_RATIO = 160, 0.97
"""Number of the orders of the forward peak, and largest ratio of two successive moments."""
PEAK_ERROR = 0.5
"""Error of the extrapolated forward peak, relative to it."""
MIN_REFERENCE_FRACTION = 0.05
"""Fraction of a Lambertian distribution below which truncation is relative to that fraction."""
MAX_CHUNK_VALUES = 1_000_000
"""Largest number of layers, wavelengths and directions at once."""
SIDE_NAMES = ("reflectance", "transmittance")


class BidirectionalSolution(NamedTuple):
    """BRDF and BTDF of scattered light, with their errors.

    Attributes
    ----------
    values, truncation, optics_error : float, shape (2, wavelengths, views, azimuths)
        1/sr, reflected and transmitted; errors due to the number of streams, and due to the table
        of the grains.
    n_streams : int
    spectrum : SpectrumSolution
        Hemispherical values.
    direct : DirectLight
        Light of the beam that is not scattered.
    """

    values: np.ndarray
    truncation: np.ndarray
    optics_error: np.ndarray
    n_streams: int
    spectrum: SpectrumSolution
    direct: DirectLight

    @property
    def error(self) -> np.ndarray:
        """Errors, shape (2, wavelengths, views, azimuths)."""
        error: np.ndarray = np.hypot(self.truncation, self.optics_error)
        return error


def solve_bidirectional(
    snowpack: GranularStack,
    geometry: Geometry,
    relative_error: float,
    limited: np.ndarray,
    side: int,
) -> BidirectionalSolution:
    """Return the BRDF and the BTDF of a snowpack by as many streams as a relative error requires.

    Parameters
    ----------
    snowpack : GranularStack
    geometry : Geometry
        Of one beam.
    relative_error : float
        The number of streams is the first whose truncation error is at most half of this.
    limited : bool, shape (views,)
        Views to which the error applies.
    side : int
        Side to which the error applies, 0 reflected or 1 transmitted.
    """
    spectrum = solve_relative_spectrum(snowpack, geometry.beams, relative_error, side)
    direct = trace_direct_light(_stack_layers(snowpack, 1), geometry.beams)[0]
    totals = np.stack([getattr(spectrum.budget, name)[..., 0] for name in SIDE_NAMES])
    unscattered = np.stack([direct.reflected[..., 0], direct.transmitted[..., 0]])
    scattered = np.maximum(totals - unscattered, 0.0)
    n_wavelengths = snowpack.ground.size
    trial = choose_trial_wavelengths(n_wavelengths)
    few = snowpack.select(trial)
    lambertian = scattered[:, trial, np.newaxis, np.newaxis] / np.pi
    for n_streams in (number for number in STREAM_NUMBERS if number <= MAX_BRDF_STREAMS):
        coarse, fine = (_solve(few, geometry, number) for number in (n_streams, 2 * n_streams))
        reference = np.maximum(fine, MIN_REFERENCE_FRACTION * lambertian)
        relative = np.abs(coarse - fine) / np.where(reference > 0.0, reference, 1.0)
        if relative[side][:, limited].max(initial=0.0) <= 0.5 * relative_error:
            break
    values = _solve(snowpack, geometry, n_streams)
    by_direction = spread_truncation(np.moveaxis(relative, 1, -1), trial, n_wavelengths)
    floor = MIN_REFERENCE_FRACTION / np.pi * scattered[..., np.newaxis, np.newaxis]
    truncation = np.maximum(values, floor) * np.moveaxis(by_direction, -1, 1)
    errors = spectrum.bound_errors(totals)
    if snowpack.is_wet:
        # Distributions assume the equilibrium of air in all layers.
        in_air = snowpack._replace(equilibrium=AIR).solve(geometry.beams, spectrum.n_streams)
        change = np.stack([getattr(in_air, name)[..., 0] for name in SIDE_NAMES]) - totals
        errors = np.hypot(errors, change)
    by_total = np.minimum(errors / np.maximum(totals, TINY), 1.0)
    multiple = values * by_total[..., np.newaxis, np.newaxis]
    once = _compute_single_scattering_error(snowpack, geometry, n_streams)
    return BidirectionalSolution(
        values, truncation, np.hypot(multiple, once), n_streams, spectrum, direct
    )


def solve_relative_spectrum(
    snowpack: GranularStack, cosines: np.ndarray, relative_error: float, side: int
) -> SpectrumSolution:
    """Return the budget of light to a relative error of one side, see `solve_spectrum`."""
    trial = choose_trial_wavelengths(snowpack.ground.size)
    budget = snowpack.select(trial).solve(cosines, STREAM_NUMBERS[0])
    smallest = float(getattr(budget, SIDE_NAMES[side]).min())
    return solve_with_exponent_error(snowpack, cosines, relative_error * smallest)


def _solve(snowpack: GranularStack, geometry: Geometry, n_streams: int) -> np.ndarray:
    """Return the BRDF and the BTDF of one beam, shape (2, wavelengths, views, azimuths)."""
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

        both = compute_bidirectional(layers, streams, geometry, evaluate, MODE_TOLERANCE)
        values.append(both[..., 0, :, :])
    return np.concatenate(values, axis=1)


def _divide_wavelengths(snowpack: GranularStack, geometry: Geometry) -> list[GranularStack]:
    """Return the snowpack at parts of its wavelengths, which fit into memory."""
    n_values = len(snowpack.layers) * geometry.views.size * geometry.azimuths.size
    size = max(1, MAX_CHUNK_VALUES // n_values)
    wavelengths = np.arange(snowpack.ground.size)
    return [
        snowpack.select(wavelengths[first : first + size])
        for first in range(0, wavelengths.size, size)
    ]


def _compute_single_scattering_error(
    snowpack: GranularStack, geometry: Geometry, n_streams: int
) -> np.ndarray:
    """Return the error of light scattered once, shape (2, wavelengths, views, azimuths)."""
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

        errors.append(scatter_once(layers.truncate(n_streams), geometry, evaluate)[..., 0, :, :])
    return np.concatenate(errors, axis=1)


def estimate_phase_error(
    moments: np.ndarray, cosines: np.ndarray, has_peak: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return ∑ (2l + 1) χ_l P_l without a forward peak, and its error.

    Parameters
    ----------
    moments : float, shape (layers, ..., orders)
        From a limited number of paths.
    cosines : float, shape (..., beams, views, azimuths)
    has_peak : bool
        Whether the last moment is that of a forward peak, which is left out.
    """
    n_orders, tail = moments.shape[-1], slice(-N_TAIL_ORDERS, None)
    factors = 2.0 * np.arange(n_orders) + 1.0
    # Second differences leave the noise of a smooth series; its variance is 6 times as large.
    curvature = np.diff(moments[..., tail], 2)
    noise = (factors[tail][1:-1] * curvature**2).mean(axis=-1) / 6.0
    coefficients = np.moveaxis(moments, -1, 0)[..., np.newaxis, np.newaxis, np.newaxis]
    before, here = np.zeros_like(cosines), np.ones_like(cosines)
    series, peak, power = (np.zeros_like(cosines) for _ in range(3))
    truncated = []
    for order, factor in enumerate(factors):
        if order >= n_orders - N_TAIL_ORDERS:
            truncated.append(series - has_peak * coefficients[order] * peak)
        series = series + factor * coefficients[order] * here
        peak, power = peak + factor * here, power + factor * here**2
        before, here = here, (factor * cosines * here - order * before) / (order + 1.0)
    complete = truncated[-1]
    remainder = np.mean([(complete - one) ** 2 for one in truncated[:-1]], axis=0)
    error = np.sqrt(noise[..., np.newaxis, np.newaxis, np.newaxis] * power + remainder)
    return complete, error


def extend_forward_peak(scattering: np.ndarray) -> np.ndarray:
    """Return scattering (..., 2, 2, orders) with further orders of light that stays in wet pores.

    Grains hardly refract this light, so that its moments decrease slowly.  They continue as a
    geometric series with the mean decrease of the last known orders, and end at 0.
    """
    n_known = scattering.shape[-1]
    own = scattering[..., WET, WET, :]
    last, earlier = (np.maximum(own[..., order], TINY) for order in (-1, -1 - N_TAIL_ORDERS))
    ratio = np.minimum((last / earlier) ** (1.0 / N_TAIL_ORDERS), MAX_PEAK_RATIO)
    extended = np.zeros((*scattering.shape[:-1], N_PEAK_ORDERS))
    extended[..., :n_known] = scattering
    steps = np.arange(1, N_PEAK_ORDERS - n_known + 1)
    # A series that ends with a step oscillates in all directions.
    taper = np.cos(0.5 * np.pi * steps / steps[-1]) ** 2
    tail = last[..., np.newaxis] * ratio[..., np.newaxis] ** steps
    extended[..., WET, WET, n_known:] = tail * taper
    return extended


def _count_orders(snowpack: GranularStack) -> int:
    return max(layer.grains.n_orders for layer in snowpack.layers)


def _stack_layers(snowpack: GranularStack, orders: int) -> PlaneLayers:
    """Return the layers with a number of moments, and with the forward peak of wet layers."""
    layers = [layer.compute_optics(orders, in_air=True) for layer in snowpack.layers]
    optics = LayerOptics(*(np.stack(values) for values in zip(*layers, strict=True)))
    if not snowpack.is_wet:
        return PlaneLayers(optics, snowpack.ground)
    if orders > 1:
        optics = optics._replace(scattering=extend_forward_peak(optics.scattering))
    wet_fractions = [max(float(layer.wet_fraction), MIN_WET_FRACTION) for layer in snowpack.layers]
    return PlaneLayers(optics, snowpack.ground, wet_fractions, snowpack.layers[0].water_index)
