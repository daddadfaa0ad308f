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
TINY = float(np.finfo(float).tiny)


class LayerOptics(NamedTuple):
    """Optics of homogeneous layers; leading dimensions are arbitrary, such as (wavelengths,).

    In wet snow light is in dry or in wet pores ("states"), and scattering may change the pore.
    Radiances of a state are divided by the square root of its equilibrium, in which radiance is
    proportional to n² and to the fraction of the pores; scattering is then symmetric.

    Attributes
    ----------
    thickness : float, shape (...)
        Thickness of the layers, in any unit of length; infinite for a half-space.
    extinction : float, shape (..., states)
        Extinction coefficients, per unit of length.
    scattering : float, shape (..., states, states, orders)
        Scattering coefficients times the Legendre moments of the phase function, from order 0.
    equilibrium : float, shape (..., states)
        Radiance of each state in equilibrium with a radiance of 1 in air; 1 where there is one.
    """

    thickness: np.ndarray
    extinction: np.ndarray
    scattering: np.ndarray
    equilibrium: np.ndarray

    @classmethod
    def from_albedo(
        cls, thickness: np.ndarray, albedo: np.ndarray, moments: np.ndarray
    ) -> LayerOptics:
        """Return the optics of layers of one state.

        Parameters
        ----------
        thickness : float, shape (...)
            Optical thickness.
        albedo : float, shape (...)
            Single-scattering albedo, 0 to 1.
        moments : float, shape (..., orders)
            Legendre moments of the phase function, from that of order 0, which is 1.
        """
        scattering = (np.asarray(albedo)[..., np.newaxis] * moments)[..., np.newaxis, np.newaxis, :]
        unit = np.ones((*np.shape(albedo), 1))
        return cls(np.asarray(thickness, dtype=float), unit, scattering, unit)

    def truncate(self, streams: int) -> LayerOptics:
        """Return the optics with as many moments as streams; the rest is a forward peak (delta-M).

        Light of the peak, a part f = χ of the order `streams` of the light that stays in its state,
        counts as unscattered (Wiscombe 1977, Journal of the Atmospheric Sciences 34, 1408).
        """
        scattering = self.scattering[..., :streams].copy()
        states = np.arange(scattering.shape[-2])
        peak = np.maximum(self.scattering[..., states, states, streams], 0.0)
        scattering[..., states, states, :] -= peak[..., np.newaxis]
        return self._replace(extinction=self.extinction - peak, scattering=scattering)


class Slab(NamedTuple):
    """Reflection and transmission of homogeneous layers for scaled radiances.

    "Directions" are beams and directions of observation, from which no light is scattered.

    Attributes
    ----------
    reflection, transmission : float, shape (..., streams, streams)
        Symmetric; between the streams of all states.
    beam_reflection, beam_transmission : float, shape (..., directions, streams)
        Radiance in the directions of all states for the radiance of the streams.
    direct : float, shape (..., directions)
        Transmission of light that is not scattered.
    """

    reflection: np.ndarray
    transmission: np.ndarray
    beam_reflection: np.ndarray
    beam_transmission: np.ndarray
    direct: np.ndarray


class _Modes(NamedTuple):
    """Solutions of the equation of transfer in a homogeneous layer, see the module.

    Attributes
    ----------
    sums, differences : float, shape (..., streams, streams)
        X and Y.
    rates : float, shape (..., streams)
        k.
    even_kernel, odd_kernel : float, shape (..., directions, streams)
        Light scattered into the directions, by sum and by difference of the radiances.
    """

    sums: np.ndarray
    differences: np.ndarray
    rates: np.ndarray
    even_kernel: np.ndarray
    odd_kernel: np.ndarray


def solve_slab(
    optics: LayerOptics, streams: Streams, directions: np.ndarray, mode: int = 0
) -> Slab:
    """Return the reflection and transmission of homogeneous layers for one azimuthal mode.

    Parameters
    ----------
    optics : LayerOptics
        With at most as many moments as streams in both hemispheres (`LayerOptics.truncate`).
    streams : Streams
        Of one hemisphere and one state.
    directions : float, shape (..., states, directions)
        Cosines of the further directions in each state, as light is refracted into water.
    mode : int
    """
    modes = _solve_modes(optics, streams, directions, mode)
    k, thickness = modes.rates, optics.thickness[..., np.newaxis]
    even, odd, difference = _compute_impedances(k, thickness)
    y, y_t = modes.differences, np.swapaxes(modes.differences, -1, -2)
    unit = np.eye(k.shape[-1])
    even_inverse = np.linalg.inv(unit + (y * even[..., np.newaxis, :]) @ y_t)
    odd_inverse = np.linalg.inv(unit + (y * odd[..., np.newaxis, :]) @ y_t)
    transmission = odd_inverse @ (y * difference[..., np.newaxis, :]) @ (y_t @ even_inverse)
    reflection = even_inverse + odd_inverse - unit
    shape = modes.even_kernel.shape
    rates = (optics.extinction[..., np.newaxis] / directions).reshape(shape[:-1])
    integrals = _integrate_modes(k, thickness, rates)
    per_cosine = (1.0 / directions).reshape(*directions.shape[:-2], -1, 1)
    by_sum = per_cosine * (modes.even_kernel @ modes.sums)
    by_difference = per_cosine * (modes.odd_kernel @ y)
    even_row = by_sum * integrals.even_cosh - by_difference * integrals.even_sinh
    odd_row = by_sum * integrals.odd_sinh - by_difference * integrals.odd_cosh
    even_row, odd_row = even_row @ (y_t @ even_inverse), odd_row @ (y_t @ odd_inverse)
    return Slab(
        _symmetrize(reflection), _symmetrize(transmission),
        0.5 * (even_row + odd_row), 0.5 * (even_row - odd_row), np.exp(-thickness * rates),
    )  # fmt: skip


def _solve_modes(
    optics: LayerOptics, streams: Streams, directions: np.ndarray, mode: int
) -> _Modes:
    n_orders, n_states = optics.scattering.shape[-1], optics.extinction.shape[-1]
    functions = compute_legendre(streams.cosines, mode, n_orders)
    functions = functions * np.sqrt(streams.weights / streams.cosines)
    beam_functions = np.moveaxis(compute_legendre(directions, mode, n_orders), 0, -1)
    matrices, kernels = [], []
    for parity in (0, 1):
        orders = slice((mode + parity) % 2, None, 2)
        factors = 2.0 * np.arange(n_orders)[orders] + 1.0
        weighted = factors[:, np.newaxis] * functions[orders]
        scattering = optics.scattering[..., orders]
        blocks = [
            [(scattering[..., a, b, np.newaxis, :] * functions.T[:, orders]) @ weighted
             for b in range(n_states)] for a in range(n_states)
        ]  # fmt: skip
        rows = [
            [(scattering[..., a, b, np.newaxis, :] * beam_functions[..., a, :, orders]) @ weighted
             for b in range(n_states)] for a in range(n_states)
        ]  # fmt: skip
        matrices.append(-join_blocks(blocks))
        kernels.append(join_blocks(rows))
    diagonal = np.arange(matrices[0].shape[-1])
    extinction = (optics.extinction[..., np.newaxis] / streams.cosines).reshape(
        *optics.extinction.shape[:-1], -1
    )
    for matrix in matrices:
        matrix[..., diagonal, diagonal] += extinction
    b, a = matrices
    lower = np.linalg.cholesky(a)
    lower_t = np.swapaxes(lower, -1, -2)
    values, vectors = np.linalg.eigh(lower_t @ b @ lower)
    rates = np.sqrt(np.maximum(values, MIN_EIGENVALUE))
    inverse_t = np.swapaxes(np.linalg.inv(lower), -1, -2)
    return _Modes(lower @ vectors, inverse_t @ vectors, rates, *kernels)


def join_blocks(blocks: list[list[np.ndarray]]) -> np.ndarray:
    """Return a matrix of blocks."""
    if len(blocks) == 1:
        return blocks[0][0]
    return np.concatenate([np.concatenate(row, axis=-1) for row in blocks], axis=-2)


def _compute_impedances(
    k: np.ndarray, thickness: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return k tanh(kτ/2), k coth(kτ/2), and their difference, which is 2k/sinh(kτ)."""
    depth = k * thickness
    tanh = np.maximum(np.tanh(0.5 * depth), TINY)
    difference = 4.0 * k * np.exp(-depth) / np.maximum(-np.expm1(-2.0 * depth), TINY)
    return k * tanh, k / tanh, difference


class _Integrals(NamedTuple):
    """Integrals of the modes along a direction, weighted by e^(−rt) with a rate r, of 0 to τ.

    "even" are those of cosh(k(τ/2 − t)) and k sinh(k(τ/2 − t)) over cosh(kτ/2); "odd" those of sinh
    and k cosh over sinh(kτ/2).
    """

    even_cosh: np.ndarray
    even_sinh: np.ndarray
    odd_sinh: np.ndarray
    odd_cosh: np.ndarray


def _integrate_modes(k: np.ndarray, thickness: np.ndarray, rates: np.ndarray) -> _Integrals:
    """Return the integrals, shape (..., directions, streams)."""
    k, thickness, rates = k[..., np.newaxis, :], thickness[..., np.newaxis], rates[..., np.newaxis]
    depth, slant = k * thickness, rates * thickness
    decay, direct = np.exp(-depth), np.exp(-slant)
    # ∫ e^(−kt) e^(−rt) dt and ∫ e^(−k(τ−t)) e^(−rt) dt, without cancellation at k = r.
    falling = -np.expm1(-depth - slant) / (k + rates)
    gap = np.abs(k - rates) * thickness
    ratio = np.where(gap > 0.0, -np.expm1(-gap) / np.maximum(gap, TINY), 1.0)
    low = np.minimum(depth, slant)
    with np.errstate(invalid="ignore"):
        rising = np.where(np.isinf(low), 0.0, np.exp(-low) * ratio * thickness)
    even = 1.0 / (1.0 + decay)
    even_cosh, even_sinh = even * (falling + rising), even * (falling - rising)
    # Odd modes of small k/r, by partial integration: k coth(kτ/2) is finite there.
    k_coth = k / np.maximum(np.tanh(0.5 * depth), TINY)
    small = k < 0.5 * rates
    denominator = np.where(small, (rates - k) * (rates + k), 1.0)
    by_parts = (rates * (1.0 + direct) - k_coth * (1.0 - direct)) / denominator
    odd_sinh = np.where(small, by_parts, (falling - rising) / np.maximum(-np.expm1(-depth), TINY))
    odd_cosh = (k_coth * (1.0 - direct) - k**2 * odd_sinh) / rates
    return _Integrals(even_cosh, k * even_sinh, odd_sinh, odd_cosh)


def _symmetrize(matrix: np.ndarray) -> np.ndarray:
    symmetric: np.ndarray = 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
    return symmetric
