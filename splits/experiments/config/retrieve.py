"""The section `retrieve` of an experiment: measured spectra to read in its own table."""

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
"""Least standard error, of a reflectance of 0."""
ANGLE_SEPARATOR = "@"
"""Between the name of a sample and the angle of incidence it was measured under."""


class NoiseSection(ConfigSection):
    """Standard errors of measured reflectances: absolute ones, and ones relative to the value.

    The former are independent, the latter alike over `correlation_nm`, unless that is left out.
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
        """Return the noise of reflectances as `splits.retrieve` takes it."""
        relative = np.maximum(self.relative * np.abs(values), MIN_STDERR)
        if self.correlation_nm is None:
            return np.hypot(self.absolute, relative)
        together = {"stderr": relative, "correlation_nm": self.correlation_nm}
        return together | ({"independent": self.absolute} if self.absolute else {})


class PriorFromSample(ConfigSection):
    """A sample that is retrieved first, with some parameters known.

    What it tells of the others is what is known of them before other samples are retrieved: all, or
    those whose names begin with `applies_to`.
    """

    model_config = ConfigDict(allow_inf_nan=False)

    sample: str
    fixed: dict[str, float | str]
    applies_to: str = ""


class RetrieveSection(ConfigSection):
    """Measured spectra from which parameters are to be retrieved with the experiment's table.

    `measured` names a file of config/measured with a column ``wavelength_nm`` and a column per
    sample; `samples` chooses some of them.  A sample's name may end in ``@50``, its angle of
    incidence.  `free`, `fixed` and `prior` are as for `splits.retrieve`; `exclude_nm` are intervals
    that do not count, such as those where water vapour lets no light through.  `reference_values` are values
    by parameter and sample that were found otherwise, to be drawn beside.  Without `noise` the
    misfit tells the errors.  `model_axis` is an axis of
    texts, whose light is compared: every sample is read with each of them.  `compare_with` is a published
    law of snow, with which they are read, too.
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
        raise invalid("retrieve.noise", value, allowed, "without it the misfit tells the errors")

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
        """Return the spectra to read, by sample, where the table has them and nothing leaves out.

        Raises
        ------
        ValueError
            For a table without wavelengths, or a sample that it does not have.
        """
        if WAVELENGTH_COLUMN not in measured:
            columns = list(measured.columns)
            raise invalid("retrieve.measured", columns, f"a table with column {WAVELENGTH_COLUMN}")
        known = [str(c) for c in measured.columns if c != WAVELENGTH_COLUMN]
        if any(name.startswith("Unnamed") for name in known):
            hint = "numbers of rows? write it with index=False"
            raise invalid("retrieve.measured", "a column without a name", "names for all", hint)
        w = measured[WAVELENGTH_COLUMN].to_numpy(dtype=float)
        near = snap_to_limits(w, wavelengths[0], wavelengths[-1])
        inside = (near >= wavelengths[0]) & (near <= wavelengths[-1])
        for low, high in self.exclude_nm:
            inside &= (w < low) | (w > high)
        if not inside.any():
            allowed = f"{wavelengths[0]:g} to {wavelengths[-1]:g} nm, as the table has them"
            raise invalid("retrieve.measured", f"{w.min():g} to {w.max():g} nm", allowed)
        names = [check_choice("retrieve.samples", s, known) for s in self.samples] or known
        early = [
            check_choice("retrieve.prior_from.sample", f.sample, names) for f in self.prior_from
        ]
        later = [name for name in names if name not in early]
        if len(set(early)) < len(early):
            raise invalid("retrieve.prior_from.sample", early, "different samples")
        if not later:
            hint = "all samples are retrieved first"
            raise invalid("retrieve.samples", names, "some besides those of prior_from", hint)
        for first in self.prior_from:
            if not any(name.startswith(first.applies_to) for name in later):
                allowed = f"how the name of another sample begins: {', '.join(later)}"
                raise invalid("retrieve.prior_from.applies_to", first.applies_to, allowed)
        for parameter, values in self.reference_values.items():
            for sample in values:
                check_choice(f"retrieve.reference_values.{parameter}", sample, names)
        return {n: pd.Series(measured[n].to_numpy(dtype=float)[inside], w[inside]) for n in names}

    def compute_noise(self, values: np.ndarray) -> Any:
        """Return the noise of reflectances as `splits.retrieve` takes it."""
        return None if self.noise is None else self.noise.evaluate(values)

    def get_fixed_values(self, sample: str, axes: list[str]) -> dict[str, float | str]:
        """Return what is known of a sample: `fixed`, and the angle that its name tells."""
        found = dict(self.fixed)
        if INCIDENCE not in axes or ANGLE_SEPARATOR not in sample:
            return found
        angle = parse_incidence_deg(sample)
        known = INCIDENCE in found or INCIDENCE in self.free
        if angle is None and not known:
            raise invalid("retrieve.samples", sample, f"an angle after {ANGLE_SEPARATOR}")
        if angle is not None and (INCIDENCE in self.free or found.get(INCIDENCE, angle) != angle):
            key = f"retrieve.fixed.{INCIDENCE}" if INCIDENCE in found else "retrieve.free"
            hint = f"the name {format_key(sample)} tells the angle"
            raise invalid(key, found.get(INCIDENCE, INCIDENCE), "left out", hint)
        return found if angle is None else {**found, INCIDENCE: angle}

    def list_sample_prefixes(self) -> list[str]:
        """Return how names of samples begin that figures show together."""
        return [first.applies_to for first in self.prior_from] or [""]


def parse_incidence_deg(sample: str) -> float | None:
    """Return the angle of incidence at the end of a sample's name, or None."""
    _, mark, angle = sample.rpartition(ANGLE_SEPARATOR)
    return float(angle) if mark and re.fullmatch(r"[0-9]+(\.[0-9]+)?", angle) else None
