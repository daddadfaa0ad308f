"""What the datasets of all instruments say in the same words."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from splits.dataset import attributes, provenance
from splits.media.turbid import Medium
from splits.transport import sources_digest

Variable = tuple[str | tuple[str, ...], np.ndarray, dict[str, str]]
"""Dimensions, values and attributes, as `xarray.Dataset` takes them."""


def run_facts(
    title: str,
    instrument: str,
    medium: Medium,
    begun: float,
    seed: int,
    threads: int | None = None,
) -> dict[str, Any]:
    """Return the attributes that every run has, one begun at that `time.perf_counter`."""
    facts = {
        "title": f"{title}: {medium.kind}",
        "instrument": instrument,
        "medium": medium.kind,
        **{f"{medium.kind}_{key}": value for key, value in medium.describe().items()},
        "seed": seed,
        **({} if threads is None else {"threads": threads}),
        "wall_time_s": round(time.perf_counter() - begun, 3),
        "physics_sources_sha256": sources_digest(),
    }
    return attributes(facts | provenance(instrument))


def quantity(
    name: str,
    dims: str | tuple[str, ...],
    values: np.ndarray,
    stderr: np.ndarray | None,
    long_name: str,
    units: str = "1",
) -> dict[str, Variable]:
    """Return a variable and, unless it is None, its standard error ``…_stderr``, by name."""
    about = {"long_name": long_name, "units": units}
    if stderr is None:
        return {name: (dims, values, about)}
    error = f"{name}_stderr"
    return {
        name: (dims, values, {**about, "ancillary_variables": error}),
        error: (dims, stderr, {**about, "long_name": f"standard error of {long_name}"}),
    }


def wavelength_axis(wavelengths: np.ndarray) -> Variable:
    """Return the coordinate of vacuum wavelengths (nm)."""
    about = {
        "long_name": "wavelength in vacuum",
        "units": "nm",
        "standard_name": "radiation_wavelength",
    }
    return "wavelength", wavelengths, about
