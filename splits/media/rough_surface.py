"""A randomly rough surface as the user describes it: heights, correlation, number of waves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from numbers import Integral
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from splits.checks import in_range, known_keywords, one_of, refuse, row_of, suggestion, under
from splits.extras import optional
from splits.transport.numerics.rng import start_stream, table_probabilities
from splits.transport.rough import waves as kernels

MOST_WAVES = 100_000
QUANTILES = 4097
_SPECTRUM = ("wave_number_per_m", "density")
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


class Law(NamedTuple):
    """How wave numbers are distributed, all in units of k0.

    Attributes
    ----------
    code : int
        What kernels call it.
    share : callable
        Probability of wave numbers below λ.
    density : callable
        Its derivative.
    square : callable
        Mean of λ² below a limit.
    correlation : callable
        Of heights at a distance, without a limit.
    """

    code: int
    share: Callable[[float], float]
    density: Callable[[np.ndarray], np.ndarray]
    square: Callable[[float], float]
    correlation: Callable[[np.ndarray], np.ndarray]


def _special() -> ModuleType:
    return optional("scipy.special", "retrieval", "correlations of heights need")


def _printed_correlation(r: np.ndarray) -> np.ndarray:
    """Return ∫ J0(λr) (1 + λ²)^(−3/2) dλ = x (I0(x) K1(x) − I1(x) K0(x)) with x = r/2."""
    special = _special()
    x = np.where(r > 0.0, 0.5 * r, 1.0)
    products = special.i0e(x) * special.k1e(x) - special.i1e(x) * special.k0e(x)
    return np.where(r > 0.0, x * products, 1.0)


def _exponential_share(limit: float) -> float:
    """Return 1 − 1/√(1 + λ²) without cancellation."""
    root = math.hypot(1.0, limit)
    return 1.0 if math.isinf(limit) else limit / root * (limit / (1.0 + root))


def _gaussian_square(limit: float) -> float:
    if math.isinf(limit):
        return 4.0
    e = 0.25 * limit * limit
    share = -math.expm1(-e)
    return 4.0 * (1.0 - e * math.exp(-e) / share)


LAWS = {
    "exponential": Law(
        kernels.EXPONENTIAL,
        _exponential_share,
        lambda k: k * (1.0 + k * k) ** -1.5,
        lambda limit: math.hypot(1.0, limit) - 1.0,
        lambda r: np.exp(-r),
    ),
    "exponential_printed": Law(
        kernels.PRINTED,
        lambda limit: 1.0 if math.isinf(limit) else limit / math.hypot(1.0, limit),
        lambda k: (1.0 + k * k) ** -1.5,
        lambda limit: math.asinh(limit) * math.hypot(1.0 / limit, 1.0) - 1.0,
        _printed_correlation,
    ),
    "gaussian": Law(
        kernels.GAUSSIAN,
        lambda limit: -math.expm1(-0.25 * limit * limit),
        lambda k: 0.5 * k * np.exp(-0.25 * k * k),
        _gaussian_square,
        lambda r: np.exp(-r * r),
    ),
}
CORRELATIONS = (*LAWS, "spectrum")


@known_keywords
@dataclass(frozen=True)
class SurfaceField:
    """One random field of heights, Budak & Grimailo 2020, Eq 3.

    Parameters
    ----------
    rms_height_m : float
        Standard deviation of heights σ (m), 0 to 1e6.
    wave_number_per_m : float, optional
        k0 (1/m), 1e-9 to 1e9; needed but for a spectrum.
    correlation : str
        "exponential": exp(−k0 r).  "exponential_printed": the law of wave numbers as printed,
        λ = k0 β/√(1 − β²), whose correlation is x (I0(x) K1(x) − I1(x) K0(x)) with x = k0 r/2.
        "gaussian": exp(−(k0 r)²).  "spectrum": as the table says.
    waves : int
        M, 1 to 100 000.
    band_limit_per_m : float, optional
        Largest wave number (1/m), from k0/1000 to infinity; heights keep their σ.  Without one
        the slopes of "exponential", which needs it, and more slowly those of
        "exponential_printed" grow with the number of waves, and reflectance moves with them.
    spectrum : mapping, optional
        Columns ``wave_number_per_m``, rising, and ``density``, the isotropic spectral density p up
        to a factor, linear in between: p(λ) λ dλ is the share of the variance.

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

        put("rms_height_m", in_range("rms_height_m", self.rms_height_m, 0.0, 1e6, "m"))
        one_of("correlation", self.correlation, CORRELATIONS)
        put("waves", _whole("waves", self.waves, MOST_WAVES))
        if self.correlation == "spectrum":
            for key in ("wave_number_per_m", "band_limit_per_m"):
                if getattr(self, key) is not None:
                    raise refuse(key, getattr(self, key), "left out", "the spectrum has its own")
            put("spectrum", _columns(self.spectrum))
            return
        if self.spectrum is not None:
            raise refuse("spectrum", self.spectrum, 'left out unless correlation is "spectrum"')
        key, k0 = "wave_number_per_m", self.wave_number_per_m
        if k0 is None:
            raise refuse(key, None, "given (1/m)", "the inverse of the length of its correlation")
        put(key, k0 := in_range(key, k0, 1e-9, 1e9, "1/m"))
        key, limit = "band_limit_per_m", self.band_limit_per_m
        if limit is None and self.correlation == "exponential":
            raise refuse(
                key, None, "given (1/m)",
                "slopes, about rms_height_m √(k0 limit), grow without end with it and change "
                "reflectance; name the finest waves that light shall see, or infinity; this is for "
                'the default correlation "exponential", "gaussian" needs none',
            )  # fmt: skip
        if limit is None or limit == math.inf:
            put(key, math.inf)
        else:
            put(key, in_range(key, limit, 1e-3 * k0, math.inf, "1/m"))

    @property
    def _limit(self) -> float:
        """Band limit in units of k0."""
        assert self.band_limit_per_m is not None and self.wave_number_per_m is not None
        return self.band_limit_per_m / self.wave_number_per_m

    @cached_property
    def quantiles(self) -> np.ndarray:
        """Quantile function of a spectrum's wave numbers (1/m), see `rng.table_probabilities`."""
        assert self.spectrum is not None
        return _quantiles(*(np.array(self.spectrum[key]) for key in _SPECTRUM))

    def correlation_at(self, r_m: np.ndarray) -> np.ndarray:
        """Return the expected correlation of heights at distances (m), as waves are drawn."""
        r = np.asarray(r_m, dtype=float)
        if self.correlation == "spectrum":
            return np.array([_sum_of_cells(self.quantiles, x) for x in r.ravel()]).reshape(r.shape)
        law = LAWS[self.correlation]
        assert self.wave_number_per_m is not None
        r = self.wave_number_per_m * r
        if law.share(self._limit) == 1.0:
            return law.correlation(r)
        found = [_integral(law.density, self._limit, x) for x in r.ravel()]
        return np.array(found).reshape(r.shape) / law.share(self._limit)

    def mean_square_wave_number(self) -> float:
        """Return the expected λ² of a wave (1/m²)."""
        if self.correlation == "spectrum":
            return _mean_of_cells(self.quantiles, lambda k: k * k)
        assert self.wave_number_per_m is not None
        return self.wave_number_per_m**2 * LAWS[self.correlation].square(self._limit)


@known_keywords
@dataclass(frozen=True)
class RoughSurface:
    """Superposed random fields of heights above a plane.

    Parameters
    ----------
    fields : SurfaceField, mapping or a sequence of them
        What one field is, see `SurfaceField`, or several.

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
        if isinstance(given, (SurfaceField, Mapping)):
            given = [given]
        if isinstance(given, (str, bytes)) or not isinstance(given, Sequence) or not given:
            raise refuse("surface", given, "one field, or a list of fields, of keys and values")
        places = [f"surface[{i}]" for i in range(len(given))] if len(given) > 1 else ["surface"]
        found = tuple(_field(*pair) for pair in zip(places, given, strict=True))
        object.__setattr__(self, "fields", found)

    @classmethod
    def of(cls, value: Any) -> RoughSurface:
        """Return a surface given as such or as its fields, or refuse it."""
        return value if isinstance(value, cls) else cls(value)

    @property
    def rms_height_m(self) -> float:
        """Standard deviation of heights (m)."""
        return math.hypot(*(field.rms_height_m for field in self.fields))

    def correlation(self, r_m: Any) -> np.ndarray:
        """Return the expected correlation of heights at distances (m); of a plane, 1."""
        r = np.asarray(r_m, dtype=float)
        if self.rms_height_m == 0.0:
            return np.ones_like(r)
        shares = ((field.rms_height_m / self.rms_height_m) ** 2 for field in self.fields)
        parts = zip(shares, self.fields, strict=True)
        return np.sum([share * field.correlation_at(r) for share, field in parts], axis=0)

    def rms_slope(self) -> float:
        """Return √⟨|∇Ψ|²⟩, infinite where a law without band limit has it so."""
        rough = [field for field in self.fields if field.rms_height_m > 0.0]
        return math.sqrt(sum(f.rms_height_m**2 * f.mean_square_wave_number() for f in rough))

    def numbers(self) -> kernels.Fields:
        """Return the surface as kernels take it."""
        count = len(self.fields)
        law = np.full(count, kernels.TABLE, dtype=np.int64)
        wave_number, share = np.ones(count), np.ones(count)
        tables = any(field.spectrum is not None for field in self.fields)
        quantile = np.zeros((count, QUANTILES if tables else 2))
        for i, field in enumerate(self.fields):
            if field.spectrum is not None:
                quantile[i] = field.quantiles
                continue
            named = LAWS[field.correlation]
            law[i], wave_number[i] = named.code, field.wave_number_per_m
            share[i] = named.share(field._limit)
        return kernels.Fields(
            rms_height=np.array([field.rms_height_m for field in self.fields]),
            waves=np.array([field.waves for field in self.fields], dtype=np.int64),
            law=law,
            wave_number=wave_number,
            share=share,
            quantile=quantile,
        )

    def realisation(self, seed: int, number: int = 0) -> np.ndarray:
        """Return the waves that ray `number` of ensemble 0 draws as its first numbers.

        Rows are those of `splits.transport.rough.waves`, which also evaluates them.
        """
        seed, number = _whole("seed", seed, low=0), _whole("number", number, low=0)
        state = np.zeros(1, dtype=np.uint64)
        start_stream(state, seed, 0, number)
        drawn = self.numbers()
        waves: np.ndarray = kernels.draw_waves(state, drawn, kernels.room_for(drawn)).waves
        return waves

    def describe(self) -> dict[str, Any]:
        """Return inputs and rms slope under names fit for dataset attributes, a list per input."""
        inputs: dict[str, Any] = {}
        for key in (f.name for f in fields(SurfaceField) if f.name != "spectrum"):
            values = [getattr(field, key) for field in self.fields]
            # Without a band limit waves have none; fields with a table have no k0.
            none = math.inf if key == "band_limit_per_m" else 0.0
            inputs[key] = [none if value is None else value for value in values]
        inputs["correlation"] = ", ".join(inputs["correlation"])
        tables = [field.spectrum for field in self.fields if field.spectrum is not None]
        for key in _SPECTRUM if tables else ():
            inputs[f"spectrum_{key}"] = [x for table in tables for x in table[key]]
        return inputs | {"rms_slope": self.rms_slope()}


def _field(where: str, given: Any) -> SurfaceField:
    """Return a field, or refuse it and say which."""
    if isinstance(given, SurfaceField):
        return given
    names = [f.name for f in fields(SurfaceField)]
    allowed = "one of " + ", ".join(names)
    if not isinstance(given, Mapping):
        raise refuse(where, given, "a mapping of keys, each " + allowed)
    for name in given:
        if name not in names:
            raise refuse(where, name, allowed, suggestion(name, names))
    if "rms_height_m" not in given:
        raise refuse(f"{where}.rms_height_m", None, "given (m)")
    with under(where):
        return SurfaceField(**given)


def _whole(key: str, value: Any, high: int = 2**63 - 1, low: int = 1) -> int:
    """Return a whole number, or refuse it."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not whole or not low <= int(value) <= high:
        raise refuse(key, value, f"a whole number from {low} to {high}")
    return int(value)


def _columns(given: Any) -> dict[str, tuple[float, ...]]:
    """Return the columns of a spectrum, or refuse them."""
    allowed = "a mapping of equally many numbers " + " and ".join(_SPECTRUM)
    if not isinstance(given, Mapping) or set(given) != set(_SPECTRUM):
        raise refuse("spectrum", given, allowed)
    k, density = (row_of(f"spectrum.{key}", given[key]) for key in _SPECTRUM)
    if k.shape != density.shape or k.size < 2:
        raise refuse("spectrum", dict(given), allowed, "two rows at least")
    if k[0] < 0.0 or (np.diff(k) <= 0.0).any():
        raise refuse("spectrum.wave_number_per_m", k.tolist(), "0 or more and rising")
    if (density < 0.0).any() or not density[k > 0.0].any():
        raise refuse("spectrum.density", density.tolist(), "0 or more, and more somewhere")
    return dict(zip(_SPECTRUM, (tuple(k.tolist()), tuple(density.tolist())), strict=True))


def _quantiles(k: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Return the quantile function of the density p(λ) λ, p linear between its points."""
    slope = np.diff(density) / np.diff(k)

    def mass(cell: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """∫ p λ dλ from the beginning of a cell, exact: p(λ) λ is a parabola."""
        step = upper - k[cell]
        p, a = density[cell], k[cell]
        return step * (p * a + step * (0.5 * (p + slope[cell] * a) + step * slope[cell] / 3.0))

    cells = np.arange(k.size - 1)
    cumulative = np.concatenate([[0.0], np.cumsum(mass(cells, k[1:]))])
    wanted = table_probabilities(QUANTILES) * cumulative[-1]
    # Cells without mass hold no quantile but those at the very ends.
    cell = np.clip(np.searchsorted(cumulative, wanted, side="left") - 1, 0, k.size - 2)
    first = np.flatnonzero(np.diff(cumulative) > 0.0)[0]
    cell = np.maximum(cell, first)
    low, high = k[cell], k[cell + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = cumulative[cell] + mass(cell, middle) < wanted
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


def _mean_of_cells(
    table: np.ndarray, function: Callable[[np.ndarray], np.ndarray], pieces: int = 1
) -> float:
    """Return the mean of a function of what a quantile table, linear in its cells, stands for."""
    points = (table.size - 1) * pieces
    x = (np.arange(points)[:, None] + 0.5 * (1.0 + _NODES)) / points
    # Derivative of the probabilities of `table_probabilities`.
    weight = 2.0 * np.minimum(x, 1.0 - x) * _WEIGHTS / points
    where = np.linspace(0.0, 1.0, table.size)
    return float((weight * function(np.interp(x, where, table))).sum())


def _sum_of_cells(table: np.ndarray, r: float) -> float:
    """Return the mean of J0(λ r), in pieces of less than a period."""
    widest = float(np.diff(table).max())
    j0 = _special().j0
    return _mean_of_cells(table, lambda k: j0(k * r), 1 + int(widest * r / math.pi))


def _integral(density: Callable[[np.ndarray], np.ndarray], limit: float, r: float) -> float:
    """Return ∫ J0(λr) density dλ from 0 to the limit, in pieces of less than a period."""
    octaves = 2.0 ** np.arange(-3.0, max(math.log2(limit), -2.0) + 1.0)
    edges = [np.array([0.0]), octaves, np.arange(0.0, limit, 2.0 * math.pi / max(r, 1e-300))[1:]]
    edge = np.unique(np.minimum(np.concatenate([*edges, [limit]]), limit))
    half = 0.5 * np.diff(edge)[:, None]
    k = edge[:-1, None] + half * (1.0 + _NODES)
    return float((half * _WEIGHTS * _special().j0(k * r) * density(k)).sum())
