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

from splits.discrete_ordinates.integrals import compute_impedances, integrate_modes
from splits.discrete_ordinates.streams import Streams, compute_legendre

MIN_EIGENVALUE = 1e-150
"""Smallest k², which is 0 without absorption."""
MIN_TRUNCATED_EXTINCTION = 1e-13
"""Extinction that remains where all light is scattered exactly forward, relative to that before."""
MIN_THICKNESS = 1e-150
"""Thickness of layers of thickness 0."""


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
        extinction = self.extinction - peak
        # A peak in the digits of both makes both differences exact, and so the absorption.
        peak = self.extinction - extinction
        scattering[..., states, states, :] -= peak[..., np.newaxis]
        extinction = np.maximum(extinction, MIN_TRUNCATED_EXTINCTION * self.extinction)
        return self._replace(extinction=extinction, scattering=scattering)


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

    def select(self, layer: int) -> Slab:
        """Return one layer of several along the first dimension."""
        return Slab(*(array[layer] for array in self))


class Modes(NamedTuple):
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
    optics: LayerOptics, streams: Streams, directions: np.ndarray, mode: int = 0,
    rate_factors: np.ndarray | float = 1.0,
) -> Slab:  # fmt: skip
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
    rate_factors : float, shape (directions,)
        Factors of the extinction along the further directions.
    """
    modes = solve_modes(optics, streams, directions, mode)
    k, thickness = modes.rates, np.maximum(optics.thickness, MIN_THICKNESS)[..., np.newaxis]
    even, odd, difference = compute_impedances(k, thickness)
    y, y_t = modes.differences, np.swapaxes(modes.differences, -1, -2)
    unit = np.eye(k.shape[-1])
    even_inverse = np.linalg.inv(unit + (y * even[..., np.newaxis, :]) @ y_t)
    odd_inverse = np.linalg.inv(unit + (y * odd[..., np.newaxis, :]) @ y_t)
    even_map = y_t @ even_inverse
    transmission = odd_inverse @ (y * difference[..., np.newaxis, :]) @ even_map
    reflection = even_inverse + odd_inverse - unit
    shape = modes.even_kernel.shape
    rates = (optics.extinction[..., np.newaxis] / directions * rate_factors).reshape(shape[:-1])
    even_row, odd_row, gap_row = _sum_modes(modes, thickness, directions, rates)
    # Half the difference of both rows cancels in thick layers: there, that of the integrals, and of
    # the inverse matrices, which is the transmission.
    thick = (k * thickness > 1.0)[..., np.newaxis, :]
    thick_odd = np.where(thick, odd_row, 0.0)
    thin_odd = (odd_row - thick_odd) @ y_t @ odd_inverse
    thick_odd = thick_odd @ y_t
    beam_transmission = np.where(thick, gap_row, even_row) @ even_map
    beam_transmission += thick_odd @ transmission - thin_odd
    beam_reflection = even_row @ even_map + thick_odd @ odd_inverse + thin_odd
    return Slab(
        _symmetrize(reflection), _symmetrize(transmission),
        0.5 * beam_reflection, 0.5 * beam_transmission, np.exp(-thickness * rates),
    )  # fmt: skip


def _sum_modes(
    modes: Modes, thickness: np.ndarray, directions: np.ndarray, rates: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the radiance of the even and odd modes in the directions, and the difference."""
    integrals = integrate_modes(modes.rates, thickness, rates)
    per_cosine = (1.0 / directions).reshape(*directions.shape[:-2], -1, 1)
    by_sum = per_cosine * (modes.even_kernel @ modes.sums)
    by_difference = per_cosine * (modes.odd_kernel @ modes.differences)
    return (
        by_sum * integrals.even_cosh - by_difference * integrals.even_sinh,
        by_sum * integrals.odd_sinh - by_difference * integrals.odd_cosh,
        by_sum * integrals.cosh_gap - by_difference * integrals.sinh_gap,
    )


def compute_scattering(
    optics: LayerOptics, streams: Streams, directions: np.ndarray, mode: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the light that is scattered by sums, and by differences, of radiances.

    Half the sum of both is scattering within a hemisphere, half the difference scattering between
    both.  Parameters are those of `solve_slab`.

    Returns
    -------
    two pairs of float, shape (..., streams, streams) and (..., directions, streams)
        ∑ (2l + 1) b_l P_l P_l over even and over odd l + m, with scattering coefficients b, between
        the streams of all states, and from these into the directions; streams have a factor √(w/μ).
    """
    n_orders, n = optics.scattering.shape[-1], streams.cosines.size
    states = range(optics.extinction.shape[-1])
    cosines = np.concatenate(
        [np.broadcast_to(streams.cosines, (*directions.shape[:-1], n)), directions], axis=-1
    )
    functions = np.moveaxis(compute_legendre(cosines, mode, n_orders), 0, -1)
    functions[..., :n, :] *= np.sqrt(streams.weights / streams.cosines)[:, np.newaxis]
    own = functions[(0,) * (functions.ndim - 2)][:n].T
    own = own * (2.0 * np.arange(n_orders) + 1.0)[:, np.newaxis]
    pairs = []
    for parity in (0, 1):
        orders = slice((mode + parity) % 2, None, 2)
        scattering = optics.scattering[..., np.newaxis, orders]
        blocks = [
            [(scattering[..., a, b, :, :] * functions[..., a, :, orders]) @ own[orders]
             for b in states] for a in states
        ]  # fmt: skip
        between, into = (
            join_blocks([[block[..., rows, :] for block in row] for row in blocks])
            for rows in (slice(n), slice(n, None))
        )
        pairs.append((between, into))
    return pairs


def solve_modes(optics: LayerOptics, streams: Streams, directions: np.ndarray, mode: int) -> Modes:
    """Return the modes of homogeneous layers; parameters are those of `solve_slab`."""
    pairs = compute_scattering(optics, streams, directions, mode)
    extinction = optics.extinction[..., np.newaxis] / streams.cosines
    extinction = extinction.reshape(*optics.extinction.shape[:-1], -1)
    diagonal = np.arange(extinction.shape[-1])
    b, a = (-between for between, _ in pairs)
    for matrix in (a, b):
        matrix[..., diagonal, diagonal] += extinction
    lower = np.linalg.cholesky(a)
    lower_t = np.swapaxes(lower, -1, -2)
    values, vectors = np.linalg.eigh(lower_t @ b @ lower)
    sums = lower @ vectors
    if mode == 0:
        values[..., 0] = _refine_eigenvalue(sums[..., 0], b, optics, streams)
    rates = np.sqrt(np.maximum(values, MIN_EIGENVALUE))
    inverse_t = np.swapaxes(np.linalg.inv(lower), -1, -2)
    return Modes(sums, inverse_t @ vectors, rates, pairs[0][1], pairs[1][1])


def _refine_eigenvalue(
    vector: np.ndarray, b: np.ndarray, optics: LayerOptics, streams: Streams
) -> np.ndarray:
    """Return the smallest k² of mode 0 with a small relative error, also where absorption is weak.

    Isotropic radiance s = √(w μ e), with the equilibrium e of each state, has B s = √(w/μ) α, with
    the absorption α = σ √e − ∑ b₀ √e, weighted by √e.  For a vector X = c s + Δ,

        k² = Xᵀ B X = c² sᵀ B s + 2 c Δᵀ B s + Δᵀ B Δ,

    where Δ is of the order of α.
    """
    root = np.sqrt(optics.equilibrium)
    states = np.arange(root.shape[-1])
    order0 = optics.scattering[..., 0].copy()
    staying = order0[..., states, states]
    order0[..., states, states] = 0.0
    absorption = (optics.extinction - staying) * root - (order0 @ root[..., np.newaxis])[..., 0]
    profile = np.sqrt(streams.weights / streams.cosines)
    by_state = vector.reshape(*vector.shape[:-1], root.shape[-1], -1)
    amplitude = ((by_state @ profile) * root).sum(axis=-1) / optics.equilibrium.sum(axis=-1)
    isotropic = (amplitude[..., np.newaxis] * root)[..., np.newaxis] * streams.flux_vector
    deviation = by_state - isotropic
    # ∑ √(w/μ) √(w μ) = 1.
    amplitude = amplitude[..., np.newaxis]
    by_absorption = amplitude * (amplitude * root + 2.0 * (deviation @ profile)) * absorption
    deviation = deviation.reshape(vector.shape)
    remainder = deviation * (b @ deviation[..., np.newaxis])[..., 0]
    refined: np.ndarray = by_absorption.sum(axis=-1) + remainder.sum(axis=-1)
    return refined


def join_blocks(blocks: list[list[np.ndarray]]) -> np.ndarray:
    """Return a matrix of blocks."""
    if len(blocks) == 1:
        return blocks[0][0]
    return np.concatenate([np.concatenate(row, axis=-1) for row in blocks], axis=-2)


def _symmetrize(matrix: np.ndarray) -> np.ndarray:
    symmetric: np.ndarray = 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
    return symmetric
