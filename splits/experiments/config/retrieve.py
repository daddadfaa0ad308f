"""Section `retrieve` of an experiment file: measured spectra and the parameters to retrieve."""

from __future__ import annotations

import re
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import ConfigDict, Field, field_validator, model_validator

from splits.core.validation import (
    check_choice,
    check_range,
    format_key,
    invalid,
    key_prefix,
    snap_to_limits,
)
from splits.experiments.config.sections import ConfigSection, check_measured_file
from splits.tables.axes import INCIDENCE

WAVELENGTH_COLUMN = "wavelength_nm"
MIN_STDERR = 1e-6
"""Smallest relative standard error, for reflectances near 0."""
ANGLE_SEPARATOR = "@"
"""Separator between the name of a sample and its angle of incidence."""


class NoiseSection(ConfigSection):
    """Standard errors of measured reflectances: absolute, and relative to the value.

    Absolute errors are independent; relative ones are correlated over `correlation_nm`, if given.
    """

    model_config = ConfigDict(allow_inf_nan=False)

    absolute: float = 0.0
    relative: float = 0.0
    correlation_nm: float | None = None

    @model_validator(mode="after")
    def _check_noise(self) -> NoiseSection:
        with key_prefix("retrieve.noise"):
            for key in ("absolute", "relative"):
                check_range(key, getattr(self, key), 0.0, 1.0)
            if not self.absolute + self.relative > 0.0:
                raise invalid("absolute", 0.0, "above 0, or relative", "no measurement is exact")
            if self.correlation_nm is not None:
                check_range("correlation_nm", self.correlation_nm, 0.0, 1e5, open_low=True)
                if not self.relative:
                    hint = "absolute errors are independent"
                    raise invalid("correlation_nm", self.correlation_nm,
                                 "left out without relative", hint)  # fmt: skip
        return self

    def evaluate(self, values: np.ndarray) -> Any:
        """Return the argument `noise` of `splits.retrieve` for reflectances."""
        relative = np.maximum(self.relative * np.abs(values), MIN_STDERR)
        if self.correlation_nm is None:
            return np.hypot(self.absolute, relative)
        correlated = {"stderr": relative, "correlation_nm": self.correlation_nm}
        return correlated | ({"independent": self.absolute} if self.absolute else {})


class PriorFromSample(ConfigSection):
    """A sample that is retrieved first, with some parameters fixed.

    Its posterior of the other parameters is the prior of the samples whose names begin with
    `applies_to` (by default all).
    """

    model_config = ConfigDict(allow_inf_nan=False)

    sample: str
    fixed: dict[str, float | str]
    applies_to: str = ""


class RetrieveSection(ConfigSection):
    """Measured spectra from which parameters are retrieved with the experiment's table.

    `measured` names a file of config/measured with a column ``wavelength_nm`` and a column per
    sample; `samples` selects some of them.  A sample's name may end in its angle of incidence,
    as ``@50``.  `free`, `fixed` and `prior` are as for `splits.retrieve`.  `exclude_nm` are
    intervals to leave out, such as absorption bands of water vapour.  `reference_values` are
    independent values by parameter and sample, shown for comparison.  Without `noise` the
    measurement error is estimated from the misfit.  `model_axis` is an axis of texts: every sample
    is retrieved with each of them.  `compare_with` is a published law of snow, with which all
    samples are retrieved as well.
    """

    model_config = ConfigDict(allow_inf_nan=False)

    measured: str
    free: dict[str, tuple[float, float]] | tuple[str, ...]
    noise: NoiseSection | None = None
    samples: tuple[str, ...] = ()
    fixed: dict[str, float | str] = Field(default_factory=dict)
    prior: dict[str, tuple[float, float]] = Field(default_factory=dict)
    exclude_nm: tuple[tuple[float, float], ...] = ()
    model_axis: str | None = None
    compare_with: Literal["kokhanovsky_zege_2004"] | None = None
    prior_from: tuple[PriorFromSample, ...] = ()
    reference_values: dict[str, dict[str, float]] = Field(default_factory=dict)

    @field_validator("measured")
    @classmethod
    def _check_measured(cls, value: str) -> str:
        return check_measured_file("retrieve.measured", value)

    @field_validator("noise", mode="before")
    @classmethod
    def _check_noise_type(cls, value: Any) -> Any:
        if value is None or isinstance(value, dict | NoiseSection):
            return value
        allowed = "a mapping such as {relative: 0.01, absolute: 0.003}, or left out"
        hint = "without it the misfit gives the errors"
        raise invalid("retrieve.noise", value, allowed, hint)

    @field_validator("prior_from", mode="before")
    @classmethod
    def _to_tuple(cls, value: Any) -> Any:
        return (value,) if isinstance(value, dict) else value

    @model_validator(mode="after")
    def _check_intervals(self) -> RetrieveSection:
        for low, high in self.exclude_nm:
            if not low < high:
                raise invalid("retrieve.exclude_nm", [low, high], "low < high")
        return self

    def select_spectra(
        self, measured: pd.DataFrame, wavelengths: np.ndarray
    ) -> dict[str, pd.Series]:
        """Return the spectra by sample, at the measured wavelengths that are used.

        Raises
        ------
        ValueError
            For a table without wavelengths, or an unknown sample.
        """
        if WAVELENGTH_COLUMN not in measured:
            columns = list(measured.columns)
            raise invalid("retrieve.measured", columns, f"a table with column {WAVELENGTH_COLUMN}")
        available = [str(c) for c in measured.columns if c != WAVELENGTH_COLUMN]
        if any(name.startswith("Unnamed") for name in available):
            hint = "a column of row numbers? write the table with index=False"
            raise invalid("retrieve.measured", "a column without a name", "names for all", hint)
        wavelength = measured[WAVELENGTH_COLUMN].to_numpy(dtype=float)
        snapped = snap_to_limits(wavelength, wavelengths[0], wavelengths[-1])
        inside = (snapped >= wavelengths[0]) & (snapped <= wavelengths[-1])
        for low, high in self.exclude_nm:
            inside &= (wavelength < low) | (wavelength > high)
        if not inside.any():
            allowed = f"{wavelengths[0]:g} to {wavelengths[-1]:g} nm, the range of the table"
            raise invalid(
                "retrieve.measured", f"{wavelength.min():g} to {wavelength.max():g} nm", allowed
            )
        names = [check_choice("retrieve.samples", s, available) for s in self.samples] or available
        first_samples = [
            check_choice("retrieve.prior_from.sample", f.sample, names) for f in self.prior_from
        ]
        other_samples = [name for name in names if name not in first_samples]
        if len(set(first_samples)) < len(first_samples):
            raise invalid("retrieve.prior_from.sample", first_samples, "different samples")
        if not other_samples:
            hint = "all samples are retrieved first"
            raise invalid("retrieve.samples", names, "others than those of prior_from", hint)
        for first in self.prior_from:
            if not any(name.startswith(first.applies_to) for name in other_samples):
                allowed = f"the beginning of the name of another sample: {', '.join(other_samples)}"
                raise invalid("retrieve.prior_from.applies_to", first.applies_to, allowed)
        for parameter, values in self.reference_values.items():
            for sample in values:
                check_choice(f"retrieve.reference_values.{parameter}", sample, names)
        return {
            n: pd.Series(measured[n].to_numpy(dtype=float)[inside], wavelength[inside])
            for n in names
        }

    def compute_noise(self, values: np.ndarray) -> Any:
        """Return the argument `noise` of `splits.retrieve` for reflectances."""
        return None if self.noise is None else self.noise.evaluate(values)

    def get_fixed_values(self, sample: str, axes: list[str]) -> dict[str, float | str]:
        """Return the fixed values of a sample: `fixed`, and the angle in its name."""
        fixed = dict(self.fixed)
        if INCIDENCE not in axes or ANGLE_SEPARATOR not in sample:
            return fixed
        angle = parse_incidence_deg(sample)
        is_known = INCIDENCE in fixed or INCIDENCE in self.free
        if angle is None and not is_known:
            raise invalid("retrieve.samples", sample, f"an angle after {ANGLE_SEPARATOR}")
        if angle is not None and (INCIDENCE in self.free or fixed.get(INCIDENCE, angle) != angle):
            key = f"retrieve.fixed.{INCIDENCE}" if INCIDENCE in fixed else "retrieve.free"
            hint = f"the name {format_key(sample)} contains the angle"
            raise invalid(key, fixed.get(INCIDENCE, INCIDENCE), "left out", hint)
        return fixed if angle is None else {**fixed, INCIDENCE: angle}

    def list_sample_prefixes(self) -> list[str]:
        """Return the prefixes of the names of samples that figures show together."""
        return [first.applies_to for first in self.prior_from] or [""]


def parse_incidence_deg(sample: str) -> float | None:
    """Return the angle of incidence at the end of a sample's name, or None."""
    _, separator, angle = sample.rpartition(ANGLE_SEPARATOR)
    return float(angle) if separator and re.fullmatch(r"[0-9]+(\.[0-9]+)?", angle) else None
