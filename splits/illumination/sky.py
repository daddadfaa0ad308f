"""Spectral irradiance of skies on a horizontal surface: direct sunlight and diffuse light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splits.core.arrays import check_array_range, check_increasing, read_columns
from splits.core.equality import ContentEquality
from splits.core.validation import check_range, invalid
from splits.illumination.bands import SpectralBand, as_bands, interpolate_locally
from splits.materials.refractive_index import check_wavelength_range

SKY_COLUMNS = ("wavelength_nm", "direct", "diffuse")
BROADBAND = "broadband"
MAX_ZENITH_DEG = 89.0


@dataclass(frozen=True, eq=False, repr=False)
class Sky(ContentEquality):
    """Light on a horizontal surface.

    Attributes
    ----------
    name, source : str
    zenith_deg : float
        Polar angle of the sun.
    wavelength_nm : float, shape (n,)
        Strictly increasing (nm).
    direct, diffuse : float, shape (n,)
        Spectral irradiance (W m⁻² nm⁻¹); for albedos only ratios matter.
    relative : bool
        Whether irradiances are in arbitrary units.
    sha256 : str
        SHA-256 of a user's file, otherwise empty.
    """

    name: str
    source: str
    zenith_deg: float
    wavelength_nm: np.ndarray
    direct: np.ndarray
    diffuse: np.ndarray
    sha256: str = ""
    relative: bool = False

    def __post_init__(self) -> None:
        def set_attribute(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        zenith = check_range("zenith_deg", self.zenith_deg, 0.0, MAX_ZENITH_DEG, "degrees")
        set_attribute("zenith_deg", zenith)
        columns = {key: getattr(self, key) for key in SKY_COLUMNS}
        wavelengths, *light = read_columns("sky", columns)
        check_increasing("sky.wavelength_nm", wavelengths)
        if not wavelengths.size == light[0].size == light[1].size >= 2:
            sizes = f"{wavelengths.size}, {light[0].size} and {light[1].size} numbers"
            raise invalid("sky", sizes, "three lists of the same length, at least 2")
        for key, values in zip(SKY_COLUMNS, (wavelengths, *light), strict=True):
            set_attribute(key, check_array_range(f"sky.{key}", values, 0.0, np.inf))
        if not self.total.any():
            raise invalid("sky", "0 everywhere", "light at some wavelength")

    def __repr__(self) -> str:
        """Return the sky on one line."""
        first, last = self.wavelength_nm[[0, -1]]
        limits = f"{first:g} to {last:g} nm"
        return f"Sky({self.name!r}, zenith_deg={self.zenith_deg:g}, {limits}: {self.source})"

    @property
    def total(self) -> np.ndarray:
        """Sum of direct and diffuse irradiance."""
        return self.direct + self.diffuse

    def scale_to(self, total_w_m2: float | None) -> Sky:
        """Return this sky scaled to an irradiance over all its wavelengths (W m⁻²).

        Raises
        ------
        ValueError
            If the irradiance is out of range, or missing for a sky in relative units.
        """
        if total_w_m2 is None:
            if self.relative:
                hint = f"irradiances of {self.name} are relative"
                raise invalid(
                    "total_w_m2", None, "given: the irradiance of all light (W m-2)", hint
                )
            return self
        total = check_range("total_w_m2", total_w_m2, 0.0, 1e5, "W m-2", open_low=True)
        factor = (
            total / self.compute_weights(self.wavelength_nm, self.make_bands(None)[BROADBAND]).sum()
        )
        direct, diffuse = factor * self.direct, factor * self.diffuse
        return replace(self, direct=direct, diffuse=diffuse, relative=False)

    def check_coverage(self, wavelength_nm: np.ndarray) -> None:
        """Check that wavelengths (nm) are within the spectrum of this sky."""
        first, last = self.wavelength_nm[[0, -1]]
        check_wavelength_range(wavelength_nm, first, last, f"the sky {self.name}")

    def compute_direct_fraction(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the fraction of direct sunlight by wavelength (nm)."""
        self.check_coverage(wavelength_nm)
        direct, total = (
            np.interp(wavelength_nm, self.wavelength_nm, values)
            for values in (self.direct, self.total)
        )
        # Without light the fraction has no effect.
        return np.divide(direct, total, out=np.zeros_like(total), where=total > 0.0)

    def make_bands(self, bands: Any) -> dict[str, SpectralBand]:
        """Return the bands of a user's value, after the broadband one.

        Raises
        ------
        ValueError
            For a malformed band, or one with the name of the broadband one.
        """
        user_bands = as_bands(bands)
        if BROADBAND in user_bands:
            raise invalid(
                f"bands.{BROADBAND}",
                user_bands[BROADBAND].limits_nm,
                "left out: it is always included",
            )
        return {BROADBAND: SpectralBand.from_limits(*self.wavelength_nm[[0, -1]]), **user_bands}

    def check_bands(self, bands: Mapping[str, SpectralBand], wavelength_nm: np.ndarray) -> None:
        """Check that all bands have light within the wavelengths (nm)."""
        for name, band in bands.items():
            if not self.compute_weights(wavelength_nm, band).any():
                first, last = wavelength_nm[[0, -1]]
                allowed = f"bands with light between {first:g} and {last:g} nm"
                hint = "give more wavelengths, or only some bands of a sensor"
                raise invalid(f"bands.{name}", band.limits_nm, allowed, hint)

    def compute_weights(
        self, wavelength_nm: np.ndarray, band: SpectralBand, n_nodes: int = 2
    ) -> np.ndarray:
        """Return the irradiance of a band by wavelength (nm), as weights for an average.

        An albedo is assumed to be 0 outside the wavelengths, and between them the polynomial
        through the nearest ones, 2 for a linear one.  Weights are the integrals of irradiance times
        response times the weights of these polynomials.
        """
        low, high = band.limits_nm
        nodes = np.concatenate([wavelength_nm, self.wavelength_nm, band.wavelength_nm])
        inside = (nodes >= max(low, wavelength_nm[0])) & (nodes <= min(high, wavelength_nm[-1]))
        nodes = np.unique(nodes[inside])
        if nodes.size < 2 or wavelength_nm.size < 2:
            return np.zeros(wavelength_nm.size)
        # Where all three factors are linear between nodes, Simpson's rule is exact.
        nodes = np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))
        step = nodes[2::2] - nodes[:-2:2]
        simpson = np.zeros(nodes.size)
        for points, coefficient in (
            (slice(0, -2, 2), 1.0),
            (slice(1, -1, 2), 4.0),
            (slice(2, None, 2), 1.0),
        ):
            simpson[points] += coefficient * step / 6.0
        integrand = simpson * np.interp(nodes, self.wavelength_nm, self.total)
        integrand *= np.interp(nodes, band.wavelength_nm, band.response)
        weights: np.ndarray = integrand @ interpolate_locally(wavelength_nm, nodes, n_nodes)
        return weights
