"""Skies over the snowpacks of a season: one for all, or one for each zenith angle of the sun.

A sky is computed for zenith angles in steps of `ZENITH_STEP_DEG`, at most `MAX_ZENITH_DEG`.  Its
spectrum and its fraction of direct light are those of the nearest step.  The incidence of the
sunlight on the snow is not rounded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.illumination.bands import SpectralBand
from splits.illumination.sky import BROADBAND, MAX_ZENITH_DEG, Sky
from splits.illumination.sky_spectra import ASTM_G173, CLEAR_SKY, sky
from splits.instruments.pack_run import DIFFUSE, SUN
from splits.instruments.sky_mixing import (
    as_sky,
    choose_wavelengths,
    compute_band_error_weights,
    compute_band_weights,
    make_sky_attributes,
)
from splits.media.snow_pack_input import ZENITH_KEY
from splits.media.snow_packs import SnowPacks

ZENITH_STEP_DEG = 0.05
"""Step of the zenith angle of the sun.

By rounding, a broadband albedo changes by less than 1e-4, and a spectral albedo by less than 5e-4.
"""


class PackSkies(NamedTuple):
    """Skies over the good snowpacks.

    Attributes
    ----------
    skies : list of Sky
    number : int, shape (good,)
        Position of the sky of each snowpack in the list.
    incidence : float or "diffuse" or "sun"
        Of the direct light.
    """

    skies: list[Sky]
    number: np.ndarray
    incidence: float | str

    @classmethod
    def from_input(cls, value: Any, packs: SnowPacks) -> PackSkies:
        """Return the skies for a user's value, see `splits.albedo`."""
        zenith = packs.dataset[ZENITH_KEY].values if ZENITH_KEY in packs.dataset else None
        make = _find_maker(value)
        if zenith is None and (callable(value) or (isinstance(value, str) and value == CLEAR_SKY)):
            allowed = f"a splits.Sky for snowpacks without {ZENITH_KEY}"
            raise invalid("sky", value, allowed, "or packs.with_sun_zenith(angles)")
        if make is None or zenith is None:
            one = as_sky(value)
            incidence: float | str = one.zenith_deg if one.direct.any() else DIFFUSE
            return cls([one], np.zeros(int(packs.is_good.sum()), dtype=int), incidence)
        steps = np.minimum(zenith[packs.is_good], MAX_ZENITH_DEG) / ZENITH_STEP_DEG
        values, number = np.unique(steps.round(), return_inverse=True)
        if not values.size:
            values = np.zeros(1)
        angles = np.minimum(values * ZENITH_STEP_DEG, MAX_ZENITH_DEG).round(9).tolist()
        skies = [_check_sky(make(angle)) for angle in angles]
        has_sun = any(one.direct.any() for one in skies)
        return cls(skies, number, SUN if has_sun else DIFFUSE)

    def choose_wavelengths(self, wavelength_nm: Any) -> np.ndarray:
        """Return the requested wavelengths (nm), or those by default, within all skies."""
        wavelengths = choose_wavelengths(wavelength_nm, self.skies[0], 2)
        for one in self.skies:
            one.check_coverage(wavelengths)
        return wavelengths

    def compute_direct_fraction(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the fraction of direct light, shape (good, wavelengths)."""
        fractions = [one.compute_direct_fraction(wavelength_nm) for one in self.skies]
        return np.array(fractions)[self.number]

    def compute_band_weights(
        self, bands: Mapping[str, SpectralBand], wavelength_nm: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the normalized weights of bands, those of errors, and the fractions covered.

        Parameters
        ----------
        bands : mapping
            Of the first sky; the broadband one is that of each.
        wavelength_nm : float, shape (wavelengths,)

        Returns
        -------
        weights : float, shape (skies, bands, wavelengths)
        error_weights : float, shape (skies, 2, bands, wavelengths)
            See `splits.instruments.sky_mixing.compute_band_error_weights`.
        covered : float, shape (skies, bands)
            Fractions of the light of bands.
        """
        weights, error_weights, covered = [], [], []
        for one in self.skies:
            broad = SpectralBand.from_limits(*one.wavelength_nm[[0, -1]])
            named = {**bands, BROADBAND: broad}
            own, whole = compute_band_weights(one, named, wavelength_nm)
            # Without light in a band its albedo is NaN.
            with np.errstate(invalid="ignore", divide="ignore"):
                weights.append(own / own.sum(axis=1, keepdims=True))
                covered.append(own.sum(axis=1) / whole)
            rows = compute_band_error_weights(one, named, wavelength_nm)
            error_weights.append(rows)
        return np.array(weights), np.array(error_weights), np.array(covered)

    def make_attributes(self) -> dict[str, Any]:
        """Return the attributes of the skies."""
        attributes = make_sky_attributes(self.skies[0])
        if self.incidence == SUN:
            attributes["zenith_deg"] = "sun zenith of each snowpack"
            attributes["sky_zenith_step_deg"] = ZENITH_STEP_DEG
        return attributes


def _find_maker(value: Any) -> Callable[[float], Sky] | None:
    """Return the function of the zenith angle that makes a sky, None for a sky of one angle."""
    if isinstance(value, Sky) or (isinstance(value, str) and value == ASTM_G173):
        return None
    if callable(value):
        return value
    return lambda zenith: sky(value, zenith)


def _check_sky(value: Any) -> Sky:
    """Return a sky made by a function of the user, after checking its type."""
    if not isinstance(value, Sky):
        raise invalid("sky", type(value).__name__, "a function that returns a splits.Sky")
    return value
