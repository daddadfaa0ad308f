"""Reflection and transmission of homogeneous layers, by the eigenvalues of discrete ordinates.

Radiances are scaled by √(w μ), with the weight w and the cosine μ of a stream, so that reflection
and transmission are symmetric matrices (reciprocity).  With the sum s and the difference d of the
downward and the upward radiances, the equation of transfer is

    ds/dt = −A d,    dd/dt = −B s,

with symmetric positive matrices A (moments of odd l + m) and B (of even l + m).  Light that is the
same at both faces (even), or opposite (odd), has d = Z s at the upper face, where

    Z = Y f(k) Yᵀ,    f = k tanh(k τ/2) or k coth(k τ/2),    (A B) X = X k²,  Yᵀ X = 1,

and R ± T = (1 − Z)(1 + Z)⁻¹.  No exponential grows, nothing cancels in T, and neither thin nor
thick nor conservative layers need a case of their own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.streams import Streams, compute_legendre

MIN_EIGENVALUE = 1e-150
"""Smallest k², which is 0 without absorption."""


class LayerOptics(NamedTuple):
    """Optics of homogeneous layers; leading dimensions are arbitrary, such as (wavelengths,).

    Attributes
    ----------
    thickness : float, shape (...)
        Optical thickness of extinction; infinite for a half-space.
    albedo : float, shape (...)
        Single-scattering albedo, 0 to 1.
    moments : float, shape (..., orders)
        Legendre moments of the phase function, from that of order 0, which is 1.
    """

    thickness: np.ndarray
    albedo: np.ndarray
    moments: np.ndarray

    def truncate(self, streams: int) -> LayerOptics:
        """Return the optics with as many moments as streams; the rest is a forward peak (delta-M).

        The fraction f = χ of the order `streams` of the scattered light counts as unscattered
        (Wiscombe 1977, Journal of the Atmospheric Sciences 34, 1408).
        """
        peak = np.clip(self.moments[..., streams], 0.0, 1.0 - 1e-12)
        scattered = 1.0 - self.albedo * peak
        # An infinite thickness stays infinite.
        moments = (self.moments[..., :streams] - peak[..., np.newaxis]) / (1.0 - peak)[
            ..., np.newaxis
        ]
        return LayerOptics(
            self.thickness * scattered, (1.0 - peak) * self.albedo / scattered, moments
        )


class Slab(NamedTuple):
    """Reflection and transmission of homogeneous layers for scaled radiances.

    Attributes
    ----------
    reflection, transmission : float, shape (..., streams, streams)
        Symmetric; between the streams.
    beam_reflection, beam_transmission : float, shape (..., directions, streams)
        Radiance in further directions for the radiance of the streams.
    direct : float, shape (..., directions)
        Transmission of light that is not scattered.
    """

    reflection: np.ndarray
    transmission: np.ndarray
    beam_reflection: np.ndarray
    beam_transmission: np.ndarray
    direct: np.ndarray

    def select(self, layer: int) -> Slab:
        """Return one layer of several along the first dimension."""
        return Slab(*(array[layer] for array in self))


class _Modes(NamedTuple):
    """Solutions of the equation of transfer in a homogeneous layer, see the module.

    Attributes
    ----------
    sums, differences : float, shape (..., streams, streams)
        X and Y.
    rates : float, shape (..., streams)
        k.
    even_kernel, odd_kernel : float, shape (..., directions, streams)
        Light scattered into further directions, by sum and by difference of the radiances.
    """

    sums: np.ndarray
    differences: np.ndarray
    rates: np.ndarray
    even_kernel: np.ndarray
    odd_kernel: np.ndarray


def solve_slab(optics: LayerOptics, streams: Streams, mode: int = 0) -> Slab:
    """Return the reflection and transmission of homogeneous layers for one azimuthal mode.

    Parameters
    ----------
    optics : LayerOptics
        With moments up to the number of streams (`LayerOptics.truncate`).
    streams : Streams
    mode : int
    """
    modes = _solve_modes(optics, streams, mode)
    k, thickness = modes.rates, optics.thickness[..., np.newaxis]
    even, odd, difference = _compute_impedances(k, thickness)
    y, y_t = modes.differences, np.swapaxes(modes.differences, -1, -2)
    unit = np.eye(k.shape[-1])
    even_inverse = np.linalg.inv(unit + (y * even[..., np.newaxis, :]) @ y_t)
    odd_inverse = np.linalg.inv(unit + (y * odd[..., np.newaxis, :]) @ y_t)
    transmission = odd_inverse @ (y * difference[..., np.newaxis, :]) @ (y_t @ even_inverse)
    reflection = even_inverse + odd_inverse - unit
    if not streams.directions.size:
        empty = np.empty((*k.shape[:-1], 0, k.shape[-1]))
        return Slab(reflection, transmission, empty, empty, empty[..., 0])
    integrals = _integrate_modes(k, thickness, streams.directions)
    by_sum, by_difference = modes.even_kernel @ modes.sums, modes.odd_kernel @ y
    even_row = by_sum * integrals.even_cosh - by_difference * integrals.even_sinh
    odd_row = by_sum * integrals.odd_sinh - by_difference * integrals.odd_cosh
    even_row, odd_row = even_row @ (y_t @ even_inverse), odd_row @ (y_t @ odd_inverse)
    direct = np.exp(-thickness / streams.directions)
    return Slab(
        _symmetrize(reflection), _symmetrize(transmission),
        0.5 * (even_row + odd_row), 0.5 * (even_row - odd_row), direct,
    )  # fmt: skip


def _solve_modes(optics: LayerOptics, streams: Streams, mode: int) -> _Modes:
    n_orders = optics.moments.shape[-1]
    functions = compute_legendre(streams.cosines, mode, n_orders)
    functions = functions * np.sqrt(streams.weights / streams.cosines)
    beam_functions = compute_legendre(streams.directions, mode, n_orders)
    scattering = (2.0 * np.arange(n_orders) + 1.0) * optics.moments * optics.albedo[..., np.newaxis]
    matrices, kernels = [], []
    for parity in (0, 1):
        orders = slice((mode + parity) % 2, None, 2)
        weighted = scattering[..., np.newaxis, orders] * functions.T[:, orders]
        matrices.append(np.diag(1.0 / streams.cosines) - weighted @ functions[orders])
        beam_weighted = scattering[..., np.newaxis, orders] * beam_functions.T[:, orders]
        kernels.append(beam_weighted @ functions[orders])
    b, a = matrices
    lower = np.linalg.cholesky(a)
    lower_t = np.swapaxes(lower, -1, -2)
    values, vectors = np.linalg.eigh(lower_t @ b @ lower)
    rates = np.sqrt(np.maximum(values, MIN_EIGENVALUE))
    inverse_t = np.swapaxes(np.linalg.inv(lower), -1, -2)
    return _Modes(lower @ vectors, inverse_t @ vectors, rates, *kernels)


def _compute_impedances(
    k: np.ndarray, thickness: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return k tanh(kτ/2), k coth(kτ/2), and their difference, which is 2k/sinh(kτ)."""
    with np.errstate(invalid="ignore"):
        depth = np.where(np.isinf(thickness), np.inf, k * thickness)
    tanh = np.tanh(0.5 * depth)
    tiny = np.finfo(float).tiny
    odd = k / np.maximum(tanh, tiny)
    decay = np.exp(-depth)
    difference = 4.0 * k * decay / np.maximum(-np.expm1(-2.0 * depth), tiny)
    return k * tanh, odd, difference


class _Integrals(NamedTuple):
    """Integrals of the modes along a direction, weighted by e^(−t/μ)/μ, of 0 to τ.

    "even" are those of cosh(k(τ/2 − t)) and k sinh(k(τ/2 − t)) over cosh(kτ/2); "odd" those of sinh
    and k cosh over sinh(kτ/2).
    """

    even_cosh: np.ndarray
    even_sinh: np.ndarray
    odd_sinh: np.ndarray
    odd_cosh: np.ndarray


def _integrate_modes(k: np.ndarray, thickness: np.ndarray, directions: np.ndarray) -> _Integrals:
    """Return the integrals, shape (..., directions, streams)."""
    k, thickness = k[..., np.newaxis, :], thickness[..., np.newaxis]
    mu = directions[:, np.newaxis]
    k_mu = k * mu
    with np.errstate(invalid="ignore"):
        depth = np.where(np.isinf(thickness), np.inf, k * thickness)
        slant = thickness / mu
    tiny = np.finfo(float).tiny
    decay, direct = np.exp(-depth), np.exp(-slant)
    # ∫ e^(−kt) e^(−t/μ) dt/μ and ∫ e^(−k(τ−t)) e^(−t/μ) dt/μ, without cancellation at kμ = 1.
    falling = -np.expm1(-depth - slant) / (1.0 + k_mu)
    low, high = np.minimum(depth, slant), np.maximum(depth, slant)
    with np.errstate(invalid="ignore"):
        gap = np.where(np.isinf(high), np.inf, high - low)
        ratio = np.where(gap > 0.0, -np.expm1(-gap) / np.maximum(gap, tiny), 1.0)
        rising = np.where(np.isinf(low), 0.0, np.exp(-low) * ratio * slant)
    even = 1.0 / (1.0 + decay)
    even_cosh, even_sinh = even * (falling + rising), even * (falling - rising)
    # Odd modes of small kμ, by partial integration: k coth(kτ/2) is finite there.
    k_coth = k / np.maximum(np.tanh(0.5 * depth), tiny)
    small = k_mu < 0.5
    denominator = np.where(small, 1.0 - k_mu**2, 1.0)
    odd = 1.0 / np.maximum(-np.expm1(-depth), tiny)
    odd_sinh = np.where(
        small,
        (1.0 + direct - mu * k_coth * (1.0 - direct)) / denominator,
        odd * (falling - rising),
    )
    odd_cosh = k_coth * (1.0 - direct) - k * k_mu * odd_sinh
    return _Integrals(even_cosh, k * even_sinh, odd_sinh, odd_cosh)


def _symmetrize(matrix: np.ndarray) -> np.ndarray:
    symmetric: np.ndarray = 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
    return symmetric
