"""Bidirectional reflectance of dry layers: number of streams, and errors.

Errors are

- truncation: the difference from twice as many streams, by direction;
- the table of the grains, for light scattered several times: the error of the reflectance;
- the phase function of light scattered once.  The scattered power of the highest orders of the
  table, which is noise of its paths or what remains of the series, holds for every order l, of
  which the moments of a limited number of paths have errors s/√(2l + 1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.plane_pack import (
    STREAM_NUMBERS,
    PlanePack,
    SpectrumSolution,
    choose_trial_wavelengths,
    solve_spectrum,
    spread_truncation,
)
from splits.discrete_ordinates.radiance import (
    Geometry,
    compute_brdf,
    scatter_once,
    truncate_known_moments,
)
from splits.discrete_ordinates.slab import LayerOptics
from splits.discrete_ordinates.streams import Streams, compute_legendre

MAX_BRDF_STREAMS = 32
"""Largest number of streams of a BRDF: the number of moments of the table minus 1."""
MODE_TOLERANCE = 1e-9
"""Fraction of the BRDF below which azimuthal modes are left out."""
N_TAIL_ORDERS = 8
"""Number of the highest orders, which give the error of the phase function."""
MIN_REFERENCE_FRACTION = 0.05
"""Fraction of a Lambertian BRDF below which the truncation error is relative to that fraction."""
MAX_CHUNK_VALUES = 4_000_000
"""Largest number of layers, wavelengths and directions at once."""


class BrdfSolution(NamedTuple):
    """BRDF with its errors.

    Attributes
    ----------
    brdf, truncation, optics_error : float, shape (wavelengths, views, azimuths)
        1/sr; errors due to the number of streams, and due to the table of the grains.
    n_streams : int
    spectrum : SpectrumSolution
        Hemispherical values.
    """

    brdf: np.ndarray
    truncation: np.ndarray
    optics_error: np.ndarray
    n_streams: int
    spectrum: SpectrumSolution

    @property
    def error(self) -> np.ndarray:
        """Error of the BRDF, shape (wavelengths, views, azimuths)."""
        error: np.ndarray = np.hypot(self.truncation, self.optics_error)
        return error


def solve_brdf(
    snowpack: PlanePack, geometry: Geometry, relative_error: float, limited: np.ndarray
) -> BrdfSolution:
    """Return the BRDF of a dry snowpack by as many streams as a relative error requires.

    Parameters
    ----------
    snowpack : PlanePack
    geometry : Geometry
        Of one beam.
    relative_error : float
        The number of streams is the first whose truncation error is at most half of this.
    limited : bool, shape (views,)
        Views to which the error applies.
    """
    spectrum = solve_relative_spectrum(snowpack, geometry.beams, relative_error)
    n_wavelengths = snowpack.ground.size
    trial = choose_trial_wavelengths(n_wavelengths)
    few = snowpack.select(trial)
    lambertian = spectrum.budget.reflectance[trial, 0, np.newaxis, np.newaxis] / np.pi
    numbers = [number for number in STREAM_NUMBERS if number <= MAX_BRDF_STREAMS]
    for n_streams in numbers:
        coarse, fine = (_solve(few, geometry, number) for number in (n_streams, 2 * n_streams))
        reference = np.maximum(fine, MIN_REFERENCE_FRACTION * lambertian)
        relative = np.abs(coarse - fine) / np.where(reference > 0.0, reference, 1.0)
        if relative[:, limited].max(initial=0.0) <= 0.5 * relative_error:
            break
    brdf = _solve(snowpack, geometry, n_streams)
    by_direction = spread_truncation(np.moveaxis(relative, 0, -1), trial, n_wavelengths)
    truncation = brdf * np.moveaxis(by_direction, -1, 0)
    reflectance = spectrum.budget.reflectance.max(axis=-1)
    by_table = spectrum.optics_error / np.where(reflectance > 0.0, reflectance, np.inf)
    multiple = brdf * np.minimum(by_table, 1.0)[:, np.newaxis, np.newaxis]
    once = _compute_single_scattering_error(snowpack, geometry, n_streams)
    return BrdfSolution(brdf, truncation, np.hypot(multiple, once), n_streams, spectrum)


def solve_relative_spectrum(
    snowpack: PlanePack, cosines: np.ndarray, relative_error: float
) -> SpectrumSolution:
    """Return the budget of light to a relative error of the reflectances, see `solve_spectrum`."""
    trial = choose_trial_wavelengths(snowpack.ground.size)
    reflectance = snowpack.select(trial).solve(cosines, STREAM_NUMBERS[0]).reflectance
    return solve_spectrum(snowpack, cosines, relative_error * float(reflectance.min()))


def compute_direct_transmittance(snowpack: PlanePack, cosines: np.ndarray) -> np.ndarray:
    """Return the transmittance of light that is not scattered, shape (wavelengths, beams)."""
    optics = _stack_optics(snowpack, 1)
    depth = (optics.thickness * optics.extinction[..., 0]).sum(axis=0)
    transmittance: np.ndarray = np.exp(-depth[:, np.newaxis] / cosines)
    return transmittance


def _solve(snowpack: PlanePack, geometry: Geometry, n_streams: int) -> np.ndarray:
    """Return the BRDF of one beam, shape (wavelengths, views, azimuths)."""
    n_values = len(snowpack.layers) * geometry.views.size * geometry.azimuths.size
    size = max(1, MAX_CHUNK_VALUES // n_values)
    wavelengths = np.arange(snowpack.ground.size)
    streams, orders = Streams.from_number(n_streams), _count_orders(snowpack)
    chunks = [wavelengths[first : first + size] for first in range(0, wavelengths.size, size)]
    brdf = [
        compute_brdf(
            _stack_optics(part, orders), part.ground, streams, geometry, tolerance=MODE_TOLERANCE
        )[:, 0]
        for part in map(snowpack.select, chunks)
    ]
    return np.concatenate(brdf)


def _compute_single_scattering_error(
    snowpack: PlanePack, geometry: Geometry, n_streams: int
) -> np.ndarray:
    """Return the error of light scattered once, shape (wavelengths, views, azimuths)."""
    optics = _stack_optics(snowpack, _count_orders(snowpack))
    orders = np.arange(_count_orders(snowpack))
    tail = slice(-N_TAIL_ORDERS, None)
    power = (2.0 * orders[tail] + 1.0) * optics.scattering[..., 0, 0, tail] ** 2
    scale = np.sqrt(power.mean(axis=-1))
    cosines = geometry.compute_scattering_cosines()
    functions = compute_legendre(cosines.ravel(), 0, orders.size).reshape(-1, *cosines.shape)
    spread = np.sqrt(np.tensordot(2.0 * orders + 1.0, functions**2, 1))
    error = scale[..., np.newaxis, np.newaxis, np.newaxis] * spread
    return scatter_once(truncate_known_moments(optics, n_streams), error, geometry)[:, 0]


def _count_orders(snowpack: PlanePack) -> int:
    return max(layer.grains.n_orders for layer in snowpack.layers)


def _stack_optics(snowpack: PlanePack, orders: int) -> LayerOptics:
    """Return the optics of dry layers along the first dimension."""
    layers = [layer.compute_optics(orders) for layer in snowpack.layers]
    return LayerOptics(*(np.stack(values) for values in zip(*layers, strict=True)))
