"""Section `retrieve` of an experiment file: measured spectra and the parameters to retrieve."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from splits.analysis.measured import WAVELENGTH_COLUMN
from splits.core.validation import check_choice, format_key, invalid, snap_to_limits
from splits.experiments.config.sections import (
    FiniteSection,
    Interval,
    MeasuredFile,
    accept_single,
    list_samples,
)
from splits.tables.axes import INCIDENCE

MIN_STDERR = 1e-6
"""Smallest relative standard error, for reflectances near 0."""
ANGLE_SEPARATOR = "@"
"""Separator between the name of a sample and its angle of incidence."""


class NoiseSection(FiniteSection):
    """Standard errors of measured reflectances: absolute, and relative to the value."""

    absolute: float = Field(0.0, ge=0.0, le=1.0)
    """standard error in units of reflectance, independent at each wavelength; `independent` in
    Python"""
    relative: float = Field(0.0, ge=0.0, le=1.0)
    """standard error as a fraction of the value, correlated over `correlation_nm`; in Python
    `stderr`, in units of reflectance"""
    correlation_nm: float | None = Field(None, gt=0.0, le=1e5)
    """correlation length of the relative errors (nm); by default they are independent"""

    @model_validator(mode="before")
    @classmethod
    def _check_type(cls, value: Any) -> Any:
        if not isinstance(value, dict | NoiseSection):
            allowed = "a mapping such as {relative: 0.01, absolute: 0.003}, or left out"
            raise invalid("", value, allowed, "without it the misfit gives the errors")
        return value

    @model_validator(mode="after")
    def _check_noise(self) -> NoiseSection:
        if not self.absolute + self.relative > 0.0:
            raise invalid("absolute", 0.0, "above 0, or relative", "no measurement is exact")
        if self.correlation_nm is not None and not self.relative:
            hint = "absolute errors are independent"
            raise invalid("correlation_nm", self.correlation_nm, "left out without relative", hint)
        return self

    def evaluate(self, values: np.ndarray) -> Any:
        """Return the argument `noise` of `splits.retrieve` for reflectances."""
        relative = np.maximum(self.relative * np.abs(values), MIN_STDERR)
        if self.correlation_nm is None:
            return np.hypot(self.absolute, relative)
        correlated = {"stderr": relative, "correlation_nm": self.correlation_nm}
        return correlated | ({"independent": self.absolute} if self.absolute else {})


class PriorFromSample(FiniteSection):
    """A sample that is retrieved first, with some parameters fixed."""

    sample: str
    """name of the sample"""
    fixed: dict[str, float | str]
    """known parameters of the sample"""
    applies_to: str = ""
    """beginning of the names of the samples that use its posterior as a prior"""


class RetrieveSection(FiniteSection):
    """Measured spectra, and the parameters to retrieve with the table of the experiment."""

    measured: MeasuredFile
    """name of a file of `config/measured/`, with a column `wavelength_nm` and a column of
    reflectances (fractions, no gaps) per sample; a suffix such as `@50` of a sample's name is its
    incidence angle, which must be in the table"""
    free: dict[str, tuple[float, float]] | tuple[str, ...]
    """parameters to retrieve, which are axes of the grid or `scale`; a mapping also gives their
    ranges (low, high)"""
    quantity: Literal["reflectance", "reflectance_factor"] = "reflectance"
    """measured quantity; `reflectance_factor` needs a table with directions"""
    noise: NoiseSection | None = None
    """standard errors of the measurement, by default estimated from the misfit"""
    samples: tuple[str, ...] = ()
    """samples to use; by default all"""
    fixed: dict[str, float | str] = Field({})
    """values of the other axes, and `polar_deg` and `azimuth_deg` of the measurement for a table
    with several directions"""
    prior: dict[str, tuple[float, float]] = Field({})
    """prior (mean, standard deviation) by parameter"""
    exclude_nm: tuple[Interval, ...] = ()
    """intervals (low, high) of wavelengths to exclude"""
    model_axis: str | None = None
    """an axis of texts whose values are alternative models; each sample is retrieved with all of
    them"""
    compare_with: Literal["kokhanovsky_zege_2004"] | None = None
    """a published law for snow, with which the parameters of the samples are also retrieved
    (Kokhanovsky and Zege 2004, as implemented in snowoptics)"""
    prior_from: Annotated[tuple[PriorFromSample, ...], accept_single(PriorFromSample)] = ()
    """a sample (`sample`), or a list of them, that is retrieved first, with the parameters of
    `fixed` known; the marginal posteriors of its other parameters are priors of all other samples,
    or of those whose names begin with `applies_to`"""
    reference_values: dict[str, dict[str, float]] = Field({})
    """independent values by parameter and sample, shown in the figure for comparison"""

    def select_spectra(
        self, measured: pd.DataFrame, wavelengths: np.ndarray
    ) -> dict[str, pd.Series]:
        """Return the spectra by sample, at the measured wavelengths that are used.

        Unknown samples, and tables that do not match the section, are rejected.
        """
        names = list_samples("retrieve", measured, self.samples)
        wavelength = measured[WAVELENGTH_COLUMN].to_numpy(dtype=float)
        snapped = snap_to_limits(wavelength, wavelengths[0], wavelengths[-1])
        inside = (snapped >= wavelengths[0]) & (snapped <= wavelengths[-1])
        for low, high in self.exclude_nm:
            inside &= (wavelength < low) | (wavelength > high)
        if not inside.any():
            given = f"{wavelength.min():g} to {wavelength.max():g} nm"
            allowed = f"{wavelengths[0]:g} to {wavelengths[-1]:g} nm, the range of the table"
            raise invalid("retrieve.measured", given, allowed)
        key = "retrieve.prior_from.sample"
        first_samples = [check_choice(key, first.sample, names) for first in self.prior_from]
        other_samples = [name for name in names if name not in first_samples]
        if len(set(first_samples)) < len(first_samples):
            raise invalid(key, first_samples, "different samples")
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
        used = measured[inside]
        return {n: pd.Series(used[n].to_numpy(dtype=float), wavelength[inside]) for n in names}

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
