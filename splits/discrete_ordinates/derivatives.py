"""Derivatives of the reflectance and the transmittance of dry layers, from two solutions.

Let F = aᵀ R u be a reflectance, with the light u that enters at the top and the vector a of its
measurement: light in the direction of a beam, or isotropic light.  As reflection and transmission
are symmetric (reciprocity), the sensitivity of F to light at any level is the light at this level
if a enters instead of u ("adjoint" light).  With the light that enters a layer from above and from
below, a change of its reflection and transmission changes F by

    dF = ½ p_aᵀ d(R + T) p_u + ½ m_aᵀ d(R − T) m_u,    p = above + below,  m = above − below.

The transmittance has light that rises from the ground for u.  The rest follows from the modes of
the layer (`splits.discrete_ordinates.homogeneous_layer.Modes`).  From R ± T = 2 (1 + Z)⁻¹ − 1,

    ½ p_aᵀ d(R ± T) p_u = −h_aᵀ dZ h_u,    h = (1 + Z)⁻¹ p,

and the derivative of a function of two symmetric matrices (Daleckii & Krein 1965) is

    dZ = d[Y g Yᵀ] = Y [Γ ∘ (½ (Â Λ + Λ Â) + B̂) − ½ (Â g + g Â)] Yᵀ,
    Â = Yᵀ dA Y,    B̂ = Xᵀ dB X,    Λ = k²,

with the divided differences Γ of g.  All parameters of all layers hence need one solution.

A beam is a stream here, so that all matrices are symmetric.  Its weight `BEAM_WEIGHT`, and the
relative rounding error divided by the root of the weight, change results by about 1e-10.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.adding import (
    INCIDENT,
    MEASUREMENT,
    RISING,
    trace_light,
)
from splits.discrete_ordinates.homogeneous_layer import (
    MIN_THICKNESS,
    TINY,
    LayerMatrices,
    LayerOptics,
    Modes,
    Streams,
    compute_impedances,
    compute_legendre,
    solve_layers,
    solve_modes,
)

# --------------------------------------------------------------------------------------------------
# Divided differences and derivatives of the impedances of a layer, as functions of k².
#
# The derivative of a function of a matrix has the divided differences of the function at all pairs
# of eigenvalues (Daleckii & Krein 1965; Higham 2008, Functions of Matrices, theorem 3.11),
#
#     Γ_ij = (g_i − g_j)/(λ_i − λ_j),    λ = k²,    g = k tanh(kτ/2) or k coth(kτ/2),
#
# and the derivative dg/dλ where both eigenvalues are equal.

MAX_SERIES_DEPTH = 0.1
"""Largest kτ/2 for which the odd impedance is a series."""
MIN_FAR_RATIO = 0.3
"""Smallest relative difference of two k whose divided difference is the plain quotient."""


def divide_impedances(k: np.ndarray, thickness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the divided differences of k tanh(kτ/2) and of k coth(kτ/2), without cancellation.

    With t = tanh(kτ/2), and likewise for coth,

        Γ_ij = ½ (t_i − t_j)/(k_i − k_j) + ½ (t_i + t_j)/(k_i + k_j),

    where tanh a − tanh b = sinh(a − b)/(cosh a cosh b), coth a − coth b = −sinh(a − b)/(sinh a
    sinh b).  Both terms cancel for the coth of small arguments: small k have the series of
    x coth x = 1 + z/3 − z²/45 + …, z = x², there, and different k the plain quotient.

    Parameters
    ----------
    k : float, shape (..., modes)
        Positive.
    thickness : float, shape (..., 1)
        τ, positive or infinite.

    Returns
    -------
    two arrays, shape (..., modes, modes)
    """
    first, second, half = k[..., :, np.newaxis], k[..., np.newaxis, :], 0.5 * thickness
    low, high, total = np.minimum(first, second), np.maximum(first, second), first + second
    gap, tau = high - low, thickness[..., np.newaxis]
    tanh, decay = np.tanh(k * half), np.exp(-k * thickness)
    tanh = np.maximum(tanh, TINY)
    odd_decay = np.maximum(-np.expm1(-k * thickness), TINY)
    falling = np.exp(-low * tau)
    with np.errstate(invalid="ignore", divide="ignore"):
        # 2 sinh(a − b) / (k_i − k_j), times the exponentials of both hyperbolic functions.
        slope = np.where(gap * tau > 0.0, -np.expm1(-gap * tau) / gap, tau)
        sinh = np.where(falling > 0.0, 2.0 * falling * slope, 0.0)
    even = 0.5 * (sinh / _multiply_pairs(1.0 + decay) + _add_pairs(tanh) / total)
    near = 0.5 * (_add_pairs(1.0 / tanh) / total - sinh / _multiply_pairs(odd_decay))
    impedance = k / tanh
    is_far = gap > MIN_FAR_RATIO * high
    difference = impedance[..., :, np.newaxis] - impedance[..., np.newaxis, :]
    far = difference / np.where(is_far, (first - second) * total, 1.0)
    small = high * half[..., np.newaxis] < MAX_SERIES_DEPTH
    depth = np.minimum(k * half, MAX_SERIES_DEPTH)
    # Divided differences of the series with respect to z.
    a, b = (depth**2)[..., :, np.newaxis], (depth**2)[..., np.newaxis, :]
    second, third = a + b, a**2 + a * b + b**2
    fourth, fifth = (a + b) * (a**2 + b**2), a**4 + a * b * third + b**4
    series = (
        1.0 / 3.0 - second / 45.0 + third * 2.0 / 945.0 - fourth / 4725.0 + fifth * 2.0 / 93555.0
    )
    series = 0.5 * np.where(small, tau, 0.0) * series
    return even, np.where(small, series, np.where(is_far, far, near))


def differentiate_impedances(k: np.ndarray, thickness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of k tanh(kτ/2) and of k coth(kτ/2) with respect to τ."""
    decay = np.exp(-k * thickness)
    odd_decay = np.maximum(-np.expm1(-k * thickness), TINY)
    return 2.0 * decay * (k / (1.0 + decay)) ** 2, -2.0 * decay * (k / odd_decay) ** 2


def _multiply_pairs(values: np.ndarray) -> np.ndarray:
    return values[..., :, np.newaxis] * values[..., np.newaxis, :]


def _add_pairs(values: np.ndarray) -> np.ndarray:
    return values[..., :, np.newaxis] + values[..., np.newaxis, :]


# --------------------------------------------------------------------------------------------------
# Derivatives of the reflectance and the transmittance of dry layers, from two solutions.

BEAM_WEIGHT = 1e-13
"""Weight of the stream of a beam."""
MIN_RELATIVE_RATE = 1e-12
"""Smallest k relative to the largest: derivatives are infinite in conservative half-spaces."""


class Gradient(NamedTuple):
    """Derivatives of the reflectance (first) and of the transmittance.

    Attributes
    ----------
    thickness : float, shape (2, layers, ...)
    absorption : float, shape (2, layers, ...)
        With respect to the absorption coefficient (the extinction less the scattering of order 0).
    scattering : float, shape (2, layers, ..., orders)
        With respect to the scattering coefficients times the moments, at constant absorption.
    ground : float, shape (2, ...)
        With respect to the albedo of the ground.
    cosine : float, shape (2, ...)
        With respect to the cosine of the direction of the beam; 0 for diffuse light.
    """

    thickness: np.ndarray
    absorption: np.ndarray
    scattering: np.ndarray
    ground: np.ndarray
    cosine: np.ndarray

    def differentiate(self, layer: int, tangent: LayerOptics) -> np.ndarray:
        """Return the derivatives with respect to a parameter of one layer, shape (2, ...).

        Parameters
        ----------
        layer : int
        tangent : LayerOptics
            Derivatives of the optics of this layer with respect to the parameter.
        """
        scattering = tangent.scattering[..., 0, 0, :]
        absorption = tangent.extinction[..., 0] - scattering[..., 0]
        derivative: np.ndarray = (
            self.thickness[:, layer] * tangent.thickness
            + self.absorption[:, layer] * absorption
            + (self.scattering[:, layer] * scattering).sum(axis=-1)
        )
        return derivative


def compute_gradient(
    optics: LayerOptics, streams: Streams, ground: np.ndarray, cosine: float | None = None
) -> tuple[np.ndarray, Gradient]:
    """Return the reflectance and the transmittance, shape (2, ...), with their derivatives.

    Parameters
    ----------
    optics : LayerOptics
        Of dry layers, top first, with leading dimensions (layers, ...); with as many moments as
        streams in both hemispheres (`LayerOptics.truncate`).
    streams : Streams
    ground : float, shape (...)
        Albedo of the Lambertian ground, 0 for an open lower boundary.  The transmittance is that of
        the latter, or the light that the ground absorbs.
    cosine : float, optional
        Cosine of the angle of incidence of a beam; without, light is diffuse.
    """
    if cosine is not None:
        # The beam is the first stream; the sum of all weights is 1.
        weights = np.append(BEAM_WEIGHT, (1.0 - BEAM_WEIGHT) * streams.weights)
        streams = Streams(np.append(cosine, streams.cosines), weights)
    modes = solve_modes(optics, streams, np.zeros((1, 0)), 0)
    floor = MIN_RELATIVE_RATE * modes.rates[..., -1:]
    modes = modes._replace(rates=np.maximum(modes.rates, floor))
    thickness = np.maximum(optics.thickness, MIN_THICKNESS)[..., np.newaxis]
    layers = solve_layers(modes, thickness)
    measurement = 2.0 * streams.flux_vector
    if cosine is not None:
        measurement = np.eye(len(measurement))[0] / np.sqrt(BEAM_WEIGHT * cosine)
    down, up = trace_light(layers, streams, ground, measurement)
    values = np.moveaxis(measurement @ up[0][..., INCIDENT:], -1, 0)
    entering = np.stack(down[:-1]), np.stack(up[1:])
    by_a, by_b, by_thickness = _differentiate_layers(modes, thickness, layers, entering)
    by_matrices = _expand(modes.differences, by_a), _expand(modes.sums, by_b)
    absorption, scattering = _differentiate_optics(optics, streams, by_matrices, modes, by_b)
    by_cosine = np.zeros_like(values)
    if cosine is not None:
        by_cosine = _differentiate_cosine(optics, streams, by_matrices)
    # A ground reflects the light that falls on it, in place of absorbing it.
    flux = np.moveaxis(streams.flux_vector @ down[-1], -1, 0)
    by_ground = 2.0 * flux[MEASUREMENT] * flux[INCIDENT:]
    by_ground[RISING - INCIDENT] -= flux[MEASUREMENT]
    return values, Gradient(by_thickness, absorption, scattering, by_ground, by_cosine)


def _differentiate_layers(
    modes: Modes,
    thickness: np.ndarray,
    layers: LayerMatrices,
    entering: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives with respect to A and to B, between modes, and to the thickness.

    The first is M with dF = tr(M Â), and the second M with dF = tr(M B̂), see the module; both are
    of shape (2, layers, ..., modes, modes).

    Parameters
    ----------
    modes : Modes
    thickness : float, shape (layers, ..., 1)
    layers : LayerMatrices
    entering : two arrays, shape (layers, ..., streams, 3)
        Light that enters the layers from above and from below.
    """
    k = modes.rates
    y_t, values = np.swapaxes(modes.differences, -1, -2), k**2
    mean_value = 0.5 * (values[..., :, np.newaxis] + values[..., np.newaxis, :])
    above, below = entering
    impedances = compute_impedances(k, thickness)[:2]
    parities = zip(
        (above + below, above - below),
        (layers.even_inverse, layers.odd_inverse),
        impedances,
        divide_impedances(k, thickness),
        differentiate_impedances(k, thickness),
        strict=True,
    )
    by_a, by_b = np.zeros((2, 2, *mean_value.shape))
    by_thickness = np.zeros((2, *k.shape[:-1]))
    for light, inverse, impedance, divided, slope in parities:
        amplitude = np.moveaxis(y_t @ (inverse @ light), -1, 0)
        measured, others = amplitude[MEASUREMENT], amplitude[INCIDENT:]
        products = measured[..., :, np.newaxis] * others[..., np.newaxis, :]
        products = -0.5 * (products + np.swapaxes(products, -1, -2))
        mean = 0.5 * (impedance[..., :, np.newaxis] + impedance[..., np.newaxis, :])
        by_b += divided * products
        by_a += (divided * mean_value - mean) * products
        by_thickness -= (measured * others * slope).sum(axis=-1)
    return by_a, by_b, by_thickness


def _differentiate_optics(
    optics: LayerOptics, streams: Streams, by_matrices: tuple[np.ndarray, np.ndarray],
    modes: Modes, by_b: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return the derivatives with respect to absorption and to scattering, see `Gradient`.

    A change of scattering leaves isotropic radiance in equilibrium, and its part of the modes is
    therefore left out there: this is exact also where absorption is weak.

    Parameters
    ----------
    optics, streams
        As in `compute_gradient`, with the beam.
    by_matrices : two arrays, shape (2, layers, ..., streams, streams)
        Derivatives with respect to A and to B.
    modes : Modes
    by_b : float, shape (2, layers, ..., modes, modes)
        See `_differentiate_layers`.
    """
    flux, n_orders = streams.flux_vector, optics.scattering.shape[-1]
    isotropic = (flux @ modes.sums)[..., np.newaxis, :] / (flux @ flux)
    anisotropic = modes.sums - flux[:, np.newaxis] * isotropic
    matrices = (*by_matrices, _expand(anisotropic, by_b))
    full_a, full_b, scattered_b = (one.reshape(*one.shape[:-2], -1) for one in matrices)
    diagonal = np.diag(1.0 / streams.cosines).ravel()
    functions = compute_legendre(streams.cosines, 0, n_orders)
    functions = functions * np.sqrt(streams.weights / streams.cosines)
    pairs = -(2.0 * np.arange(n_orders) + 1.0) * np.einsum("li,lj->ijl", functions, functions)
    pairs = pairs.reshape(-1, n_orders)
    scattering = np.empty((*full_a.shape[:-1], n_orders))
    scattering[..., ::2] = scattered_b @ pairs[:, ::2]
    scattering[..., 1::2] = full_a @ pairs[:, 1::2]
    scattering[..., 0] += (full_a + scattered_b) @ diagonal
    return (full_a + full_b) @ diagonal, scattering


def _differentiate_cosine(
    optics: LayerOptics, streams: Streams, by_matrices: tuple[np.ndarray, ...]
) -> np.ndarray:
    """Return the derivatives with respect to the cosine of the beam.

    The product of weight and cosine is constant, and so is the vector of the measurement.

    Parameters
    ----------
    optics : LayerOptics
    streams : Streams
        With the beam first.
    by_matrices : two arrays, shape (2, layers, ..., streams, streams)
        Derivatives with respect to A and to B.
    """
    cosine, n_orders = streams.cosines[0], optics.scattering.shape[-1]
    functions = compute_legendre(streams.cosines, 0, n_orders)
    slopes = np.zeros(n_orders)
    for order in range(1, n_orders):
        before = slopes[order - 2] if order > 1 else 0.0
        slopes[order] = before + (2.0 * order - 1.0) * functions[order - 1, 0]
    slopes = (slopes - functions[:, 0] / cosine) * np.sqrt(BEAM_WEIGHT / cosine)
    functions = functions * np.sqrt(streams.weights / streams.cosines)
    factors = (2.0 * np.arange(n_orders) + 1.0) * slopes
    extinction = optics.extinction[..., 0] / cosine**2
    derivative = np.zeros(by_matrices[0].shape[:-2])
    for parity, matrix in zip((1, 0), by_matrices, strict=True):
        coupling = (matrix[..., 0, :] @ functions[parity::2].T) * factors[parity::2]
        scattered = (coupling * optics.scattering[..., 0, 0, parity::2]).sum(axis=-1)
        derivative -= 2.0 * scattered + extinction * matrix[..., 0, 0]
    total: np.ndarray = derivative.sum(axis=1)
    return total


def _expand(vectors: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return a matrix between modes as one between streams."""
    expanded: np.ndarray = vectors @ matrix @ np.swapaxes(vectors, -1, -2)
    return expanded
