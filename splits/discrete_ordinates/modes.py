"""Solutions of the equation of transfer in homogeneous layers, by eigenvalues.

Radiances are scaled by √(w μ), with the weight w and the cosine μ of a stream, so that reflection
and transmission are symmetric matrices (reciprocity).  With the sum s and the difference d of the
downward and the upward radiances, the equation of transfer is

    ds/dt = −A d,    dd/dt = −B s,

with symmetric positive matrices A (moments of odd l + m) and B (of even l + m).  The eigenvalues k²
of A B and the matrices X and Y, with (A B) X = X k² and Yᵀ X = 1, give its solutions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.layer_optics import LayerOptics
from splits.discrete_ordinates.streams import Streams, compute_legendre

MIN_EIGENVALUE = 1e-150
"""Smallest k², which is 0 without absorption."""


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


def compute_scattering(
    optics: LayerOptics, streams: Streams, directions: np.ndarray, mode: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the light that is scattered by sums, and by differences, of radiances.

    Half the sum of both is scattering within a hemisphere, half the difference scattering between
    both.  Parameters are those of
    `splits.discrete_ordinates.slab.solve_slab`.

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
    """Return the modes of homogeneous layers.

    Parameters are those of `splits.discrete_ordinates.slab.solve_slab`.
    """
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
