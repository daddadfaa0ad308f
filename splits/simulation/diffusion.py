"""Diffusion theory of deep layers: effective mean free path, and reflectance of a substrate.

Of the fluence rate φ and the net flux J, F↓ and F↑ are φ/4 ± J/2; J = −D φ′ and D φ″ = μ φ, which
decays by exp(−κ z) (Ishimaru 1978, Wave Propagation and Scattering in Random Media, chapter 9).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr


def effective_mean_free_path(optics: xr.Dataset) -> np.ndarray:
    """Return the mean free path (m) of point scatterers that diffuse light as finite grains do.

    Light advances from grain to grain by l = 1/extinction, and by a displacement δ from entry to
    exit within each grain.  Diffusion over many grains is that of points at the mean distance

        l'² = (l + <δ·d>) (l + <δ·d'>) + (1 − g) <δ²>/2,

    d and d' the directions before and after: half the mean square displacement per grain, summed
    over the correlations g, g², … of directions, is l'²/(1 − g).
    """
    # Plain arrays add a hundred times faster than labelled ones.
    free = 1.0 / optics.extinction.values
    incident, exit = optics.displacement_along_incident, optics.displacement_along_exit
    transport_factor = 1.0 - optics.asymmetry_parameter.values
    spread = 0.5 * transport_factor * optics.mean_square_displacement.values
    return np.sqrt((free + incident.values) * (free + exit.values) + spread)


def diffuse_reflectance(n: np.ndarray) -> np.ndarray:
    """Return the reflectance of an interface for diffuse light from the side of index 1.

    It is the cosine-weighted mean of the Fresnel reflectance.

    Parameters
    ----------
    n : float, shape (...)
        Index of the far side, positive.
    """
    node, weight = np.polynomial.legendre.leggauss(256)
    mu, weight = 0.5 * (1.0 + node), 0.5 * weight
    n = np.asarray(n, dtype=float)
    # From the dense side, where the integrand has a corner, by reciprocity.
    dense = np.maximum(n, 1.0 / n)[..., np.newaxis]
    inner = np.sqrt(1.0 - (1.0 - mu**2) / dense**2)
    s_polarized = ((mu - dense * inner) / (mu + dense * inner)) ** 2
    p_polarized = ((dense * mu - inner) / (dense * mu + inner)) ** 2
    values: np.ndarray = (weight * mu * (s_polarized + p_polarized)).sum(axis=-1)
    return np.where(n < 1.0, 1.0 - (1.0 - values) * n**2, values)


class DiffusiveSubstrate(NamedTuple):
    """Diffusion-theory description of the medium below a truncation depth, by wavelength.

    Attributes
    ----------
    decay_flux_ratio : float
        κ D, the net flux over the fluence rate of light that decays by exp(−κ z).
    decay_depth : float
        κ h.
    bottom_flux_ratio : float
        Net flux over fluence rate at the bottom, (1 − ρ)/(2 (1 + ρ)) over an albedo ρ.
    """

    decay_flux_ratio: np.ndarray
    decay_depth: np.ndarray
    bottom_flux_ratio: np.ndarray

    def compute_flux_ratio(self) -> np.ndarray:
        """Return the net flux over the fluence rate at the truncation depth."""
        tanh = np.tanh(self.decay_depth)
        upper = self.bottom_flux_ratio + self.decay_flux_ratio * tanh
        lower = self.decay_flux_ratio + self.bottom_flux_ratio * tanh
        return self.decay_flux_ratio * upper / lower

    def compute_reflected_fraction(self) -> np.ndarray:
        """Return the reflectance for diffuse light."""
        flux_ratio = self.compute_flux_ratio()
        values: np.ndarray = (1.0 - 2.0 * flux_ratio) / (1.0 + 2.0 * flux_ratio)
        return np.clip(values, 0.0, 1.0)

    def compute_transmitted_fraction(self) -> np.ndarray:
        """Return the fraction of the net flux at the truncation depth that enters the bottom."""
        depth, ratio = np.minimum(self.decay_depth, 700.0), self.decay_flux_ratio
        fluence = ratio / (ratio * np.cosh(depth) + self.bottom_flux_ratio * np.sinh(depth))
        transmitted = self.bottom_flux_ratio * fluence / self.compute_flux_ratio()
        return np.clip(np.where(self.decay_depth > 700.0, 0.0, transmitted), 0.0, 1.0)
