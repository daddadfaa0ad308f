"""Section `retrieve_return` of an experiment file: returns of a pulse, measured or synthetic."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
import pandas as pd
from pydantic import AfterValidator, Field, model_validator

from splits.analysis.measured import WAVELENGTH_COLUMN
from splits.core.validation import check_choice, invalid
from splits.experiments.config.beam_instruments import Delays, PulseSection, dump_pulse
from splits.experiments.config.sections import FiniteSection, Label, MeasuredFile
from splits.instruments.delay_record import Pulse
from splits.retrieval.retrieve_return import MAX_PHOTONS
from splits.retrieval.state_vector import SCALE

BIN_COLUMNS = (WAVELENGTH_COLUMN, "delay_start_s", "delay_end_s")
"""Columns of a measured return that describe its bins."""
STDERR_SUFFIX = "_stderr"
DELAY_TOLERANCE = 1e-6
"""Largest difference between delays that are equal, relative to the width of a bin."""


def _check_pulse(pulse: float | PulseSection | None) -> float | PulseSection | None:
    Pulse.from_argument(dump_pulse(pulse))
    return pulse


class MeasuredReturn(NamedTuple):
    """Arguments of `splits.retrieve_return` for a sample.

    Attributes
    ----------
    edges : float, shape (bins + 1,)
        Delays between bins (s).
    rates : float, shape (wavelengths, bins)
        Light per time (s⁻¹), relative to the incident light.
    noise : float, shape (wavelengths, bins), or mapping
        Standard errors (s⁻¹), or the number of photons of the pulse.
    """

    edges: np.ndarray
    rates: np.ndarray
    noise: Any


class SyntheticReturn(FiniteSection):
    """Known media, whose returns are simulated and counted as photons."""

    truth: dict[Label, dict[str, float]]
    """values of the free parameters by sample, and of other keywords of the medium that differ from
    those of the table; `scale` is by default 1"""
    delay_s: Delays
    """edges of the bins in which photons are counted (s), also as `{start, stop, step}`"""
    rays: int = Field(200_000, ge=1, lt=2**63)
    """number of rays of a return, which limits its accuracy besides the photons"""
    seed_offset: int = Field(1, ge=1, lt=2**31)
    """difference of the seed from that of the table; returns and table are independent"""


class RetrieveReturnSection(FiniteSection):
    """Returns of a pulse, and the parameters to retrieve with the table of the experiment."""

    free: dict[str, tuple[float, float]] | tuple[str, ...]
    """parameters to retrieve, which are axes of the grid or `scale`, a factor of the return for a
    pulse or a receiver of unknown power (0.2 to 5); a mapping also gives their ranges (low, high)
    """
    measured: MeasuredFile | None = None
    """name of a file of `config/measured/`, with columns `wavelength_nm`, `delay_start_s` and
    `delay_end_s` and a column per sample: counted photons with `photons`, otherwise the fraction of
    the incident light per time (s⁻¹), with its standard error in a column `…_stderr`"""
    synthetic: SyntheticReturn | None = None
    """known media instead of a file"""
    photons: float | None = Field(None, gt=0.0, le=MAX_PHOTONS)
    """number of photons of the pulse, by which counted photons are divided and from which their
    noise follows; if it is unknown, an estimate with a free `scale`"""
    pulse: Annotated[float | PulseSection | None, AfterValidator(_check_pulse)] = None
    """full width at half maximum of a Gaussian pulse (s), or its power over time; by default, the
    pulse is instantaneous"""
    samples: tuple[str, ...] = ()
    """samples of the file to use; by default all"""
    fixed: dict[str, float | str] = Field({})
    """values of the other axes of the grid"""
    prior: dict[str, tuple[float, float]] = Field({})
    """prior (mean, standard deviation) by parameter"""
    reference_values: dict[str, dict[str, float]] = Field({})
    """independent values by parameter and sample of the file, shown in the figure for comparison"""

    @model_validator(mode="after")
    def _check_source(self) -> RetrieveReturnSection:
        if (self.measured is None) == (self.synthetic is None):
            given = "left out" if self.measured is None else "given"
            raise invalid("measured", given, "given, or synthetic instead, not both")
        if self.synthetic is None:
            return self
        if self.photons is None:
            raise invalid("photons", None, "given", "synthetic returns are counted photons")
        for key in ("samples", "reference_values"):
            if getattr(self, key):
                hint = "synthetic.truth has the samples and their values"
                raise invalid(key, getattr(self, key), "left out with synthetic", hint)
        return self

    def list_references(self) -> dict[str, dict[str, float]]:
        """Return the known values of free parameters by parameter and sample."""
        if self.synthetic is None:
            return self.reference_values
        truth = self.synthetic.truth.items()
        return {
            name: {sample: {SCALE: 1.0, **values}[name] for sample, values in truth}
            for name in self.free
        }

    def select_returns(
        self, measured: pd.DataFrame, wavelengths: np.ndarray
    ) -> dict[str, MeasuredReturn]:
        """Return the samples of a file; reject other wavelengths than those of the table."""
        key = "retrieve_return.measured"
        edges = _read_bins(key, measured, wavelengths)
        is_error = {name for name in measured if str(name).endswith(STDERR_SUFFIX)}
        available = [str(name) for name in measured if name not in {*BIN_COLUMNS, *is_error}]
        if not available:
            allowed = f"a table with a column per sample besides {', '.join(BIN_COLUMNS)}"
            raise invalid(key, list(measured), allowed)
        names = [check_choice("retrieve_return.samples", name, available) for name in self.samples]
        shape = wavelengths.size, edges.size - 1
        returns = {}
        for name in names or available:
            values = measured[name].to_numpy(dtype=float).reshape(shape)
            if self.photons is not None:
                returns[name] = self.scale_counts(values, edges)
                continue
            if name + STDERR_SUFFIX not in measured:
                allowed = f"with a column {name}{STDERR_SUFFIX}"
                raise invalid(key, self.measured, allowed, "or give photons for counted photons")
            stderr = measured[name + STDERR_SUFFIX].to_numpy(dtype=float).reshape(shape)
            returns[name] = MeasuredReturn(edges, values, stderr)
        for parameter, references in self.reference_values.items():
            for sample in references:
                check_choice(f"retrieve_return.reference_values.{parameter}", sample, [*returns])
        return returns

    def scale_counts(self, counts: np.ndarray, edges: np.ndarray) -> MeasuredReturn:
        """Return counted photons of a pulse as light per time."""
        assert self.photons is not None
        rates = counts / (self.photons * np.diff(edges))
        return MeasuredReturn(edges, rates, {"photons": self.photons})


def _read_bins(key: str, measured: Mapping[str, Any], wavelengths: np.ndarray) -> np.ndarray:
    """Return the delays between the bins of a file, which are the same at all wavelengths."""
    for name in BIN_COLUMNS:
        if name not in measured:
            raise invalid(key, list(measured), f"a table with column {name}")
    given, start, end = (np.asarray(measured[name], dtype=float) for name in BIN_COLUMNS)
    n_bins = given.size // wavelengths.size
    if given.size % wavelengths.size or not np.allclose(given, np.repeat(wavelengths, n_bins)):
        allowed = f"as many bins at each wavelength of the table, {wavelengths.tolist()} nm"
        hint = "all delays of the first wavelength, then those of the next"
        raise invalid(f"{key} ({WAVELENGTH_COLUMN})", np.unique(given).tolist(), allowed, hint)
    start, end = start.reshape(-1, n_bins), end.reshape(-1, n_bins)
    width = end - start
    if not (width > 0.0).all():
        hint = "delays are in seconds"
        raise invalid(f"{key} (delay_end_s)", float(end[width <= 0.0][0]), "above its start", hint)
    tolerance = DELAY_TOLERANCE * width.min()
    edges = np.append(start[0], end[0, -1])
    if np.abs(start - edges[:-1]).max() > tolerance or np.abs(end - edges[1:]).max() > tolerance:
        allowed = "bins that follow each other, the same at all wavelengths"
        raise invalid(f"{key} (delay_start_s)", "with gaps or overlaps", allowed)
    return edges
