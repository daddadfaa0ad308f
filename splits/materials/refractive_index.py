"""Complex refractive index n + i k (k ≥ 0) as a function of wavelength.

The index is a constant, a table, a Sellmeier formula without absorption, or one of these with k
scaled.  Between tabulated wavelengths, n and log k are linear in log wavelength, because k spans
ten orders of magnitude and its tables are coarse where the absorption of water varies most
steeply.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from splits.core.arrays import as_float_array
from splits.core.equality import ContentEquality
from splits.core.validation import check_range, invalid, snap_to_limits


class RefractiveIndex(Protocol):
    """Protocol of the complex refractive index of a material."""

    @property
    def name(self) -> str:
        """Name of the table or constant."""
        ...

    @property
    def source(self) -> str:
        """Source of the values."""
        ...

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return complex n + i k at the vacuum wavelengths `wavelength_nm` (nm)."""
        ...


def check_wavelength_range(wavelength_nm: Any, low: float, high: float, name: str) -> np.ndarray:
    """Return wavelengths (nm) as an array, checked against the range of `name`."""
    w = snap_to_limits(as_float_array("wavelength_nm", wavelength_nm, allow_gaps=True), low, high)
    inside = (w >= low) & (w <= high)
    if not inside.all():
        raise invalid(
            "wavelength_nm",
            float(w[~inside].flat[0]),
            f"in [{low:g}, {high:g}] nm, the range of {name}",
            f"give wavelengths within it, such as {_suggest_wavelengths(w[inside], low, high)}, "
            "or choose other data",
        )
    return w


def _suggest_wavelengths(valid_wavelengths: np.ndarray, low: float, high: float) -> str:
    """Return an example of wavelengths in a range (nm), near those requested."""
    first, last = (
        (valid_wavelengths.min(), valid_wavelengths.max())
        if valid_wavelengths.size > 1
        else (low, high)
    )
    return f"wavelength_nm=range({math.ceil(first)}, {math.floor(last) + 1}, 10)"


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
        if not (np.isfinite([w, n, k]).all() and (np.diff(w) > 0).all() and w[0] > 0):
            raise invalid(key, "wavelength_nm", "finite, positive and strictly increasing")
        if not ((n > 0).all() and (k >= 0).all()):
            raise invalid(key, "n, k", "n > 0 and k >= 0 in every row")

    def __repr__(self) -> str:
        low, high = self.wavelength_nm[0], self.wavelength_nm[-1]
        return f"TabulatedIndex({self.name!r}, {low:g}-{high:g} nm)"

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return complex n + i k; a wavelength outside the table raises ValueError."""
        w = check_wavelength_range(
            wavelength_nm, self.wavelength_nm[0], self.wavelength_nm[-1], self.name
        )
        x, xp = np.log(w), np.log(self.wavelength_nm)
        n = np.interp(x, xp, self.n)
        k = np.interp(x, xp, self.k)
        # Logarithmic where both neighbours absorb; linear next to a row with k = 0.
        row = np.clip(np.searchsorted(xp, x, side="right"), 1, xp.size - 1)
        logarithmic = (self.k[row - 1] > 0.0) & (self.k[row] > 0.0)
        log_k = np.log(np.where(self.k > 0.0, self.k, 1.0))
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
