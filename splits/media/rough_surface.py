"""Randomly rough surfaces: heights, correlation and number of waves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from numbers import Integral
from typing import Any

import numpy as np

from splits.core.arrays import as_float_array, read_columns
from splits.core.equality import ContentEquality
from splits.core.validation import (
    NON_NUMERIC_TYPES,
    as_scalar,
    check_choice,
    check_range,
    invalid,
    key_prefix,
    reject_unknown_keywords,
    snap_to_limits,
    suggest_name,
)
from splits.kernels.math.rng import start_stream
from splits.kernels.rough_surface import realization as kernels
from splits.media.formatting import format_call, format_input
from splits.media.height_spectra import (
    CORRELATIONS,
    HEIGHT_SPECTRA,
    N_QUANTILES,
    average_bessel_j0,
    average_over_quantiles,
    compute_quantiles,
    integrate_bessel_j0,
)

MAX_WAVES = 100_000
_SPECTRUM_COLUMNS = ("wave_number_per_m", "density")


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
        put("waves", _check_integer("waves", self.waves, MAX_WAVES))
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
        return compute_quantiles(*(np.array(self.spectrum[key]) for key in _SPECTRUM_COLUMNS))

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


@reject_unknown_keywords
@dataclass(frozen=True, repr=False)
class RoughSurface:
    """Rough surface: a superposition of random height fields above a plane.

    Parameters
    ----------
    fields : RandomHeightField, mapping or sequence of them
        One height field or several; a mapping holds the keywords of `RandomHeightField`.

    Examples
    --------
    >>> from splits.media.rough_surface import RoughSurface
    >>> sea = RoughSurface({"rms_height_m": 0.1, "wave_number_per_m": 2, "correlation": "gaussian"})
    >>> round(sea.rms_slope(), 12)
    0.4
    """

    fields: Any

    def __post_init__(self) -> None:
        given = self.fields
        if isinstance(given, (RandomHeightField, Mapping)):
            given = [given]
        if isinstance(given, (str, bytes)) or not isinstance(given, Sequence) or not given:
            raise invalid("surface", given, "one field, or a list of fields, of keys and values")
        keys = [f"surface[{i}]" for i in range(len(given))] if len(given) > 1 else ["surface"]
        height_fields = tuple(_make_height_field(*pair) for pair in zip(keys, given, strict=True))
        object.__setattr__(self, "fields", height_fields)

    @classmethod
    def from_input(cls, value: Any) -> RoughSurface:
        """Return the surface for a `RoughSurface` or for its height fields."""
        return value if isinstance(value, cls) else cls(value)

    def as_input(self) -> Any:
        """Return the keywords of the field, or a list of them for several fields."""
        keywords = [field.as_input() for field in self.fields]
        return keywords[0] if len(keywords) == 1 else keywords

    def __repr__(self) -> str:
        """Return the call that constructs the surface, on one line."""
        return f"RoughSurface({format_input(self)})"

    @property
    def rms_height_m(self) -> float:
        """Standard deviation of heights (m)."""
        return math.hypot(*(field.rms_height_m for field in self.fields))

    def correlation(self, r_m: Any) -> np.ndarray:
        """Return the expected correlation of heights at distances (m); 1 for a plane."""
        r = as_float_array("r_m", r_m, "numbers in metres")
        if self.rms_height_m == 0.0:
            return np.ones_like(r)
        variance_fractions = (
            (field.rms_height_m / self.rms_height_m) ** 2 for field in self.fields
        )
        terms = zip(variance_fractions, self.fields, strict=True)
        return np.sum(
            [fraction * field.compute_correlation(r) for fraction, field in terms], axis=0
        )

    def rms_slope(self) -> float:
        """Return the rms slope √⟨|∇Ψ|²⟩; it may be infinite without a band limit."""
        rough = [field for field in self.fields if field.rms_height_m > 0.0]
        return math.sqrt(sum(f.rms_height_m**2 * f.mean_square_wave_number() for f in rough))

    def make_height_fields(self) -> kernels.HeightFields:
        """Return the surface in the form the kernels take."""
        n_fields = len(self.fields)
        law = np.full(n_fields, kernels.TABULATED, dtype=np.int64)
        wave_numbers, band_fraction = np.ones(n_fields), np.ones(n_fields)
        tabulated = any(field.spectrum is not None for field in self.fields)
        quantiles = np.zeros((n_fields, N_QUANTILES if tabulated else 2))
        for i, field in enumerate(self.fields):
            if field.spectrum is not None:
                quantiles[i] = field.wave_number_quantiles
                continue
            spectrum = HEIGHT_SPECTRA[field.correlation]
            law[i], wave_numbers[i] = spectrum.kernel_code, field.wave_number_per_m
            band_fraction[i] = spectrum.cdf(field._relative_band_limit)
        return kernels.HeightFields(
            rms_height=np.array([field.rms_height_m for field in self.fields]),
            n_waves=np.array([field.waves for field in self.fields], dtype=np.int64),
            law=law,
            wave_number=wave_numbers,
            band_fraction=band_fraction,
            quantiles=quantiles,
        )

    def sample_realization(self, seed: int, ray_number: int = 0) -> np.ndarray:
        """Return the waves of the realization that ray `ray_number` of ensemble 0 samples first.

        The rows are those of `splits.kernels.rough_surface.realization`, which evaluates them.
        """
        seed, ray_number = (
            _check_integer("seed", seed, low=0),
            _check_integer("number", ray_number, low=0),
        )
        state = np.zeros(1, dtype=np.uint64)
        start_stream(state, seed, 0, ray_number)
        height_fields = self.make_height_fields()
        waves: np.ndarray = kernels.sample_realization(
            state, height_fields, kernels.allocate_realization(height_fields)
        ).waves
        return waves

    def describe(self) -> dict[str, Any]:
        """Return the inputs, a list each, and the rms slope as dataset attributes."""
        inputs: dict[str, Any] = {}
        for key in (f.name for f in fields(RandomHeightField) if f.name != "spectrum"):
            values = [getattr(field, key) for field in self.fields]
            # No band limit means an infinite one; tabulated spectra have no k0.
            missing = math.inf if key == "band_limit_per_m" else 0.0
            inputs[key] = [missing if value is None else value for value in values]
        inputs["correlation"] = ", ".join(inputs["correlation"])
        tables = [field.spectrum for field in self.fields if field.spectrum is not None]
        for key in _SPECTRUM_COLUMNS if tables else ():
            inputs[f"spectrum_{key}"] = [x for table in tables for x in table[key]]
        return inputs | {"rms_slope": self.rms_slope()}


def _make_height_field(key: str, value: Any) -> RandomHeightField:
    """Return a height field; errors carry `key`."""
    if isinstance(value, RandomHeightField):
        return value
    names = [f.name for f in fields(RandomHeightField)]
    allowed = "one of " + ", ".join(names)
    if not isinstance(value, Mapping):
        raise invalid(key, value, "a mapping of keys, each " + allowed)
    for name in value:
        if name not in names:
            raise invalid(key, name, allowed, suggest_name(name, names))
    if "rms_height_m" not in value:
        raise invalid(f"{key}.rms_height_m", None, "given (m)")
    with key_prefix(key):
        return RandomHeightField(**value)


def _check_integer(key: str, value: Any, high: int = 2**63 - 1, low: int = 1) -> int:
    """Return a whole number within limits."""
    value = as_scalar(value)
    is_integer = isinstance(value, Integral) and not isinstance(value, NON_NUMERIC_TYPES)
    if not is_integer or not low <= int(value) <= high:
        raise invalid(key, value, f"a whole number from {low} to {high}")
    return int(value)


def _read_spectrum(given: Any) -> dict[str, tuple[float, ...]]:
    """Return the validated columns of a spectrum."""
    allowed = "a mapping of equally many numbers " + " and ".join(_SPECTRUM_COLUMNS)
    if not isinstance(given, Mapping) or set(given) != set(_SPECTRUM_COLUMNS):
        raise invalid("spectrum", given, allowed)
    k, density = read_columns("spectrum", {key: given[key] for key in _SPECTRUM_COLUMNS})
    if k.shape != density.shape or k.size < 2:
        raise invalid("spectrum", dict(given), allowed, "two rows at least")
    k, density = (snap_to_limits(row, 0.0, math.inf) for row in (k, density))
    if k[0] < 0.0 or (np.diff(k) <= 0.0).any():
        raise invalid("spectrum.wave_number_per_m", k.tolist(), "0 or more and increasing")
    if (density < 0.0).any() or not density[k > 0.0].any():
        raise invalid("spectrum.density", density.tolist(), "0 or more, and positive somewhere")
    return dict(zip(_SPECTRUM_COLUMNS, (tuple(k.tolist()), tuple(density.tolist())), strict=True))
