"""Randomly rough surfaces: heights, correlation and number of waves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from splits.core.arrays import as_float_array
from splits.core.keywords import reject_unknown_keywords
from splits.core.validation import (
    check_integer,
    invalid,
    key_prefix,
    suggest_name,
)
from splits.kernels.rng import start_stream
from splits.kernels.rough_surface import realization as kernels
from splits.media.formatting import format_input
from splits.media.height_spectra import (
    HEIGHT_SPECTRA,
    N_QUANTILES,
)
from splits.media.random_height_field import SPECTRUM_COLUMNS, RandomHeightField


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
        """Return the waves of the realization that ray `ray_number` of stream 0 samples first.

        The rows are those of `splits.kernels.rough_surface.realization`, which evaluates them.
        """
        seed, ray_number = (
            check_integer("seed", seed, 0),
            check_integer("number", ray_number, 0),
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
        for key in SPECTRUM_COLUMNS if tables else ():
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
