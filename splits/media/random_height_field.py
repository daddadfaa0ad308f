"""Random height field: a correlated Gaussian surface by its height spectrum."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from splits.core.arrays import as_float_array, read_columns
from splits.core.equality import ContentEquality
from splits.core.keywords import reject_unknown_keywords
from splits.core.validation import (
    check_choice,
    check_integer,
    check_range,
    invalid,
    snap_to_limits,
)
from splits.media.formatting import format_call
from splits.media.height_spectra import (
    CORRELATIONS,
    HEIGHT_SPECTRA,
    average_bessel_j0,
    average_over_quantiles,
    compute_quantiles,
    integrate_bessel_j0,
)


@reject_unknown_keywords
@dataclass(frozen=True, eq=False, repr=False)
class RandomHeightField(ContentEquality):
    """Random height field, Budak & Grimailo 2020, Eq 3.

    Parameters
    ----------
    rms_height_m : float
        Standard deviation of heights σ (m), 0 to 1e6.
    wave_number_per_m : float, optional
        k0 (1/m), 1e-9 to 1e9; required unless `correlation` is "spectrum".
    correlation : {"exponential", "exponential_printed", "gaussian", "spectrum"}
        Correlation of heights.  "exponential": exp(−k0 r).  "exponential_printed": that of the
        distribution of wave numbers as printed, λ = k0 β/√(1 − β²), which is
        x (I0(x) K1(x) − I1(x) K0(x)) with x = k0 r/2.  "gaussian": exp(−(k0 r)²).  "spectrum":
        that of the tabulated spectrum.
    waves : int
        Number of waves M, 1 to 100 000.
    band_limit_per_m : float, optional
        Largest wave number (1/m), from k0/1000 to infinity; σ does not change.  It is required for
        "exponential".  Without a limit the rms slope of "exponential" and, more slowly, that of
        "exponential_printed" grow with the number of waves, and reflectance changes with them.
    spectrum : mapping, optional
        Columns ``wave_number_per_m``, increasing, and ``density``, the isotropic spectral density
        p up to a factor, with linear interpolation.  The fraction of the variance in dλ is
        ∝ p(λ) λ dλ.

    Raises
    ------
    ValueError
        For a value outside its range; the message names key, value and range.
    """

    rms_height_m: float
    wave_number_per_m: float | None = None
    correlation: str = "exponential"
    waves: int = 64
    band_limit_per_m: float | None = None
    spectrum: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        put("rms_height_m", check_range("rms_height_m", self.rms_height_m, 0.0, 1e6, "m"))
        check_choice("correlation", self.correlation, CORRELATIONS)
        put("waves", check_integer("waves", self.waves, 1, MAX_WAVES))
        if self.correlation == "spectrum":
            for key in ("wave_number_per_m", "band_limit_per_m"):
                if getattr(self, key) is not None:
                    raise invalid(key, getattr(self, key), "left out", "the spectrum has its own")
            put("spectrum", _read_spectrum(self.spectrum))
            return
        if self.spectrum is not None:
            raise invalid("spectrum", self.spectrum, 'left out unless correlation is "spectrum"')
        key, k0 = "wave_number_per_m", self.wave_number_per_m
        if k0 is None:
            raise invalid(key, None, "given (1/m)", "the inverse of the correlation length")
        put(key, k0 := check_range(key, k0, 1e-9, 1e9, "1/m"))
        key, limit = "band_limit_per_m", self.band_limit_per_m
        if limit is None and self.correlation == "exponential":
            raise invalid(
                key, None, "given (1/m)",
                "slopes, about rms_height_m √(k0 limit), grow without bound with it and change "
                "reflectance; give the largest wave number of the surface, or infinity; only the "
                'default correlation "exponential" needs it, "gaussian" does not',
            )  # fmt: skip
        if limit is None or limit == math.inf:
            put(key, math.inf)
        else:
            put(key, check_range(key, limit, 1e-3 * k0, math.inf, "1/m"))

    def as_input(self) -> dict[str, Any]:
        """Return the keywords that differ from their defaults."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        # Only the exponential correlation requires a limit, so an infinite one is shown.
        if self.band_limit_per_m == math.inf and self.correlation != "exponential":
            del values["band_limit_per_m"]
        defaults = {field.name: field.default for field in fields(self)}
        return {name: value for name, value in values.items() if value != defaults[name]}

    def __repr__(self) -> str:
        """Return the call that constructs the field, on one line."""
        return format_call("RandomHeightField", self.as_input())

    @property
    def _relative_band_limit(self) -> float:
        """Band limit in units of k0."""
        assert self.band_limit_per_m is not None and self.wave_number_per_m is not None
        return self.band_limit_per_m / self.wave_number_per_m

    @cached_property
    def wave_number_quantiles(self) -> np.ndarray:
        """Quantile function of the wave numbers (1/m) at `rng.make_table_probabilities`."""
        assert self.spectrum is not None
        return compute_quantiles(*(np.array(self.spectrum[key]) for key in SPECTRUM_COLUMNS))

    def compute_correlation(self, r_m: np.ndarray) -> np.ndarray:
        """Return the expected correlation of heights at distances (m) for sampled waves."""
        r = as_float_array("r_m", r_m, "numbers in metres")
        if self.correlation == "spectrum":
            return np.array(
                [average_bessel_j0(self.wave_number_quantiles, x) for x in r.ravel()]
            ).reshape(r.shape)
        spectrum = HEIGHT_SPECTRA[self.correlation]
        assert self.wave_number_per_m is not None
        r = self.wave_number_per_m * r
        if spectrum.cdf(self._relative_band_limit) == 1.0:
            return spectrum.correlation(r)
        integrals = [
            integrate_bessel_j0(spectrum.density, self._relative_band_limit, x) for x in r.ravel()
        ]
        return np.array(integrals).reshape(r.shape) / spectrum.cdf(self._relative_band_limit)

    def mean_square_wave_number(self) -> float:
        """Return the mean λ² of a wave (1/m²)."""
        if self.correlation == "spectrum":
            return average_over_quantiles(self.wave_number_quantiles, lambda k: k * k)
        assert self.wave_number_per_m is not None
        return self.wave_number_per_m**2 * HEIGHT_SPECTRA[self.correlation].mean_square(
            self._relative_band_limit
        )


MAX_WAVES = 100_000
SPECTRUM_COLUMNS = ("wave_number_per_m", "density")


def _read_spectrum(given: Any) -> dict[str, tuple[float, ...]]:
    """Return the validated columns of a spectrum."""
    allowed = "a mapping of equally many numbers " + " and ".join(SPECTRUM_COLUMNS)
    if not isinstance(given, Mapping) or set(given) != set(SPECTRUM_COLUMNS):
        raise invalid("spectrum", given, allowed)
    k, density = read_columns("spectrum", {key: given[key] for key in SPECTRUM_COLUMNS})
    if k.shape != density.shape or k.size < 2:
        raise invalid("spectrum", dict(given), allowed, "two rows at least")
    k, density = (snap_to_limits(row, 0.0, math.inf) for row in (k, density))
    if k[0] < 0.0 or (np.diff(k) <= 0.0).any():
        raise invalid("spectrum.wave_number_per_m", k.tolist(), "0 or more and increasing")
    if (density < 0.0).any() or not density[k > 0.0].any():
        raise invalid("spectrum.density", density.tolist(), "0 or more, and positive somewhere")
    return dict(zip(SPECTRUM_COLUMNS, (tuple(k.tolist()), tuple(density.tolist())), strict=True))
