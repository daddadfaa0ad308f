"""What the datasets of all instruments say in the same words."""

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
    """Return the attributes that every run has, one begun at that `time.perf_counter`."""
    facts = {
        "title": f"{title}: {medium.kind}",
        "instrument": instrument,
        "medium": medium.kind,
        **{f"{medium.kind}_{key}": value for key, value in medium.describe().items()},
        "seed": seed,
        **({} if threads is None else {"threads": threads}),
        "wall_time_s": round(time.perf_counter() - start_time, 3),
        "physics_sources_sha256": hash_physics_sources(),
    }
    return to_netcdf_attributes(facts | make_provenance(instrument))


def make_wavelength_coordinate(wavelengths: np.ndarray) -> Variable:
    """Return the coordinate of vacuum wavelengths (nm)."""
    about = {
        "long_name": "wavelength in vacuum",
        "units": "nm",
        "standard_name": "radiation_wavelength",
    }
    return "wavelength", wavelengths, about
