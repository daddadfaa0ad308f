"""Complex refractive indices of Lorentz oscillator models, such as that of goethite."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from splits.core.validation import check_range
from splits.materials.refractive_index import check_wavelength_range

HC_EV_NM = 1239.841984
"""Photon energy (eV) times vacuum wavelength (nm)."""


@dataclass(frozen=True)
class LorentzOscillator:
    """Lorentz oscillator: a band of the dielectric function.

    Parameters
    ----------
    energy_ev : float
        Photon energy E_j of the resonance (eV), above 0.
    strength : float
        f_j, contribution of the band to the static dielectric constant, above 0.
    width_ev : float
        γ_j, full width of the band at half maximum (eV), above 0.
    """

    energy_ev: float
    strength: float
    width_ev: float

    def __post_init__(self) -> None:
        for key in ("energy_ev", "strength", "width_ev"):
            check_range(key, getattr(self, key), 0.0, np.inf, open_low=True)

    def permittivity(self, energy_ev: Any) -> np.ndarray:
        """Return the contribution of the band to ε at photon energies (eV)."""
        e = np.asarray(energy_ev, dtype=float)
        resonance_squared = self.energy_ev**2
        return (
            self.strength * resonance_squared / (resonance_squared - e * e - 1j * self.width_ev * e)
        )


@dataclass(frozen=True)
class LorentzIndex:
    """Lorentz oscillator model: n + i k = √ε, ε(E) = ε∞ + Σ f_j E_j² / (E_j² − E² − i γ_j E).

    E is the photon energy.  Since n and k derive from one analytic function, they satisfy the
    Kramers-Kronig relations for all parameters.

    Parameters
    ----------
    name, source : str
        Name and source of the model.
    range_nm : (low, high)
        Range of validity in vacuum wavelength (nm).
    high_energy_permittivity : float
        ε∞, contribution of all bands at higher energies; at least 1.
    oscillators : sequence of LorentzOscillator
    """

    name: str
    source: str
    range_nm: tuple[float, float]
    high_energy_permittivity: float
    oscillators: tuple[LorentzOscillator, ...]

    def __post_init__(self) -> None:
        check_range("high_energy_permittivity", self.high_energy_permittivity, 1.0, np.inf)

    def permittivity(self, energy_ev: Any) -> np.ndarray:
        """Return ε at photon energies (eV), also outside the range of validity."""
        bands = [band.permittivity(energy_ev) for band in self.oscillators]
        return np.asarray(self.high_energy_permittivity + np.sum(bands, axis=0))

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return complex n + i k; a wavelength outside the range raises ValueError."""
        return np.sqrt(
            self.permittivity(
                HC_EV_NM / check_wavelength_range(wavelength_nm, *self.range_nm, self.name)
            )
        )


def make_goethite() -> LorentzIndex:
    """Return a model of goethite (α-FeOOH), 300 to 2600 nm.

    This is a model, not a measurement: no public table of n and k of goethite in the visible was
    found.  A user's table can replace it (see `splits.materials.lookup`).

    - The bands are the crystal-field bands near 900 and 650 nm, the paired transition near 480 nm,
      and two broad bands at 365 and 285 nm for the absorption below 420 nm (ligand field and charge
      transfer from oxygen to iron).  Their rounded positions follow the assignments of Sherman &
      Waite and of Cornell & Schwertmann.
    - ε∞ is chosen so that n = 2.36 at 570 nm, within 0.02 of the mean of the principal indices of
      optical mineralogy (2.27, 2.40, 2.46).
    - Strengths and widths are chosen for k near 0.1 from 425 to 490 nm, decreasing to 0.03 at 600
      to 650 nm and 0.02 at 700 nm, with the shoulder at 650 nm and the weak maximum near 900 nm
      seen in reflectance spectra of goethite.

    Only the order of magnitude of k is reliable.  Lorentz wings are broader than those of real
    bands, so k above 1000 nm (0.012, decreasing to 0.003) is more likely too high than too low.
    Use ``k_factor`` to test the sensitivity to k.

    References
    ----------
    Sherman & Waite 1985, Electronic spectra of Fe³⁺ oxides and oxide hydroxides in the near IR to
    near UV, American Mineralogist 70, 1262-1269.

    Cornell & Schwertmann 2003, The Iron Oxides, 2nd ed., Wiley-VCH.
    """
    wavelength_strength_width = (
        (900.0, 0.0055, 0.22),
        (650.0, 0.005, 0.22),
        (480.0, 0.045, 0.45),
        (365.0, 0.25, 0.65),
        (285.0, 0.3, 0.5),
    )
    return LorentzIndex(
        name="oscillators",
        source=(
            "a model of Lorentz oscillators, not a measurement: bands after D. M. Sherman, T. D. "
            "Waite, American Mineralogist 70, 1262-1269 (1985) and R. M. Cornell, U. Schwertmann, "
            "The Iron Oxides (2003); n held to optical mineralogy; strengths chosen"
        ),
        range_nm=(300.0, 2600.0),
        high_energy_permittivity=4.66,
        oscillators=tuple(
            LorentzOscillator(HC_EV_NM / w, f, g) for w, f, g in wavelength_strength_width
        ),
    )
