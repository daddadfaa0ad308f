"""What the datasets of all instruments say in the same words."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from splits.dataset import attributes, provenance
from splits.media.turbid import Medium
from splits.sources import physics_digest
from splits.uncertainty import Variable


def run_facts(
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
        "physics_sources_sha256": physics_digest(),
    }
    return attributes(facts | provenance(instrument))


def wavelength_axis(wavelengths: np.ndarray) -> Variable:
    """Return the coordinate of vacuum wavelengths (nm)."""
    about = {
        "long_name": "wavelength in vacuum",
        "units": "nm",
        "standard_name": "radiation_wavelength",
    }
    return "wavelength", wavelengths, about
