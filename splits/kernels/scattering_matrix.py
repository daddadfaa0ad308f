"""Phase functions and scattering matrices of small particles.

The phase function p(µ), µ = cosΘ the cosine of the scattering angle, is a density over directions:
2π ∫ p dµ = 1.  The scattering matrix of the Stokes vector (I, Q, U, V), with the scattering plane
as reference (`stokes.py`), is that of randomly oriented particles with a plane of symmetry, divided
by p:

    1    m12  0    0
    m12  m22  0    0
    0    0    m33  m34
    0    0   −m34  m44

With the fraction Δ of light that is scattered as by dipoles, Rayleigh scattering with the
depolarization factor ρ has (Hansen & Travis 1974, Space Sci. Rev. 16, 527, section 2.3)

    4π p = ¾ Δ (1 + µ²) + 1 − Δ         m12 = −¾ Δ (1 − µ²)/(4π p)    m22 = ¾ Δ (1 + µ²)/(4π p)
    m33 = 3/2 Δ µ/(4π p)                m44 = Δ' m33                  m34 = 0
    Δ = (1 − ρ)/(1 + ρ/2)               Δ' = (1 − 2ρ)/(1 − ρ)

The phase function of Henyey and Greenstein has no matrix of its own; it is combined with the ratios
of Rayleigh scattering without depolarization.  A table has a matrix of its own.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

HENYEY_GREENSTEIN = 0


RAYLEIGH = 1


TABLE = 2


M12, M22, M33, M34, M44 = range(5)
"""Columns of the elements of a table."""


ISOTROPIC_PER_SR = 0.25 / math.pi


class PhaseFunction(NamedTuple):
    """Phase function and polarization of single scattering.

    Attributes
    ----------
    kind : int
        `HENYEY_GREENSTEIN`, `RAYLEIGH` or `TABLE`.
    g : float
        Mean cosine; the parameter of Henyey and Greenstein, in (−1, 1).
    dipole_fraction : float
        Δ in [0, 1], see the module; 1 except for Rayleigh scattering.
    circular_ratio : float
        Δ', see the module; 1 except for Rayleigh scattering.
    cosines : float64[m]
        Nodes of a table, rising from −1 to 1; unused otherwise.
    density : float64[m]
        Phase function at the cosines (1/sr), linear in µ between them.
    cdf : float64[m]
        Probability of a smaller cosine, from 0 to 1.
    elements : float64[m, 5]
        Elements of the scattering matrix at the cosines, times the density (1/sr), linear in µ
        between them; columns `M12`, `M22`, `M33`, `M34` and `M44`.
    """

    kind: int
    g: float
    dipole_fraction: float
    circular_ratio: float
    cosines: np.ndarray
    density: np.ndarray
    cdf: np.ndarray
    elements: np.ndarray


class ScatteringRatios(NamedTuple):
    """Elements of the scattering matrix over the phase function, see the module."""

    m12: float
    m22: float
    m33: float
    m34: float
    m44: float


def _make_analytic(
    kind: int, g: float, dipole_fraction: float = 1.0, circular_ratio: float = 1.0
) -> PhaseFunction:
    ends = np.array([-1.0, 1.0])
    isotropic = np.full(2, ISOTROPIC_PER_SR)
    return PhaseFunction(
        kind, float(g), dipole_fraction, circular_ratio, ends, isotropic, np.array([0.0, 1.0]),
        np.zeros((2, len(ScatteringRatios._fields))),
    )  # fmt: skip


def make_henyey_greenstein(g: float) -> PhaseFunction:
    """Return the phase function of Henyey & Greenstein (1941, Astrophys. J. 93, 70)."""
    return _make_analytic(HENYEY_GREENSTEIN, g)


def make_rayleigh(depolarization: float = 0.0) -> PhaseFunction:
    """Return Rayleigh scattering with a depolarization factor, from 0 to below 1."""
    rho = float(depolarization)
    return _make_analytic(
        RAYLEIGH, 0.0, (1.0 - rho) / (1.0 + 0.5 * rho), (1.0 - 2.0 * rho) / (1.0 - rho)
    )


def make_tabulated(cosines: Any, values: Any, ratios: Any = None) -> PhaseFunction:
    """Return a phase function and a scattering matrix that are linear in µ between given values.

    Parameters
    ----------
    cosines : array_like
        Distinct numbers, in any order, including −1 and 1.
    values : array_like
        Phase function there, nonnegative, in any unit: it is normalized.
    ratios : array_like, shape (cosines, 5), optional
        Elements of the matrix over the phase function, see `ScatteringRatios`; 0 by default, for
        which scattered light is unpolarized.
    """
    order = np.argsort(np.asarray(cosines, dtype=float))
    mu = np.asarray(cosines, dtype=float)[order]
    y = np.asarray(values, dtype=float)[order]
    low, high, width = mu[:-1], mu[1:], np.diff(mu)
    cumulative = np.append(0.0, np.cumsum(0.5 * width * (y[:-1] + y[1:])))
    total = cumulative[-1]
    # ∫ µ y dµ over an interval, exact for y linear in µ.
    moments = width * ((2.0 * low + high) * y[:-1] + (low + 2.0 * high) * y[1:]) / 6.0
    g = float(moments.sum() / total)
    density = y / (2.0 * math.pi * total)
    shape = mu.size, len(ScatteringRatios._fields)
    elements = np.zeros(shape) if ratios is None else np.asarray(ratios, dtype=float)[order]
    return PhaseFunction(
        TABLE, g, 1.0, 1.0, mu, density, cumulative / total, elements * density[:, np.newaxis]
    )
