"""BRDF and BTDF of snowpacks: number of streams, and errors.

Errors are

- truncation: the difference from twice as many streams, by direction;
- the table of the grains, for light scattered several times: the error of the reflectance or of the
  transmittance;
- the phase function of light scattered once: the noise of the highest orders of the table, which
  is s/√(2l + 1) for every order l as the number of paths is limited; and the change if the last of
  these orders are left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.direct_light import DirectLight, scatter_once, trace_direct_light
from splits.discrete_ordinates.geometry import Geometry, PlaneLayers
from splits.discrete_ordinates.radiance import compute_bidirectional
from splits.discrete_ordinates.slab import LayerOptics
from splits.discrete_ordinates.snow_layers import MIN_SATURATION
from splits.discrete_ordinates.snowpack import (
    STREAM_NUMBERS,
    Snowpack,
    SpectrumSolution,
    choose_trial_wavelengths,
    load_natural_grains,
    solve_spectrum,
    spread_truncation,
)
from splits.discrete_ordinates.streams import Streams

MAX_BRDF_STREAMS = 32
"""Largest number of streams of a BRDF: the number of moments of the table without the last."""
MODE_TOLERANCE = 1e-9
"""Fraction of the BRDF and of the BTDF below which azimuthal modes are left out."""
N_TAIL_ORDERS = 8
"""Number of the highest orders, which give the error of the phase function."""
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
    snowpack: Snowpack, geometry: Geometry, relative_error: float, limited: np.ndarray, side: int
) -> BidirectionalSolution:
    """Return the BRDF and the BTDF of a snowpack by as many streams as a relative error requires.

    Parameters
    ----------
    snowpack : Snowpack
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
    truncation = values * np.moveaxis(by_direction, -1, 1)
    largest = np.stack([getattr(spectrum.budget, name).max(axis=-1) for name in SIDE_NAMES])
    by_table = spectrum.optics_error / np.where(largest > 0.0, largest, np.inf)
    multiple = values * np.minimum(by_table, 1.0)[..., np.newaxis, np.newaxis]
    once = _compute_single_scattering_error(snowpack, geometry, n_streams)
    errors = truncation, np.hypot(multiple, once)
    return BidirectionalSolution(values, *errors, n_streams, spectrum, direct)


def solve_relative_spectrum(
    snowpack: Snowpack, cosines: np.ndarray, relative_error: float, side: int
) -> SpectrumSolution:
    """Return the budget of light to a relative error of one side, see `solve_spectrum`."""
    trial = choose_trial_wavelengths(snowpack.ground.size)
    budget = snowpack.select(trial).solve(cosines, STREAM_NUMBERS[0])
    smallest = float(getattr(budget, SIDE_NAMES[side]).min())
    return solve_spectrum(snowpack, cosines, relative_error * smallest)


def _solve(snowpack: Snowpack, geometry: Geometry, n_streams: int) -> np.ndarray:
    """Return the BRDF and the BTDF of one beam, shape (2, wavelengths, views, azimuths)."""
    streams = Streams.from_number(n_streams)
    values = [
        compute_bidirectional(
            _stack_layers(part, _count_orders(part)), streams, geometry, tolerance=MODE_TOLERANCE
        )[..., 0, :, :]
        for part in _divide_wavelengths(snowpack, geometry)
    ]
    return np.concatenate(values, axis=1)


def _divide_wavelengths(snowpack: Snowpack, geometry: Geometry) -> list[Snowpack]:
    """Return the snowpack at parts of its wavelengths, which fit into memory."""
    n_values = len(snowpack.layers) * geometry.views.size * geometry.azimuths.size
    size = max(1, MAX_CHUNK_VALUES // n_values)
    wavelengths = np.arange(snowpack.ground.size)
    return [
        snowpack.select(wavelengths[first : first + size])
        for first in range(0, wavelengths.size, size)
    ]


def _compute_single_scattering_error(
    snowpack: Snowpack, geometry: Geometry, n_streams: int
) -> np.ndarray:
    """Return the error of light scattered once, shape (2, wavelengths, views, azimuths)."""
    errors = []
    for part in _divide_wavelengths(snowpack, geometry):
        layers = _stack_layers(part, _count_orders(part))
        scattering = layers.optics.scattering

        def evaluate(
            a: int, b: int, cosines: np.ndarray, scattering: np.ndarray = scattering
        ) -> np.ndarray:
            return compute_phase_error(scattering[..., a, b, :], cosines, has_peak=a == b)

        errors.append(scatter_once(layers.truncate(n_streams), geometry, evaluate)[..., 0, :, :])
    return np.concatenate(errors, axis=1)


def compute_phase_error(moments: np.ndarray, cosines: np.ndarray, has_peak: bool) -> np.ndarray:
    """Return the error of ∑ (2l + 1) χ_l P_l of moments from limited paths and of limited order.

    Parameters
    ----------
    moments : float, shape (layers, ..., orders)
    cosines : float, shape (..., beams, views, azimuths)
    has_peak : bool
        Whether the moment after the last one is a forward peak, which is left out.
    """
    n_orders, tail = moments.shape[-1], slice(-N_TAIL_ORDERS, None)
    factors = 2.0 * np.arange(n_orders) + 1.0
    # Second differences leave the noise of a smooth series; its variance is 6 times as large.
    curvature = np.diff(moments[..., tail], 2)
    noise = (factors[tail][1:-1] * curvature**2).mean(axis=-1) / 6.0
    coefficients = np.moveaxis(moments, -1, 0)[..., np.newaxis, np.newaxis, np.newaxis]
    before, here = np.zeros_like(cosines), np.ones_like(cosines)
    series, peak, power = (np.zeros_like(cosines) for _ in range(3))
    shorter = []
    for order, factor in enumerate(factors):
        if order >= n_orders - N_TAIL_ORDERS:
            shorter.append(series - has_peak * coefficients[order] * peak)
        series = series + factor * coefficients[order] * here
        peak, power = peak + factor * here, power + factor * here**2
        before, here = here, (factor * cosines * here - order * before) / (order + 1.0)
    remainder = np.mean([(series - one) ** 2 for one in shorter], axis=0)
    error: np.ndarray = np.sqrt(noise[..., np.newaxis, np.newaxis, np.newaxis] * power + remainder)
    return error


def _count_orders(snowpack: Snowpack) -> int:
    return load_natural_grains(wet=snowpack.is_wet).moments.shape[-1]


def _stack_layers(snowpack: Snowpack, orders: int) -> PlaneLayers:
    """Return the layers with a number of moments.

    Beyond the table the series of light that stays in wet pores, which the grains hardly refract,
    continues as a forward peak, which counts as unscattered.
    """
    table = load_natural_grains(wet=snowpack.is_wet)
    layers = [layer.compute_optics(table, orders) for layer in snowpack.layers]
    optics = LayerOptics(*(np.stack(values) for values in zip(*layers, strict=True)))
    optics = optics.truncate(orders - 1) if orders > 1 else optics
    if not snowpack.is_wet:
        return PlaneLayers(optics, snowpack.ground)
    saturations = [max(float(layer.saturation), MIN_SATURATION) for layer in snowpack.layers]
    return PlaneLayers(optics, snowpack.ground, saturations, snowpack.layers[0].water_index)
