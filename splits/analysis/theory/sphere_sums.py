"""Sums of Mie scattering over spheres of different sizes.

The series coefficients a_n and b_n and the angular functions π_n and τ_n are those of the package
miepython.  A sphere of size parameter x = 2π r/λ has the amplitudes (Bohren & Huffman 1983,
Absorption and Scattering of Light by Small Particles, section 4.4)

    S1 = Σ_n (2n + 1)/(n(n + 1)) (a_n π_n + b_n τ_n)
    S2 = Σ_n (2n + 1)/(n(n + 1)) (a_n τ_n + b_n π_n)

and, with the scattering plane as reference, the matrix

    P11 = P22 = ½(|S2|² + |S1|²)    P12 = ½(|S2|² − |S1|²)    P33 + i P34 = S2 S1*    P44 = P33

whose integral over directions is the scattering cross-section times the squared wave number.
"""

from __future__ import annotations

import os
from types import ModuleType
from typing import NamedTuple

import numba
import numpy as np

from splits.core.optional import import_optional

COMPILATION_SWITCH = "MIEPYTHON_USE_JIT"
"""Variable of the environment by which miepython compiles its functions."""
BATCH = 64
"""Number of spheres whose amplitudes are computed at once."""


class SphereSums(NamedTuple):
    """Sums over spheres, weighted by projected area.

    Attributes
    ----------
    area, extinction, scattering, forward : float
        Sums of 1, of the efficiencies of extinction and scattering, and of the latter times the
        asymmetry parameter.
    matrix : float, shape (4, angles)
        Sums of P11, P12, P33 and P34 of the module, times 4/x²: the mean of P11 over directions is
        the sum of the scattering efficiencies.
    """

    area: float
    extinction: float
    scattering: float
    forward: float
    matrix: np.ndarray

    def add(self, other: SphereSums) -> SphereSums:
        """Return the sums over the spheres of both."""
        return SphereSums(
            self.area + other.area,
            self.extinction + other.extinction,
            self.scattering + other.scattering,
            self.forward + other.forward,
            self.matrix + other.matrix,
        )

    def measure_change(self, other: SphereSums) -> float:
        """Return the largest relative difference between means over spheres.

        For elements of the matrix, it is the mean over angles of the difference divided by P11.
        """
        means = [(s.extinction / s.area, s.scattering / s.area) for s in (self, other)]
        efficiencies = max(abs(one / two - 1.0) for one, two in zip(*means, strict=True))
        asymmetry = abs(self.forward / self.scattering - other.forward / other.scattering)
        one, two = self.matrix / self.scattering, other.matrix / other.scattering
        return float(max(efficiencies, asymmetry, *(np.abs(one - two) / two[0]).mean(axis=1)))


class AngularFunctions:
    """Functions π_n and τ_n times (2n + 1)/(n(n + 1)) at scattering angles.

    Parameters
    ----------
    angle_deg : float, shape (angles,)
    max_size : float
        Largest size parameter.
    """

    def __init__(self, angle_deg: np.ndarray, max_size: float) -> None:
        mie = import_miepython()
        n_terms = len(mie.coefficients(1.5 + 0.0j, max_size)[0])
        pi, tau = (np.zeros((angle_deg.size, n_terms)) for _ in range(2))
        for row, cosine in enumerate(np.cos(np.radians(angle_deg))):
            mie.pi_tau(float(cosine), pi[row], tau[row])
        n = np.arange(1.0, n_terms + 1.0)
        factor = (2.0 * n + 1.0) / (n * (n + 1.0))
        self.pi, self.tau = (factor * pi).T, (factor * tau).T


def import_miepython() -> ModuleType:
    """Return the package miepython; raise ModuleNotFoundError with its installation command.

    Its functions are compiled unless the environment says otherwise, which miepython reads when it
    is imported for the first time.
    """
    is_chosen = COMPILATION_SWITCH in os.environ or numba.config.DISABLE_JIT  # type: ignore[attr-defined]
    if is_chosen:
        return import_optional("miepython", "mie", "Mie theory needs")
    os.environ[COMPILATION_SWITCH] = "1"
    try:
        return import_optional("miepython", "mie", "Mie theory needs")
    finally:
        del os.environ[COMPILATION_SWITCH]


def sum_spheres(
    index: complex, size: np.ndarray, area: np.ndarray, functions: AngularFunctions
) -> SphereSums:
    """Return sums over spheres.

    Parameters
    ----------
    index : complex
        Refractive index n + ik relative to the surrounding medium.
    size : float, shape (spheres,)
        Size parameters.
    area : float, shape (spheres,)
        Projected areas in any unit, times the numbers of spheres.
    functions : AngularFunctions
    """
    mie = import_miepython()
    # miepython takes n − ik; the coefficients that it returns are those of n + ik.
    extinction, scattering, _, asymmetry = mie.efficiencies_mx(np.conj(index), size)
    matrix = np.zeros((4, functions.pi.shape[1]))
    for start in range(0, size.size, BATCH):
        part = slice(start, start + BATCH)
        amplitudes = _compute_amplitudes(index, size[part], functions)
        matrix += _multiply_amplitudes(4.0 * area[part] / size[part] ** 2, *amplitudes)
    return SphereSums(
        area.sum(), area @ extinction, area @ scattering, area @ (scattering * asymmetry), matrix
    )


def _compute_amplitudes(
    index: complex, size: np.ndarray, functions: AngularFunctions
) -> tuple[np.ndarray, np.ndarray]:
    """Return S1 and S2 of spheres, shape (spheres, angles)."""
    mie = import_miepython()
    series = [mie.coefficients(np.conj(index), x) for x in size]
    n_terms = max(one.shape[1] for one in series)
    a, b = np.zeros((2, size.size, n_terms), dtype=complex)
    for row, (a_n, b_n) in enumerate(series):
        a[row, : a_n.size], b[row, : b_n.size] = a_n, b_n
    pi, tau = functions.pi[:n_terms], functions.tau[:n_terms]

    def multiply(terms: np.ndarray, function: np.ndarray) -> np.ndarray:
        """Return the product of a complex and a real matrix, by two real products."""
        product: np.ndarray = terms.real @ function + 1j * (terms.imag @ function)
        return product

    return multiply(a, pi) + multiply(b, tau), multiply(a, tau) + multiply(b, pi)


def _multiply_amplitudes(weight: np.ndarray, s1: np.ndarray, s2: np.ndarray) -> np.ndarray:
    """Return weighted sums of P11, P12, P33 and P34 over spheres, shape (4, angles)."""
    perpendicular, parallel = weight @ np.abs(s1) ** 2, weight @ np.abs(s2) ** 2
    product = weight @ (s2 * s1.conj())
    mean, difference = 0.5 * (parallel + perpendicular), 0.5 * (parallel - perpendicular)
    return np.stack([mean, difference, product.real, product.imag])
