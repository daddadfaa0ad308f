"""What the datasets of all instruments say in the same words."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from splits.dataset import attributes, provenance
from splits.media.turbid import Medium
from splits.sources import physics_digest

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
        "physics_sources_sha256": physics_digest(),
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


def deviations(
    name: str, dims: str | tuple[str, ...], groups: np.ndarray, long_name: str
) -> dict[str, Variable]:
    """Return how far groups of rays take a quantity off, ``…_groups``, by name.

    Parameters
    ----------
    name, dims, long_name
        Of the quantity.
    groups : float, shape (groups, ...)
        Stored in single precision.
    """
    dims = (dims,) if isinstance(dims, str) else dims
    about = {
        "long_name": f"deviation of {long_name} by group of rays",
        "units": "1",
        "comment": "sums over groups of products are covariances, without what stands for "
        "interpolation between refractive indices in the standard error",
    }
    return {f"{name}_groups": (("group", *dims), groups.astype(np.float32), about)}


def wavelength_axis(wavelengths: np.ndarray) -> Variable:
    """Return the coordinate of vacuum wavelengths (nm)."""
    about = {
        "long_name": "wavelength in vacuum",
        "units": "nm",
        "standard_name": "radiation_wavelength",
    }
    return "wavelength", wavelengths, about
