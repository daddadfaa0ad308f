"""Directions of discrete ordinates, and Legendre functions in these directions."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss


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
    def from_number(cls, number: int) -> Streams:
        """Return the streams of one hemisphere, where `number` is that of both."""
        return cls(*_compute_double_gauss(number // 2))

    @property
    def flux_vector(self) -> np.ndarray:
        """Isotropic radiance of 1 in the scaled form of `splits.discrete_ordinates.modes`.

        Twice the product with a scaled radiance is a flux, in units of that of radiance 1.
        """
        vector: np.ndarray = np.sqrt(self.weights * self.cosines)
        return vector


@cache
def _compute_double_gauss(number: int) -> tuple[np.ndarray, np.ndarray]:
    x, w = leggauss(number)
    return 0.5 * (x + 1.0), 0.5 * w


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
