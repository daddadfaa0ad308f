"""Randomly rough surfaces: heights, correlation and number of waves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from splits.core.arrays import (
    ContentEquality,
    as_float_array,
    check_array_range,
    check_axis,
)
from splits.core.declarations import Quantity, declare_class, defer_check, list_inputs
from splits.core.validation import (
    check_integer,
    check_range,
    check_relations,
    invalid,
    key_prefix,
    to_text_keys,
)
from splits.kernels.scene import (
    EXPONENTIAL,
    EXPONENTIAL_AS_PRINTED,
    GAUSSIAN,
    TABULATED,
    HeightFields,
    make_table_probabilities,
)
from splits.materials.csv_table import read_tabulated_function
from splits.media.formatting import format_call, format_input

# --------------------------------------------------------------------------------------------------
# Wave-number distributions of rough surfaces and their correlations of heights.

N_QUANTILES = 4097
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(16)


class HeightSpectrum(NamedTuple):
    """Distribution of wave numbers, in units of k0.

    Attributes
    ----------
    kernel_code : int
        Code of the distribution in the kernels.
    cdf : callable
        Cumulative distribution function of λ.
    density : callable
        Probability density of λ.
    mean_square : callable
        Mean of λ² below a band limit.
    correlation : callable
        Correlation of heights at a distance, without a band limit.
    """

    kernel_code: int
    cdf: Callable[[float], float]
    density: Callable[[np.ndarray], np.ndarray]
    mean_square: Callable[[float], float]
    correlation: Callable[[np.ndarray], np.ndarray]


def _correlate_exponential_printed(r: np.ndarray) -> np.ndarray:
    """Return ∫ J0(λr) (1 + λ²)^(−3/2) dλ = x (I0(x) K1(x) − I1(x) K0(x)) with x = r/2."""
    from scipy.special import i0e, i1e, k0e, k1e

    x = np.where(r > 0.0, 0.5 * r, 1.0)
    products = i0e(x) * k1e(x) - i1e(x) * k0e(x)
    return np.where(r > 0.0, x * products, 1.0)


def _exponential_cdf(limit: float) -> float:
    """Return 1 − 1/√(1 + λ²) without cancellation."""
    root = math.hypot(1.0, limit)
    return 1.0 if math.isinf(limit) else limit / root * (limit / (1.0 + root))


def _gaussian_mean_square(limit: float) -> float:
    if math.isinf(limit):
        return 4.0
    e = 0.25 * limit * limit
    band_fraction = -math.expm1(-e)
    return 4.0 * (1.0 - e * math.exp(-e) / band_fraction)


HEIGHT_SPECTRA = {
    "exponential": HeightSpectrum(
        EXPONENTIAL,
        _exponential_cdf,
        lambda k: k * (1.0 + k * k) ** -1.5,
        lambda limit: math.hypot(1.0, limit) - 1.0,
        lambda r: np.exp(-r),
    ),
    "exponential_printed": HeightSpectrum(
        EXPONENTIAL_AS_PRINTED,
        lambda limit: 1.0 if math.isinf(limit) else limit / math.hypot(1.0, limit),
        lambda k: (1.0 + k * k) ** -1.5,
        lambda limit: math.asinh(limit) * math.hypot(1.0 / limit, 1.0) - 1.0,
        _correlate_exponential_printed,
    ),
    "gaussian": HeightSpectrum(
        GAUSSIAN,
        lambda limit: -math.expm1(-0.25 * limit * limit),
        lambda k: 0.5 * k * np.exp(-0.25 * k * k),
        _gaussian_mean_square,
        lambda r: np.exp(-r * r),
    ),
}
MAX_WAVES = 100_000
SPECTRUM_COLUMNS = ("wave_number_per_m", "density")


def average_over_quantiles(
    table: np.ndarray, function: Callable[[np.ndarray], np.ndarray], pieces: int = 1
) -> float:
    """Return the mean of a function of a variate given by a piecewise linear quantile table."""
    n_intervals = (table.size - 1) * pieces
    x = (np.arange(n_intervals)[:, None] + 0.5 * (1.0 + _GAUSS_NODES)) / n_intervals
    # Includes the derivative of the probabilities of `make_table_probabilities`.
    weight = 2.0 * np.minimum(x, 1.0 - x) * _GAUSS_WEIGHTS / n_intervals
    nodes = np.linspace(0.0, 1.0, table.size)
    return float((weight * function(np.interp(x, nodes, table))).sum())


def average_bessel_j0(table: np.ndarray, distance: float) -> float:
    """Return the mean of J0(λ r), in intervals shorter than a period."""
    from scipy.special import j0

    max_spacing = float(np.diff(table).max())
    return average_over_quantiles(
        table, lambda k: j0(k * distance), 1 + int(max_spacing * distance / math.pi)
    )


def integrate_bessel_j0(
    density: Callable[[np.ndarray], np.ndarray], limit: float, distance: float
) -> float:
    """Return ∫ J0(λr) density dλ from 0 to the limit, in intervals shorter than a period."""
    from scipy.special import j0

    octaves = 2.0 ** np.arange(-3.0, max(math.log2(limit), -2.0) + 1.0)
    edges = [
        np.array([0.0]),
        octaves,
        np.arange(0.0, limit, 2.0 * math.pi / max(distance, 1e-300))[1:],
    ]
    edge = np.unique(np.minimum(np.concatenate([*edges, [limit]]), limit))
    half = 0.5 * np.diff(edge)[:, None]
    k = edge[:-1, None] + half * (1.0 + _GAUSS_NODES)
    return float((half * _GAUSS_WEIGHTS * j0(k * distance) * density(k)).sum())


# --------------------------------------------------------------------------------------------------
# Random height field: a correlated Gaussian surface by its height spectrum.


HeightDeviation = Annotated[
    float, Quantity("standard deviation of heights", "m", low=0.0, high=1e6)
]
WaveNumber = Annotated[
    float | None, Quantity("wave number k0 of the correlation", "m-1", low=1e-9, high=1e9)
]
Correlation = Annotated[
    Literal["exponential", "exponential_printed", "gaussian", "spectrum"],
    Quantity("correlation of heights"),
]
WaveCount = Annotated[int, Quantity("number of waves", low=1, high=MAX_WAVES)]
BandLimit = Annotated[
    float | None,
    Quantity("largest wave number", "m-1", low=0.0, infinite=True, check=defer_check),
]
HeightSpectrumTable = Annotated[Any, Quantity("spectral density of heights")]


@declare_class
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

    rms_height_m: HeightDeviation
    wave_number_per_m: WaveNumber = None
    correlation: Correlation = "exponential"
    waves: WaveCount = 64
    band_limit_per_m: BandLimit = None
    spectrum: HeightSpectrumTable = None

    def __post_init__(self) -> None:
        if self.correlation == "spectrum":
            others = {"wave_number_per_m": self.wave_number_per_m,
                      "band_limit_per_m": self.band_limit_per_m}  # fmt: skip
            check_relations(
                *(
                    (value is None, key, value, "left out", "the spectrum has its own")
                    for key, value in others.items()
                ),
                (
                    isinstance(self.spectrum, Mapping), "spectrum", self.spectrum,
                    f"a mapping of {', '.join(SPECTRUM_COLUMNS)}, lists of the same length",
                ),
            )  # fmt: skip
            (k, density), _ = read_tabulated_function("spectrum", self.spectrum, SPECTRUM_COLUMNS)
            k = check_axis("spectrum.wave_number_per_m", k, 0.0, math.inf)
            density = check_array_range("spectrum.density", density, 0.0, math.inf)
            if not density[k > 0.0].any():
                allowed = "0 or more, and positive somewhere"
                raise invalid("spectrum.density", density.tolist(), allowed)
            columns = (tuple(k.tolist()), tuple(density.tolist()))
            table = dict(zip(SPECTRUM_COLUMNS, columns, strict=True))
            object.__setattr__(self, "spectrum", table)
            return
        k0, limit = self.wave_number_per_m, self.band_limit_per_m
        check_relations(
            (
                self.spectrum is None, "spectrum", self.spectrum,
                'left out unless correlation is "spectrum"',
            ),
            (
                k0 is not None, "wave_number_per_m", None, "given (1/m)",
                "the inverse of the correlation length",
            ),
            (
                limit is not None or self.correlation != "exponential",
                "band_limit_per_m", None, "given (1/m)",
                "slopes, about rms_height_m √(k0 limit), grow without bound with it and change "
                "reflectance; give the largest wave number of the surface, or infinity; only the "
                'default correlation "exponential" needs it, "gaussian" does not',
            ),
        )  # fmt: skip
        assert k0 is not None
        if limit is not None and not (isinstance(limit, float) and limit == math.inf):
            limit = check_range("band_limit_per_m", limit, 1e-3 * k0, math.inf, "1/m")
        object.__setattr__(self, "band_limit_per_m", math.inf if limit is None else limit)

    def as_input(self) -> dict[str, Any]:
        """Return the keywords that differ from their defaults."""
        values = {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if getattr(self, field.name) != field.default
        }
        # Only the exponential correlation requires a limit, so an infinite one is shown.
        if self.band_limit_per_m == math.inf and self.correlation != "exponential":
            del values["band_limit_per_m"]
        return values

    def __repr__(self) -> str:
        """Return the call that constructs the field, on one line."""
        return format_call("RandomHeightField", self.as_input())

    @property
    def _height_spectrum(self) -> tuple[HeightSpectrum, float, float]:
        """Distribution of wave numbers, k0 (1/m), and the band limit in units of k0."""
        assert self.band_limit_per_m is not None and self.wave_number_per_m is not None
        k0 = self.wave_number_per_m
        return HEIGHT_SPECTRA[self.correlation], k0, self.band_limit_per_m / k0

    @cached_property
    def wave_number_quantiles(self) -> np.ndarray:
        """Quantile function of the wave numbers (1/m) at `make_table_probabilities`.

        It is that of the density p(λ) λ, with p linear between the nodes of the spectrum.
        """
        assert self.spectrum is not None
        wave_number, density = (np.array(self.spectrum[key]) for key in SPECTRUM_COLUMNS)
        slope = np.diff(density) / np.diff(wave_number)

        def mass(interval: np.ndarray, upper: np.ndarray) -> np.ndarray:
            """Return ∫ p λ dλ from the start of an interval, exact for linear p."""
            step = upper - wave_number[interval]
            p, a = density[interval], wave_number[interval]
            return step * (
                p * a + step * (0.5 * (p + slope[interval] * a) + step * slope[interval] / 3.0)
            )

        intervals = np.arange(wave_number.size - 1)
        cumulative = np.concatenate([[0.0], np.cumsum(mass(intervals, wave_number[1:]))])
        target = make_table_probabilities(N_QUANTILES) * cumulative[-1]
        # Intervals without mass hold no quantiles except those at 0 and 1.
        interval = np.clip(
            np.searchsorted(cumulative, target, side="left") - 1, 0, wave_number.size - 2
        )
        first = np.flatnonzero(np.diff(cumulative) > 0.0)[0]
        interval = np.maximum(interval, first)
        low, high = wave_number[interval], wave_number[interval + 1]
        for _ in range(60):
            middle = 0.5 * (low + high)
            below = cumulative[interval] + mass(interval, middle) < target
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return 0.5 * (low + high)

    def compute_correlation(self, r_m: np.ndarray) -> np.ndarray:
        """Return the expected correlation of heights at distances (m) for sampled waves."""
        r = as_float_array("r_m", r_m, "numbers in metres")
        if self.correlation == "spectrum":
            return np.array(
                [average_bessel_j0(self.wave_number_quantiles, x) for x in r.ravel()]
            ).reshape(r.shape)
        spectrum, k0, limit = self._height_spectrum
        r = k0 * r
        if spectrum.cdf(limit) == 1.0:
            return spectrum.correlation(r)
        integrals = [integrate_bessel_j0(spectrum.density, limit, x) for x in r.ravel()]
        return np.array(integrals).reshape(r.shape) / spectrum.cdf(limit)

    def mean_square_wave_number(self) -> float:
        """Return the mean λ² of a wave (1/m²)."""
        if self.correlation == "spectrum":
            return average_over_quantiles(self.wave_number_quantiles, lambda k: k * k)
        spectrum, k0, limit = self._height_spectrum
        return k0**2 * spectrum.mean_square(limit)


# --------------------------------------------------------------------------------------------------
# Randomly rough surfaces: heights, correlation and number of waves.


def _check_fields(given: Any) -> tuple[RandomHeightField, ...]:
    """Return the height fields of a surface, after checking each."""
    if isinstance(given, (RandomHeightField, Mapping)):
        given = [given]
    if isinstance(given, (str, bytes)) or not isinstance(given, Sequence) or not given:
        raise invalid("surface", given, "one field, or a list of fields, of keys and values")
    allowed = "a mapping of keys, each one of " + ", ".join(list_inputs(RandomHeightField))
    height_fields = []
    for number, value in enumerate(given):
        key = f"surface[{number}]" if len(given) > 1 else "surface"
        if not isinstance(value, RandomHeightField):
            if not isinstance(value, Mapping):
                raise invalid(key, value, allowed)
            with key_prefix(key):
                value = RandomHeightField(**to_text_keys("", value))
        height_fields.append(value)
    return tuple(height_fields)


Fields = Annotated[Any, Quantity("random height fields", schema={"type": ["object", "array"]})]


@declare_class
class RoughSurface(ContentEquality):
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

    fields: Fields

    def __post_init__(self) -> None:
        object.__setattr__(self, "fields", _check_fields(self.fields))

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
        total = self.rms_height_m
        if total == 0.0:
            return np.ones_like(r)
        # The correlations of the fields add, weighted by their fractions of the variance.
        terms = [(f.rms_height_m / total) ** 2 * f.compute_correlation(r) for f in self.fields]
        return np.sum(terms, axis=0)

    def rms_slope(self) -> float:
        """Return the rms slope √⟨|∇Ψ|²⟩; it may be infinite without a band limit."""
        rough = [field for field in self.fields if field.rms_height_m > 0.0]
        return math.sqrt(sum(f.rms_height_m**2 * f.mean_square_wave_number() for f in rough))

    def make_height_fields(self) -> HeightFields:
        """Return the surface in the form the kernels take."""
        n_fields = len(self.fields)
        law = np.full(n_fields, TABULATED, dtype=np.int64)
        wave_numbers, band_fraction = np.ones(n_fields), np.ones(n_fields)
        tabulated = any(field.spectrum is not None for field in self.fields)
        quantiles = np.zeros((n_fields, N_QUANTILES if tabulated else 2))
        for i, field in enumerate(self.fields):
            if field.spectrum is not None:
                quantiles[i] = field.wave_number_quantiles
                continue
            spectrum, wave_numbers[i], limit = field._height_spectrum
            law[i], band_fraction[i] = spectrum.kernel_code, spectrum.cdf(limit)
        return HeightFields(
            rms_height=np.array([field.rms_height_m for field in self.fields]),
            n_waves=np.array([field.waves for field in self.fields], dtype=np.int64),
            law=law,
            wave_number=wave_numbers,
            band_fraction=band_fraction,
            quantiles=quantiles,
        )

    def sample_realization(self, seed: int, ray_number: int = 0) -> np.ndarray:
        """Return the waves of the realization that ray `ray_number` of stream 0 samples first.

        The rows are those of `splits.kernels.rough_surface.realization`, which evaluates them.
        """
        from splits.kernels.rng import start_stream
        from splits.kernels.rough_surface.realization import (
            allocate_realization,
            sample_realization,
        )

        state = np.zeros(1, dtype=np.uint64)
        ray = check_integer("number", ray_number, 0)
        start_stream(state, check_integer("seed", seed, 0), 0, ray)
        height_fields = self.make_height_fields()
        realization = allocate_realization(height_fields)
        return np.asarray(sample_realization(state, height_fields, realization).waves)

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
        for key in SPECTRUM_COLUMNS if tables else ():
            inputs[f"spectrum_{key}"] = [x for table in tables for x in table[key]]
        return inputs | {"rms_slope": self.rms_slope()}
