"""Optics of homogeneous layers of one or two states of light."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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
