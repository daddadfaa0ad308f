"""Complex refractive index n + i k (k ≥ 0) as a function of wavelength.

The index is a constant, a table, a Sellmeier formula without absorption, or one of these with k
scaled.  Between tabulated wavelengths, n and log k are linear in log wavelength, because k spans
ten orders of magnitude and its tables are coarse where the absorption of water varies most
steeply.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np

from splits.core.arrays import ContentEquality, as_float_array, check_array_range
from splits.core.inputs import check_table_wavelengths
from splits.core.validation import (
    InvalidValue,
    check_range,
    check_relations,
    invalid,
    snap_to_limits,
)


class RefractiveIndex(Protocol):
    """Protocol of the complex refractive index of a material."""

    @property
    def name(self) -> str:
        """Name of the table or constant."""

    @property
    def source(self) -> str:
        """Source of the values."""

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return complex n + i k at the vacuum wavelengths `wavelength_nm` (nm)."""


def check_wavelength_range(wavelength_nm: Any, low: float, high: float, name: str) -> np.ndarray:
    """Return wavelengths (nm) as an array, checked against the range of `name`."""
    w = snap_to_limits(as_float_array("wavelength_nm", wavelength_nm, allow_gaps=True), low, high)
    inside = (w >= low) & (w <= high)
    if not inside.all():
        # The example is near the wavelengths requested.
        valid = w[inside] if inside.sum() > 1 else np.array([low, high])
        first, last = math.ceil(valid.min()), math.floor(valid.max())
        raise invalid(
            "wavelength_nm",
            float(w[~inside].flat[0]),
            f"in [{low:g}, {high:g}] nm, the range of {name}",
            "give wavelengths within it, such as "
            f"wavelength_nm=range({first}, {last + 1}, 10), or choose other data",
        )
    return w


@dataclass(frozen=True)
class ConstantIndex:
    """Refractive index that does not depend on wavelength.

    Parameters
    ----------
    value : complex
        n + kj with n > 0 and k ≥ 0.
    name : str
        Name of the constant; by default its value.
    source : str
        Source of the value.
    """

    value: complex
    name: str = ""
    source: str = "given by the user"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.value) and self.value.real > 0.0 and self.value.imag >= 0.0):
            raise invalid("refractive_index", self.value, "n + kj with n > 0 and k >= 0")
        if not self.name:
            object.__setattr__(self, "name", f"{self.value.real:g}+{self.value.imag:g}j")

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return the constant, shaped like `wavelength_nm`."""
        return np.full(np.shape(wavelength_nm), self.value, dtype=complex)


@dataclass(frozen=True, repr=False, eq=False)
class TabulatedIndex(ContentEquality):
    """Tabulated refractive index, with n and log k interpolated in log wavelength.

    Parameters
    ----------
    name, source : str
        Name and source of the table.
    wavelength_nm, n, k : numpy.ndarray
        Vacuum wavelengths (nm, strictly increasing), n > 0, k ≥ 0.
    sha256 : str
        SHA-256 of the content of a user's file, otherwise empty.
    """

    name: str
    source: str
    wavelength_nm: np.ndarray
    n: np.ndarray
    k: np.ndarray
    sha256: str = ""

    def __post_init__(self) -> None:
        w, n, k = self.wavelength_nm, self.n, self.k
        key = f"refractive_index ({self.name})"
        if not (w.ndim == 1 and w.size >= 2 and w.shape == n.shape == k.shape):
            raise invalid(key, w.shape, "three columns of equal length, at least 2 rows")
        is_finite = np.isfinite([w, n, k]).all()
        check_relations(
            (
                is_finite and (np.diff(w) > 0).all() and w[0] > 0, key, "wavelength_nm",
                "finite, positive and strictly increasing",
            ),
            ((n > 0).all() and (k >= 0).all(), key, "n, k", "n > 0 and k >= 0 in every row"),
        )  # fmt: skip
        check_table_wavelengths(key, w)

    def __repr__(self) -> str:
        low, high = self.wavelength_nm[0], self.wavelength_nm[-1]
        return f"TabulatedIndex({self.name!r}, {low:g}-{high:g} nm)"

    @cached_property
    def _logarithms(self) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of the wavelengths, and of k where it is not 0."""
        return np.log(self.wavelength_nm), np.log(np.where(self.k > 0.0, self.k, 1.0))

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return complex n + i k; a wavelength outside the table raises ValueError."""
        w = check_wavelength_range(
            wavelength_nm, self.wavelength_nm[0], self.wavelength_nm[-1], self.name
        )
        x, (xp, log_k) = np.log(w), self._logarithms
        n = np.interp(x, xp, self.n)
        k = np.interp(x, xp, self.k)
        # Logarithmic where both neighbours absorb; linear next to a row with k = 0.
        row = np.clip(np.searchsorted(xp, x, side="right"), 1, xp.size - 1)
        logarithmic = (self.k[row - 1] > 0.0) & (self.k[row] > 0.0)
        k = np.where(logarithmic, np.exp(np.interp(x, xp, log_k)), k)
        return n + 1j * k


@dataclass(frozen=True)
class SellmeierIndex:
    """Sellmeier index of a transparent material: n² = 1 + constant + Σ B λ² / (λ² − C), λ in µm.

    Parameters
    ----------
    name, source : str
        Name and source of the formula.
    range_nm : (low, high)
        Range of validity in vacuum wavelength (nm).
    constant : float
    terms : sequence of (B, C)
        Strengths B and squared resonance wavelengths C (µm²).
    """

    name: str
    source: str
    range_nm: tuple[float, float]
    constant: float
    terms: tuple[tuple[float, float], ...]

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return complex n + 0i; a wavelength outside the range raises ValueError."""
        wavelength_squared = (
            check_wavelength_range(wavelength_nm, *self.range_nm, self.name) * 1e-3
        ) ** 2
        epsilon = (
            1.0
            + self.constant
            + sum(b * wavelength_squared / (wavelength_squared - c) for b, c in self.terms)
        )
        return np.sqrt(epsilon) + 0j


@dataclass(frozen=True)
class ScaledIndex:
    """Refractive index with k multiplied by a factor, to test the sensitivity to k.

    Parameters
    ----------
    index : RefractiveIndex
    k_factor : float
        Factor of k, above 0.
    """

    index: RefractiveIndex
    k_factor: float

    def __post_init__(self) -> None:
        check_range("k_factor", self.k_factor, 0.0, np.inf, open_low=True)

    @property
    def name(self) -> str:
        """Name of the index and the factor."""
        return f"{self.index.name}, k x {self.k_factor:g}"

    @property
    def source(self) -> str:
        """Source of the values before scaling."""
        return f"k multiplied by {self.k_factor:g}; {self.index.source}"

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return complex n + i k_factor k."""
        index = self.index(wavelength_nm)
        return index.real + 1j * (self.k_factor * index.imag)


# --------------------------------------------------------------------------------------------------
# Complex refractive indices of Lorentz oscillator models, such as that of goethite.

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
    found.  A user's table can replace it (see `splits.materials.library`).

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


# --------------------------------------------------------------------------------------------------
# Complex refractive index of a matrix with small inclusions of another material.


def _check_arguments(matrix: Any, inclusion: Any, fraction: Any) -> tuple[np.ndarray, ...]:
    numbers = as_float_array("fraction", fraction, "in [0, 1]")
    fractions = check_array_range("fraction", numbers, 0.0, 1.0)
    return np.asarray(matrix, dtype=complex), np.asarray(inclusion, dtype=complex), fractions


def maxwell_garnett(matrix: Any, inclusion: Any, fraction: Any) -> np.ndarray:
    """Return the effective refractive index of small spheres in a matrix (Maxwell Garnett).

    With dielectric constants ε = m², ε = ε_m (ε_i + 2ε_m + 2f (ε_i − ε_m)) /
    (ε_i + 2ε_m − f (ε_i − ε_m)); the index is the root with n > 0 and k ≥ 0.  The spheres are small
    compared to the wavelength.

    Parameters
    ----------
    matrix, inclusion : complex array_like
        Refractive indices n + i k with n > 0, k ≥ 0.
    fraction : array_like
        Volume of the inclusions per volume of the mixture, 0 to 1.  All three broadcast.

    Raises
    ------
    ValueError
        For a fraction outside [0, 1].

    References
    ----------
    SPLITS (Kimmel & Baranoski 2007) section 4.2.4 Eq 4; Maxwell Garnett 1904, Philosophical
    Transactions of the Royal Society A 203, 385-420.
    """
    m, i, f = _check_arguments(matrix, inclusion, fraction)
    outer, inner = m * m, i * i
    contrast, total = (i - m) * (i + m), inner + 2.0 * outer
    # The formula above, written as the distance from the nearer pure material, so that k of the
    # mixture keeps its digits even if all absorption is due to a trace of one material.
    scale = contrast / (total - f * contrast)
    epsilon = np.where(f < 0.5, outer + 3.0 * f * outer * scale, inner - (1.0 - f) * total * scale)
    root = np.sqrt(epsilon)
    # Rounding may make k slightly negative where neither material absorbs.
    mixture = root.real + 1j * np.maximum(root.imag, 0.0)
    return np.where(f == 0.0, m, np.where(f == 1.0, i, mixture))


def linear_mixing(matrix: Any, inclusion: Any, fraction: Any) -> np.ndarray:
    """Return the volume-weighted mean of two refractive indices.

    Parameters
    ----------
    matrix, inclusion : complex array_like
        Refractive indices n + i k.
    fraction : array_like
        Volume of the inclusions per volume of the mixture, 0 to 1.  All three broadcast.

    Raises
    ------
    ValueError
        For a fraction outside [0, 1].
    """
    m, i, f = _check_arguments(matrix, inclusion, fraction)
    return (1.0 - f) * m + f * i


MIXING_RULES: Mapping[str, Callable[[Any, Any, Any], np.ndarray]] = MappingProxyType(
    {"maxwell_garnett": maxwell_garnett, "linear": linear_mixing}
)
"""Mixing rules by name."""


# --------------------------------------------------------------------------------------------------
# Group index of materials, from the dispersion of their refractive index.
#
# Tables of water are too coarse for its dispersion in the visible.  There, that of the formulation
# of IAPWS is used (IAPWS R9-97, Release on the Refractive Index of Ordinary Water Substance as a
# Function of Wavelength, Temperature and Pressure, 1997; Harvey, Gallagher & Levelt Sengers 1998,
# J. Phys. Chem. Ref. Data 27, 761).

FIT_HALF_WIDTH = 0.08
"""Half width of the fit of the dispersion, in ln λ: tables have rounded values at steps of 2 to 4 %
and are interpolated linearly."""
N_FIT_POINTS = 33

WATER_RANGE_NM = (200.0, 1100.0)
"""Range of wavelengths of the formulation of IAPWS."""
COLD_WATER, WARM_WATER = (273.15, 999.84), (293.15, 998.21)
"""Temperature (K) and density (kg/m³) of water at 0 and 20 °C and atmospheric pressure."""
_IAPWS = (
    0.244257733, 9.74634476e-3, -3.73234996e-3, 2.68678472e-4, 1.58920570e-3, 2.45934259e-3,
    0.900704920, -1.66626219e-2,
)  # fmt: skip
_ULTRAVIOLET, _INFRARED = 0.2292020, 5.432937
_WATER_ERROR = (
    (200.0, 210.0, 230.0, 250.0, 300.0, 400.0, 800.0, 1000.0, 1100.0),
    (1e-2, 2e-3, 1e-3, 1e-3, 4e-4, 1e-4, 1e-4, 3e-4, 5e-4),
)
"""Wavelengths (nm) and largest difference there from the group index by Daimon & Masumura (2007,
Applied Optics 46, 3811, at 19 and 21.5 °C)."""


class GroupIndex(NamedTuple):
    """Group index and its error.

    Attributes
    ----------
    value, stderr : float, shape (wavelengths, materials)
    """

    value: np.ndarray
    stderr: np.ndarray


def compute_group_index(
    compute_index: Callable[[np.ndarray], np.ndarray], wavelength_nm: np.ndarray
) -> GroupIndex:
    """Return the group index n − λ dn/dλ of materials.

    The dispersion is the slope of a parabola that is fitted to n over ln λ.  The error follows
    from the difference from the slope over half the range, and from the change of the slope there.

    Parameters
    ----------
    compute_index : callable
        Returns complex refractive indices, shape (wavelengths, materials), at wavelengths (nm).
    wavelength_nm : float, shape (wavelengths,)

    Raises
    ------
    ValueError
        If an index is not known within 8 % of a wavelength.
    """
    index = compute_index(wavelength_nm).real
    steps = np.linspace(-FIT_HALF_WIDTH, FIT_HALF_WIDTH, N_FIT_POINTS)
    inner = np.abs(steps) <= 0.5 * FIT_HALF_WIDTH * (1.0 + 1e-9)
    slopes, errors = [], []
    for wavelength in wavelength_nm:
        try:
            values = compute_index(wavelength * np.exp(steps)).real
        except InvalidValue as error:
            # An error at the wavelength itself says more.
            compute_index(np.array([wavelength]))
            known = str(error).partition("must be ")[2].partition(" (")[0]
            raise invalid(
                "wavelength_nm", float(wavelength),
                f"{100 * FIT_HALF_WIDTH:.0f} % inside the range of all refractive indices",
                f"their dispersion gives the group velocity; one of them is known {known}",
            ) from None  # fmt: skip
        wide, narrow, left, right = (
            np.polynomial.polynomial.polyfit(steps[part], values[part], degree)[1]
            for part, degree in (
                (steps == steps, 2), (inner, 2), (inner & (steps <= 0.0), 1),
                (inner & (steps >= 0.0), 1),
            )
        )  # fmt: skip
        slopes.append(wide)
        # The error of a slope is proportional to the square of the range; at a kink, slopes differ.
        errors.append(np.hypot(4.0 / 3.0 * (wide - narrow), 0.5 * (right - left)))
    return GroupIndex(index - np.array(slopes), np.array(errors))


def compute_water_group_index(wavelength_nm: np.ndarray, at_melting_point: bool) -> GroupIndex:
    """Return the group index of liquid water by IAPWS R9-97.

    Parameters
    ----------
    wavelength_nm : float, shape (wavelengths,)
        Vacuum wavelengths in `WATER_RANGE_NM`.
    at_melting_point : bool
        Whether the water has 0 °C.  Otherwise its temperature is unknown: the value is the mean of
        those at 0 and at 20 °C, and the error includes half of their difference.

    Returns
    -------
    GroupIndex
        Of shape (wavelengths,).
    """
    cold, warm = (_compute_iapws(wavelength_nm, *state) for state in (COLD_WATER, WARM_WATER))
    error = np.interp(wavelength_nm, *_WATER_ERROR)
    if at_melting_point:
        return GroupIndex(cold, error)
    return GroupIndex(0.5 * (cold + warm), np.hypot(error, 0.5 * (warm - cold)))


def compute_temperature_effect(wavelength_nm: np.ndarray) -> np.ndarray:
    """Return the difference between the group indices of water at 0 and at 20 °C."""
    cold, warm = (_compute_iapws(wavelength_nm, *state) for state in (COLD_WATER, WARM_WATER))
    return np.abs(cold - warm)


def _compute_iapws(wavelength_nm: np.ndarray, temperature_k: float, density: float) -> np.ndarray:
    """Return the group index at a temperature (K) and a density (kg/m³); Eq. 1 of the release."""
    a0, a1, a2, a3, a4, a5, a6, a7 = _IAPWS
    x, t, d = np.asarray(wavelength_nm) / 589.0, temperature_k / 273.15, density / 1000.0
    below, above = x**2 - _ULTRAVIOLET**2, x**2 - _INFRARED**2
    # (n² − 1)/(n² + 2), and its derivative times x.
    lorentz = d * (
        a0 + a1 * d + a2 * t + a3 * x**2 * t + a4 / x**2 + a5 / below + a6 / above + a7 * d**2
    )
    slope = 2.0 * d * (a3 * x**2 * t - a4 / x**2 - a5 * x**2 / below**2 - a6 * x**2 / above**2)
    index = np.sqrt((1.0 + 2.0 * lorentz) / (1.0 - lorentz))
    return np.asarray(index - 1.5 * slope / (index * (1.0 - lorentz) ** 2))
