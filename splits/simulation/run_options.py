"""Options common to all instruments, and the attributes and coordinates of their datasets."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from splits.core.arrays import as_1d_array, check_array_range, check_axis
from splits.core.progress import ProgressCallback
from splits.core.provenance import hash_physics_sources
from splits.core.uncertainty import Variable
from splits.core.validation import (
    check_choice,
    check_integer,
    check_range,
    invalid,
    suggest_name,
    suggest_number,
)
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.media.medium import Medium
from splits.simulation.threads import count_cpus

# --------------------------------------------------------------------------------------------------
# Checks of arguments that several instruments have in common.

WAVELENGTH_RANGE_NM = (200.0, 100_000.0)
FULL_TURN_DEG = 360.0
HALF_WIDTH_RANGE_M = {"beam_spread": (1e-9, 1e6), "surface_map": (1e-9, 1e9), "lens": (1e-9, 1e6)}
"""Smallest and largest half edge (m) of the square that an instrument observes."""
MAX_DATASET_VALUES = 10_000_000
"""Largest number of values of a quantity over wavelength and direction: a run takes about thirty
times their memory."""


def check_wavelengths(
    wavelength_nm: Any, key: str = "wavelength_nm", *, is_sorted: bool = True
) -> np.ndarray:
    """Return wavelengths (nm) as an array, after checking their range.

    They must be strictly increasing unless `is_sorted` is false.
    """
    values = as_1d_array(key, wavelength_nm, "numbers in nanometres")
    if is_sorted:
        return check_axis(key, values, *WAVELENGTH_RANGE_NM, "nm")
    return check_array_range(key, values, *WAVELENGTH_RANGE_NM, "nm")


def check_incidence(incidence_deg: Any) -> float | str:
    """Return the angle of incidence in [0, 89.9999] degrees, or "diffuse", after checking it."""
    if isinstance(incidence_deg, str):
        if incidence_deg == "diffuse":
            return incidence_deg
        allowed = "an angle in degrees, or diffuse"
        hint = suggest_number(incidence_deg) or suggest_name(incidence_deg, ["diffuse"])
        raise invalid("incidence_deg", incidence_deg, allowed, hint)
    return check_single_angle(incidence_deg, "an angle in degrees, or diffuse")


def check_beam_angle(incidence_deg: Any) -> float:
    """Return the polar angle of a beam in [0, 89.9999] degrees, after checking it."""
    if isinstance(incidence_deg, str):
        hint = suggest_number(incidence_deg) or "this instrument takes a beam"
        raise invalid("incidence_deg", incidence_deg, "an angle", hint)
    return check_single_angle(incidence_deg, "an angle in degrees")


def check_single_angle(incidence_deg: Any, allowed: str) -> float:
    """Return one angle of incidence in [0, 89.9999] degrees, after checking it."""
    if isinstance(incidence_deg, Iterable) and getattr(incidence_deg, "shape", None) != ():
        hint = "one call for each angle, or an experiment with a grid"
        raise invalid("incidence_deg", incidence_deg, allowed, hint)
    return check_range("incidence_deg", incidence_deg, 0.0, 89.9999, "degrees")


def check_half_width(instrument: str, half_width_m: Any) -> float:
    """Return half the edge of the square that an instrument observes (m), after checking it.

    Parameters
    ----------
    instrument : str
        Key of `HALF_WIDTH_RANGE_M`.
    half_width_m : number
    """
    return check_range("half_width_m", half_width_m, *HALF_WIDTH_RANGE_M[instrument], "m")


def check_threads(threads: Any) -> int:
    """Return a number of threads; None gives every CPU that this process may use."""
    if threads is None:
        return count_cpus()
    return check_integer("threads", threads, 1)


def check_direction_angles(key: str, values: Any, upper_deg: float) -> np.ndarray:
    """Return increasing angles from 0 to below `upper_deg` degrees, after checking them.

    Azimuths are from 0 to below 360 degrees everywhere.
    """
    angles = as_1d_array(key, values, "numbers in degrees")
    outside = angles[(angles < 0.0) | (angles >= upper_deg)]
    is_azimuth = upper_deg == FULL_TURN_DEG
    hint = f"write {outside[0] % FULL_TURN_DEG:g}" if is_azimuth and outside.size else ""
    return check_axis(key, angles, 0.0, upper_deg, "degrees", open_high=True, hint=hint)


def check_n_bins(n_bins: Any) -> tuple[int, int]:
    """Return the numbers of bins in polar and azimuth angle, after checking them (1 to 1000)."""
    try:
        polar, azimuth = (check_integer("n_bins", n, 1, 1000) for n in n_bins)
    except (TypeError, ValueError):
        raise invalid("n_bins", n_bins, "two whole numbers from 1 to 1000") from None
    return polar, azimuth


# --------------------------------------------------------------------------------------------------
# Options common to all instruments, and the attributes and coordinates of their datasets.

KERNELS = ("auto", "vectorized", "scalar")
"""Choices of kernel: vectorized where the scene allows it, vectorized or an error, or scalar."""


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
    kernel: str
    progress: ProgressCallback
    start_time: float

    @classmethod
    def from_arguments(
        cls, seed: Any, threads: Any = None, kernel: Any = "auto", progress: ProgressCallback = None
    ) -> RunOptions:
        """Return the options of a run that starts now, after checking all values."""
        return cls(
            check_integer("seed", seed, 0),
            check_threads(threads),
            check_choice("kernel", kernel, KERNELS),
            progress,
            time.perf_counter(),
        )

    def make_attributes(self, title: str, instrument: str, medium: Medium) -> dict[str, Any]:
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
    attributes = {
        "long_name": "wavelength in vacuum",
        "units": "nm",
        "standard_name": "radiation_wavelength",
    }
    return "wavelength", wavelengths, attributes
