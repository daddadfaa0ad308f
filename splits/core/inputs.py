"""Types of inputs that several media and instruments have, see `splits.core.declarations`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, Protocol

import numpy as np
import xarray as xr
from pydantic import AfterValidator, AllowInfNan, Strict

from splits.core.arrays import (
    as_1d_array,
    check_array_range,
    check_axis,
    check_named_numbers,
)
from splits.core.declarations import UNIT_SYMBOLS, Quantity
from splits.core.spacing import describe_spacing, expand_spacing
from splits.core.validation import (
    check_range,
    invalid,
    snap_to_limits,
    suggest_name,
    suggest_number,
)


def check_interval(limits: tuple[float, float]) -> tuple[float, float]:
    """Return the limits of an interval; reject an empty one."""
    if not limits[0] < limits[1]:
        raise invalid("", list(limits), "low < high")
    return limits


FiniteNumber = Annotated[float, Strict(), AllowInfNan(False)]
Interval = Annotated[tuple[FiniteNumber, FiniteNumber], AfterValidator(check_interval)]
INFINITE_HINT = "or infinite: .inf in YAML, math.inf in Python"


DISTRIBUTION = ("min", "max", "mean", "sd")
"""Numbers that describe a truncated normal distribution."""


def describe_numbers(*names: str, **limits: Any) -> dict[str, Any]:
    """Return the JSON schema of a list of numbers with names, all with the same limits."""
    numbers = [{"type": "number", **limits, "description": name} for name in names]
    n = len(names)
    return {"type": "array", "prefixItems": numbers, "minItems": n, "maxItems": n}


def check_truncated_normal(low: float) -> Callable[[str, Any], tuple[float, ...]]:
    """Return the check of (min, max, mean, sd) of a truncated normal distribution in [low, 1]."""

    def check(key: str, value: Any) -> tuple[float, ...]:
        *limits_and_mean, sd = check_named_numbers(key, value, DISTRIBUTION)
        minimum, maximum, mean = snap_to_limits(limits_and_mean, low, 1.0).tolist()
        if not low <= minimum <= mean <= maximum <= 1.0:
            raise invalid(key, value, f"{low:g} <= min <= mean <= max <= 1 (min, max, mean, sd)")
        check_range(f"{key} (sd)", sd, 0.0, 1.0)
        return minimum, maximum, mean, sd

    return check


def check_mapping(allowed: str) -> Callable[[str, Any], Mapping[Any, Any]]:
    """Return the check that a value is a mapping."""

    def check(key: str, value: Any) -> Mapping[Any, Any]:
        if not isinstance(value, Mapping):
            raise invalid(key, value, allowed)
        return dict(value)

    return check


def check_dataset(key: str, value: Any) -> xr.Dataset:
    """Return a dataset, after checking that it is one."""
    if not isinstance(value, xr.Dataset):
        raise invalid(key, type(value).__name__, "an xarray.Dataset")
    return value


ResultDataset = Annotated[xr.Dataset, Quantity("result of an instrument", check=check_dataset)]


# --------------------------------------------------------------------------------------------------
# Media.

Facetness = Annotated[
    tuple[float, float, float, float],
    Quantity(
        "facetness of the grains, mean", label="mean facetness", mean=2, scale=0.16,
        check=check_truncated_normal(0.0),
        schema=describe_numbers(*DISTRIBUTION, minimum=0.0, maximum=1.0),
    ),
]  # fmt: skip
Sphericity = Annotated[
    tuple[float, float, float, float],
    Quantity(
        "sphericity of the grains, mean", label="mean sphericity", mean=2, scale=0.16,
        check=check_truncated_normal(0.1),
        schema=describe_numbers(*DISTRIBUTION, minimum=0.0, maximum=1.0),
    ),
]  # fmt: skip
Saturation = Annotated[
    float,
    Quantity(
        "volume of water per volume of pores", low=0.0, high=1.0, label="water saturation",
        scale=0.16, root_at=0.0,
    ),
]  # fmt: skip
Depth = Annotated[
    float,
    Quantity(
        "thickness of the sample", "m", low=0.0, high=1e4, open_low=True, infinite=True,
        hint=INFINITE_HINT, label="depth",
    ),
]  # fmt: skip
Pores = Annotated[
    Mapping[str, float],
    Quantity(
        "fluids in the pores besides air and water",
        check=check_mapping("a mapping of fractions of the pore space by medium"),
        schema={"type": "object", "additionalProperties": {"type": "number"}},
    ),
]
RefractiveIndices = Annotated[
    Mapping[str, Any],
    Quantity(
        "refractive index", check=check_mapping("a mapping by material"), schema={"type": "object"}
    ),
]


# --------------------------------------------------------------------------------------------------
# Light and directions.

DIFFUSE = "diffuse"
"""Isotropic light in place of a beam."""
INCIDENT_STOKES = "incident_stokes"
"""Attribute of datasets: I, Q, U and V of the incident light."""
UNPOLARIZED_LIGHT = (1.0, 0.0, 0.0, 0.0)
"""Stokes vector of the incident light, by default."""
WAVELENGTH_RANGE_NM = (200.0, 100_000.0)
FULL_TURN_DEG = 360.0
MAX_DATASET_VALUES = 10_000_000
"""Largest number of values of a quantity over wavelength and direction: a run takes about thirty
times their memory."""


def get_incident_stokes(attributes: Mapping[Any, Any]) -> tuple[float, ...]:
    """Return I, Q, U and V of the incident light, unpolarized without the attribute."""
    return tuple(float(value) for value in attributes.get(INCIDENT_STOKES, UNPOLARIZED_LIGHT))


def check_wavelengths(key: str, wavelength_nm: Any, *, is_sorted: bool = True) -> np.ndarray:
    """Return wavelengths (nm) as an array, after checking their range.

    They must be strictly increasing unless `is_sorted` is false.  A mapping has a start, a stop and
    a step, both ends included, and `also` for additional ones.
    """
    if isinstance(wavelength_nm, Mapping):
        also = wavelength_nm.get("also")
        also = [] if also is None else as_1d_array(f"{key}.also", also, "numbers in nanometres")
        spaced = expand_spacing(key, wavelength_nm, others=("also",))
        wavelength_nm = np.unique(np.concatenate([spaced, also]))
    values = as_1d_array(key, wavelength_nm, "numbers in nanometres")
    check = check_axis if is_sorted else check_array_range
    return check(key, values, *WAVELENGTH_RANGE_NM, "nm")


def check_table_wavelengths(key: str, wavelength_nm: np.ndarray) -> None:
    """Check that increasing wavelengths of a table are not in micrometres."""
    low, last = WAVELENGTH_RANGE_NM[0], wavelength_nm[-1]
    if last < low:
        hint = f"in micrometres? write {1e3 * last:g}"
        raise invalid(f"{key}.wavelength_nm", float(last), f"up to at least {low:g} nm", hint)


def check_beam_angle(key: str, value: Any, allowed: str = "an angle in degrees") -> float:
    """Return the polar angle of a beam in [0, 89.9999] degrees, after checking it."""
    if isinstance(value, str):
        hint = suggest_number(value) or "this instrument takes a beam"
        raise invalid(key, value, "an angle", hint)
    if isinstance(value, Iterable) and getattr(value, "shape", None) != ():
        raise invalid(key, value, allowed, "one call for each angle, or an experiment with a grid")
    return check_range(key, value, 0.0, 89.9999, "degrees")


def check_incidence(key: str, value: Any) -> float | str:
    """Return the angle of incidence in [0, 89.9999] degrees, or "diffuse", after checking it."""
    allowed = f"an angle in degrees, or {DIFFUSE}"
    if isinstance(value, str) and value != DIFFUSE:
        raise invalid(key, value, allowed, suggest_number(value) or suggest_name(value, [DIFFUSE]))
    return DIFFUSE if isinstance(value, str) else check_beam_angle(key, value, allowed)


def check_polar_angles(key: str, values: Any) -> np.ndarray:
    """Return increasing angles from 0 to below 90 degrees, after checking them."""
    angles = as_1d_array(key, values, "numbers in degrees")
    return check_axis(key, angles, 0.0, 90.0, "degrees", open_high=True)


def check_azimuths(key: str, values: Any) -> np.ndarray:
    """Return increasing angles from 0 to below 360 degrees, after checking them."""
    angles = as_1d_array(key, values, "numbers in degrees")
    outside = angles[(angles < 0.0) | (angles >= FULL_TURN_DEG)]
    hint = f"write {outside[0] % FULL_TURN_DEG:g}" if outside.size else ""
    return check_axis(key, angles, 0.0, FULL_TURN_DEG, "degrees", open_high=True, hint=hint)


class Array(Protocol):
    """Array of any library, or labelled values of pandas and xarray."""

    def __array__(self) -> np.ndarray: ...


Numbers = float | Sequence[float] | Array | Mapping[str, float]
"""Numbers as users give them."""


def describe_array(**limits: float) -> dict[str, list[dict[str, Any]]]:
    """Return the JSON schema of a list of numbers, or of a single one, with limits."""
    number = {"type": "number", **limits}
    return {"anyOf": [{"type": "array", "items": number, "minItems": 1}, number]}


NUMBERS_SCHEMA = describe_array()
LIST_SCHEMA = NUMBERS_SCHEMA["anyOf"][0]
WAVELENGTHS_SCHEMA = describe_array(minimum=WAVELENGTH_RANGE_NM[0], maximum=WAVELENGTH_RANGE_NM[1])
ANGLE_SCHEMA = {"type": "number", "minimum": 0.0, "maximum": 89.9999}

WAVELENGTH = Quantity(
    "wavelength in vacuum", "nm", check=check_wavelengths,
    schema={
        "anyOf": [
            *WAVELENGTHS_SCHEMA["anyOf"], *describe_spacing(also=WAVELENGTHS_SCHEMA["anyOf"][0]),
        ]
    },
)  # fmt: skip
INCIDENCE_ANGLE = Quantity(
    "angle of incidence", "degree", label="incidence", scale=16.0, check=check_incidence,
    schema={"anyOf": [ANGLE_SCHEMA, {"const": DIFFUSE}]},
)  # fmt: skip
POLAR_ANGLE = Quantity(
    "angle from the normal", "degree", check=check_polar_angles,
    schema=describe_array(minimum=0.0, exclusiveMaximum=90.0),
)  # fmt: skip
AZIMUTH_ANGLE = Quantity(
    "angle from the direction in which the beam travels", "degree", check=check_azimuths,
    schema=describe_array(minimum=0.0, exclusiveMaximum=FULL_TURN_DEG),
)  # fmt: skip
Wavelengths = Annotated[Numbers, WAVELENGTH]
Incidence = Annotated[float | str, INCIDENCE_ANGLE]
BeamAngle = Annotated[float, replace(INCIDENCE_ANGLE, check=check_beam_angle, schema=ANGLE_SCHEMA)]
PolarAngles = Annotated[Numbers, POLAR_ANGLE]
Azimuths = Annotated[Numbers, AZIMUTH_ANGLE]


def check_depths(key: str, values: Any) -> np.ndarray:
    """Return depths (m) as an array; the medium limits them."""
    return as_1d_array(key, values, "numbers in metres")


def declare_numbers(
    long_name: str, unit: str, plural: str, low: float, high: float, *, open_low: bool = False
) -> Quantity:
    """Return the quantity of increasing numbers in a range, in a unit with a name in the plural."""
    symbol = UNIT_SYMBOLS.get(unit, unit)

    def check(key: str, values: Any) -> np.ndarray:
        numbers = as_1d_array(key, values, f"numbers in {plural}")
        return check_axis(key, numbers, low, high, symbol, open_low=open_low)

    limits = {"exclusiveMinimum" if open_low else "minimum": low, "maximum": high}
    return Quantity(long_name, unit, check=check, schema=describe_array(**limits))


# --------------------------------------------------------------------------------------------------
# Accuracy, solver and options of a run.

MAX_STDERR = 0.5
"""Largest target error of a simulation."""
StandardError = Annotated[float, Quantity("largest standard error", low=1e-6, high=MAX_STDERR)]
RelativeError = Annotated[
    float, Quantity("largest relative standard error", low=1e-4, high=MAX_STDERR)
]
MaxRays = Annotated[int, Quantity("number of rays after which the run stops", low=1)]
Rays = Annotated[
    int | None, Quantity("number of rays, by default as many as the target error requires", low=1)
]
RayCount = Annotated[int, Quantity("number of rays, rounded up", low=1)]
Seed = Annotated[int, Quantity("seed of the random numbers", low=0)]
Threads = Annotated[int | None, Quantity("number of threads, by default of all CPUs", low=1)]
Kernel = Annotated[
    Literal["auto", "vectorized", "scalar"],
    Quantity(
        "kernel: vectorized traces many rays at once in single precision, scalar one after the "
        "other in double precision; auto chooses the former where it supports the medium"
    ),
]
Solver = Annotated[
    Literal["auto", "discrete_ordinates", "monte_carlo"],
    Quantity(
        "discrete ordinates solve the equation of radiative transfer in plane layers, Monte Carlo "
        "traces paths; auto solves the equation for natural snow where it is accurate enough"
    ),
]
