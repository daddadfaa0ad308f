"""Homogeneous layers: streams, modes, and their reflection and transmission.

The light in a layer is a sum of exponential modes.  All that this package computes follows from
them: the reflection and the transmission of a slab, and the integrals of its light along any
direction.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss

# --------------------------------------------------------------------------------------------------
# Directions of discrete ordinates, and Legendre functions in these directions.


class Streams(NamedTuple):
    """Streams of one hemisphere.

    The quadrature of each hemisphere is that of Gauss and Legendre on (0, 1), "double Gauss"
    (Sykes 1951, Monthly Notices of the Royal Astronomical Society 111, 377).

    Attributes
    ----------
    cosines : float, shape (streams,)
        Cosines of the angle with the normal.
    weights : float, shape (streams,)
        Weights, with a sum of 1.
    """

    cosines: np.ndarray
    weights: np.ndarray

    @classmethod
    @cache
    def from_number(cls, number: int) -> Streams:
        """Return the streams of one hemisphere, where `number` is that of both."""
        x, w = leggauss(number // 2)
        return cls(0.5 * (x + 1.0), 0.5 * w)


def compute_legendre(cosines: np.ndarray, mode: int, orders: int) -> np.ndarray:
    """Return the associated Legendre functions of one azimuthal mode, shape (orders, ...).

    They are normalized by √((l − m)!/(l + m)!), so that the addition theorem of the phase function
    has no factors.  Orders below the mode are 0.

    Parameters
    ----------
    cosines : float, shape (...)
    mode : int
        Number m of the azimuthal mode.
    orders : int
        Number of orders l, from 0.
    """
    values = np.zeros((orders, *cosines.shape))
    if mode >= orders:
        return values
    sine = np.sqrt((1.0 - cosines) * (1.0 + cosines))
    # √((2m − 1)!!/(2m)!!) sinᵐ, as a product without overflow.
    sectoral = np.ones_like(cosines)
    for m in range(1, mode + 1):
        sectoral = sectoral * sine * np.sqrt((2.0 * m - 1.0) / (2.0 * m))
    values[mode] = sectoral
    if mode + 1 < orders:
        values[mode + 1] = np.sqrt(2.0 * mode + 1.0) * cosines * sectoral
    for order in range(mode + 2, orders):
        below = np.sqrt((order - 1.0) ** 2 - mode**2) * values[order - 2]
        here = (2.0 * order - 1.0) * cosines * values[order - 1] - below
        values[order] = here / np.sqrt(order**2 - mode**2)
    return values


# --------------------------------------------------------------------------------------------------
# Exponentials in a homogeneous layer: impedances, and integrals along directions.

TINY = float(np.finfo(float).tiny)


def convolve_exponentials(a: np.ndarray, b: np.ndarray, thickness: np.ndarray) -> np.ndarray:
    """Return ∫ e^(−at) e^(−b(τ−t)) dt from 0 to τ, without cancellation at a = b."""
    low = np.minimum(a * thickness, b * thickness)
    with np.errstate(invalid="ignore"):
        excess = np.abs(a - b) * thickness
        ratio = np.where(excess > 0.0, -np.expm1(-excess) / np.maximum(excess, TINY), 1.0)
        integral: np.ndarray = np.where(np.isinf(low), 0.0, np.exp(-low) * ratio * thickness)
    return integral


def compute_impedances(
    k: np.ndarray, thickness: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return k tanh(kτ/2), k coth(kτ/2), and their difference, which is 2k/sinh(kτ)."""
    depth = k * thickness
    tanh = np.maximum(np.tanh(0.5 * depth), TINY)
    difference = 4.0 * k * np.exp(-depth) / np.maximum(-np.expm1(-2.0 * depth), TINY)
    return k * tanh, k / tanh, difference


# --------------------------------------------------------------------------------------------------
# Optics of homogeneous layers of one or two states of light.

MIN_TRUNCATED_EXTINCTION = 1e-13
"""Extinction that remains where all light is scattered exactly forward, relative to that before."""


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


# --------------------------------------------------------------------------------------------------
# Solutions of the equation of transfer in homogeneous layers, by eigenvalues.
#
# Radiances are scaled by √(w μ), with the weight w and the cosine μ of a stream, so that reflection
# and transmission are symmetric matrices (reciprocity).  With the sum s and the difference d of the
# downward and the upward radiances, the equation of transfer is
#
#     ds/dt = −A d,    dd/dt = −B s,
#
# with symmetric positive matrices A (moments of odd l + m) and B (of even l + m).  The eigenvalues
# k² of A B and the matrices X and Y, with (A B) X = X k² and Yᵀ X = 1, give its solutions.

MIN_EIGENVALUE = 1e-150
"""Smallest k², which is 0 without absorption."""


class Modes(NamedTuple):
    """Solutions of the equation of transfer in a homogeneous layer, see above.

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
    """Return the modes of homogeneous layers.

    Parameters are those of `solve_slab`.
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
    # Isotropic radiance of 1, in the scaled form.
    unit = np.sqrt(streams.weights * streams.cosines)
    isotropic = (amplitude[..., np.newaxis] * root)[..., np.newaxis] * unit
    deviation = by_state - isotropic
    # ∑ √(w/μ) √(w μ) = 1.
    amplitude = amplitude[..., np.newaxis]
    by_absorption = amplitude * (amplitude * root + 2.0 * (deviation @ profile)) * absorption
    deviation = deviation.reshape(vector.shape)
    remainder = deviation * (b @ deviation[..., np.newaxis])[..., 0]
    return by_absorption.sum(axis=-1) + remainder.sum(axis=-1)


def join_blocks(blocks: list[list[np.ndarray]]) -> np.ndarray:
    """Return a matrix of blocks."""
    if len(blocks) == 1:
        return blocks[0][0]
    return np.concatenate([np.concatenate(row, axis=-1) for row in blocks], axis=-2)


# --------------------------------------------------------------------------------------------------
# Reflection and transmission of homogeneous layers, from their modes.
#
# In the scaled form of `Modes`, light that is the same at both faces (even), or opposite (odd), has
# d = Z s at the upper face, where
#
#     Z = Y f(k) Yᵀ,    f = k tanh(k τ/2) or k coth(k τ/2),
#
# and R ± T = (1 − Z)(1 + Z)⁻¹.  No exponential grows, nothing cancels in T, and neither thin nor
# thick nor conservative layers need a case of their own.

MIN_THICKNESS = 1e-150
"""Thickness of layers of thickness 0."""


def solve_layers(modes: Modes, thickness: np.ndarray) -> list[np.ndarray]:
    """Return the matrices of layers of the thickness, shape (..., 1), between their streams.

    They are reflection, transmission, and (1 + Z)⁻¹ of even and of odd light, symmetric and each of
    shape (..., streams, streams).
    """
    even, odd, difference = compute_impedances(modes.rates, thickness)
    y, y_t = modes.differences, np.swapaxes(modes.differences, -1, -2)
    unit = np.eye(y.shape[-1])
    even_inverse = np.linalg.inv(unit + (y * even[..., np.newaxis, :]) @ y_t)
    odd_inverse = np.linalg.inv(unit + (y * odd[..., np.newaxis, :]) @ y_t)
    transmission = odd_inverse @ (y * difference[..., np.newaxis, :]) @ (y_t @ even_inverse)
    matrices = even_inverse + odd_inverse - unit, transmission, even_inverse, odd_inverse
    return [0.5 * (one + np.swapaxes(one, -1, -2)) for one in matrices]


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
    thickness = np.maximum(optics.thickness, MIN_THICKNESS)[..., np.newaxis]
    reflection, transmission, even_inverse, odd_inverse = solve_layers(modes, thickness)
    y_t = np.swapaxes(modes.differences, -1, -2)
    even_map, odd_map = y_t @ even_inverse, y_t @ odd_inverse
    shape = modes.even_kernel.shape
    rates = (optics.extinction[..., np.newaxis] / directions * rate_factors).reshape(shape[:-1])
    even_row, odd_row, gap_row = integrate_modes(modes, thickness, directions, rates)
    # Half the difference of both rows cancels in thick layers: there, that of the integrals, and of
    # the inverse matrices, which is the transmission.
    thick = (modes.rates * thickness > 1.0)[..., np.newaxis, :]
    thick_odd = np.where(thick, odd_row, 0.0)
    thin_odd = (odd_row - thick_odd) @ odd_map
    beam_transmission = np.where(thick, gap_row, even_row) @ even_map
    beam_transmission += thick_odd @ y_t @ transmission - thin_odd
    beam_reflection = even_row @ even_map + thick_odd @ odd_map + thin_odd
    return Slab(
        reflection, transmission,
        0.5 * beam_reflection, 0.5 * beam_transmission, np.exp(-thickness * rates),
    )  # fmt: skip


def integrate_modes(
    modes: Modes, thickness: np.ndarray, directions: np.ndarray, rates: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the radiance of the even and of the odd modes in directions, and the difference.

    Modes are integrated with the weight e^(−rt), from 0 to τ: the even ones, cosh(k(τ/2 − t)) and
    k sinh(k(τ/2 − t)) over cosh(kτ/2), and the odd ones, sinh and k cosh over sinh(kτ/2).  The
    difference of both has no cancellation where kτ is large.

    Parameters
    ----------
    modes : Modes
    thickness : float, shape (..., 1)
        τ, positive or infinite.
    directions : float, shape (..., states, directions)
        Cosines.
    rates : float, shape (..., directions of all states)
        r.

    Returns
    -------
    three arrays, shape (..., directions of all states, modes)
    """
    k, slant_rates = modes.rates[..., np.newaxis, :], rates[..., np.newaxis]
    tau = thickness[..., np.newaxis]
    depth, slant = k * tau, slant_rates * tau
    decay, direct, intercepted = np.exp(-depth), np.exp(-slant), -np.expm1(-slant)
    # ∫ e^(−kt) e^(−rt) dt and ∫ e^(−k(τ−t)) e^(−rt) dt.
    falling = -np.expm1(-depth - slant) / (k + slant_rates)
    rising = convolve_exponentials(k, slant_rates, tau)
    even = 1.0 / (1.0 + decay)
    even_cosh, even_sinh = even * (falling + rising), k * (even * (falling - rising))
    # Odd modes of small k/r, by partial integration: k coth(kτ/2) is finite there.
    k_coth = k / np.maximum(np.tanh(0.5 * depth), TINY)
    small = k < 0.5 * slant_rates
    denominator = np.where(small, (slant_rates - k) * (slant_rates + k), 1.0)
    by_parts = (slant_rates * (1.0 + direct) - k_coth * intercepted) / denominator
    odd = 1.0 / np.maximum(-np.expm1(-depth), TINY)
    odd_sinh = np.where(small, by_parts, odd * (falling - rising))
    odd_cosh = (k_coth * intercepted - k**2 * odd_sinh) / slant_rates
    gap, decayed = 2.0 * even * odd, decay * falling
    cosh_gap, sinh_gap = gap * (rising - decayed), -k * gap * (rising + decayed)
    # Light that sums and differences of radiances scatter into the directions.
    per_cosine = (1.0 / directions).reshape(*directions.shape[:-2], -1, 1)
    by_sum = per_cosine * (modes.even_kernel @ modes.sums)
    by_difference = per_cosine * (modes.odd_kernel @ modes.differences)
    return (
        by_sum * even_cosh - by_difference * even_sinh,
        by_sum * odd_sinh - by_difference * odd_cosh,
        by_sum * cosh_gap - by_difference * sinh_gap,
    )
