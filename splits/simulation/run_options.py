"""Options common to all instruments, and the attributes and coordinates of their datasets."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np

from splits.core.inputs import INCIDENCE_ANGLE, WAVELENGTH, Kernel
from splits.core.process import count_cpus
from splits.core.progress import ProgressCallback
from splits.core.provenance import hash_physics_sources
from splits.core.uncertainty import Variable
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.media.medium import Medium
from splits.media.snow_packs import SnowPacks


class RunOptions(NamedTuple):
    """Options of a run that do not concern its scene.

    Attributes
    ----------
    seed : int
    threads : int
        Results do not depend on it.
    kernel : {"auto", "vectorized", "scalar"}
    progress : callable or None
        Receives a `Progress` at most twice per second.
    start_time : float
        `time.perf_counter` at the start.
    """

    seed: int
    threads: int
    kernel: Kernel
    progress: ProgressCallback
    start_time: float

    @classmethod
    def start(
        cls,
        seed: int,
        threads: int | None = None,
        kernel: Kernel = "auto",
        progress: ProgressCallback = None,
    ) -> RunOptions:
        """Return the options of a run that starts now."""
        return cls(seed, threads or count_cpus(), kernel, progress, time.perf_counter())

    def make_attributes(
        self, title: str, instrument: str, medium: Medium | SnowPacks
    ) -> dict[str, Any]:
        """Return the attributes of a dataset at the end of a run."""
        attributes = {
            "title": f"{title}: {medium.kind}",
            "instrument": instrument,
            "medium": medium.kind,
            **{f"{medium.kind}_{key}": value for key, value in medium.describe().items()},
            "seed": self.seed,
            "threads": self.threads,
            "wall_time_s": round(time.perf_counter() - self.start_time, 3),
            "physics_sources_sha256": hash_physics_sources(),
        }
        return to_netcdf_attributes(attributes | make_provenance(instrument))


def make_wavelength_coordinate(wavelengths: np.ndarray) -> Variable:
    """Return the coordinate of vacuum wavelengths (nm)."""
    attributes = {**WAVELENGTH.attributes, "standard_name": "radiation_wavelength"}
    return "wavelength", wavelengths, attributes


def make_incidence_coordinate(incidence: Any, dims: tuple[str, ...] = ()) -> Variable:
    """Return the coordinate of the angle of incidence (°), or "diffuse".

    A selected variable keeps it, unlike attributes of its dataset, and a retrieval checks it.
    """
    attributes = INCIDENCE_ANGLE.attributes
    if isinstance(incidence, str):
        del attributes["units"]
    return dims, incidence, attributes
