"""Attributes and coordinates common to the datasets of all instruments."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from splits.core.provenance import hash_physics_sources
from splits.core.uncertainty import Variable
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.media.medium import Medium


def make_run_attributes(
    title: str,
    instrument: str,
    medium: Medium,
    start_time: float,
    seed: int,
    threads: int | None = None,
) -> dict[str, Any]:
    """Return the attributes of a run; `start_time` is its `time.perf_counter` at the start."""
    attributes = {
        "title": f"{title}: {medium.kind}",
        "instrument": instrument,
        "medium": medium.kind,
        **{f"{medium.kind}_{key}": value for key, value in medium.describe().items()},
        "seed": seed,
        **({} if threads is None else {"threads": threads}),
        "wall_time_s": round(time.perf_counter() - start_time, 3),
        "physics_sources_sha256": hash_physics_sources(),
    }
    return to_netcdf_attributes(attributes | make_provenance(instrument))


def make_wavelength_coordinate(wavelengths: np.ndarray) -> Variable:
    """Return the coordinate of vacuum wavelengths (nm)."""
    attributes = {
        "long_name": "wavelength in vacuum",
        "units": "nm",
        "standard_name": "radiation_wavelength",
    }
    return "wavelength", wavelengths, attributes
