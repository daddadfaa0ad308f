"""What an instrument records of delays: receiver, bins, pulse, depths; and where paths may end."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np

from splits.core.arrays import (
    as_1d_array,
    check_array_range,
    check_axis,
    check_increasing,
    read_columns,
)
from splits.core.declarations import Quantity
from splits.core.inputs import LIST_SCHEMA, NUMBERS_SCHEMA, Numbers, check_depths
from splits.core.spacing import describe_spacing, expand_spacing
from splits.core.validation import as_scalar, check_range, invalid
from splits.kernels.scene import NO_MAX_ORDER, WET_PORE, Layers
from splits.kernels.tallies.distributions import Receiver
from splits.materials.csv_table import to_columns
from splits.materials.library import is_dataset
from splits.materials.refractive_index import (
    WATER_RANGE_NM,
    GroupIndex,
    compute_group_index,
    compute_temperature_effect,
    compute_water_group_index,
)
from splits.media.medium import Medium
from splits.media.snow import Snow
from splits.simulation.scene import compute_path_fractions

SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum (m/s), exact."""
DEFAULT_EDGES_S = np.concatenate([[0.0], np.geomspace(1e-12, 1e-7, 51)])
"""Default delays between bins: ten per decade, to a path of 30 m in air."""
MAX_DELAY_S = 1e-3
"""Largest delay (s) of a record and of a pulse, a path of 300 km in air."""
MIN_BIN_S = 1e-18
"""Smallest width (s) of a bin; light moves by less than the size of an atom."""
SECONDS_HINT = "in nanoseconds? multiply by 1e-9"
PULSE_POINTS = 1025
"""Points of a table of a pulse."""
MIN_PULSE_STEPS = 8.0
"""Least time in steps of this table during which 80 % of the light is emitted."""
GAUSSIAN_HALF_LENGTH = 4.0
"""Half of the length of a Gaussian pulse, in standard deviations."""
FWHM_PER_SIGMA = math.sqrt(8.0 * math.log(2.0))
MIN_PATHS_SIGMA = 6.0
"""Standard deviations of the length of a path of many collisions beyond which none is expected."""
TRANSPORT_COLLISIONS = 10.0
"""Collisions until light is diffuse, an upper limit for the horizontal distance of its exit."""


class Pulse(NamedTuple):
    """Pulse of light, by the part that has been emitted.

    Attributes
    ----------
    delay_s : float, shape (points,)
        Uniform, from its centroid at 0; a single 0 for an instantaneous pulse.
    emitted : float, shape (points,)
        From 0 to 1.
    """

    delay_s: np.ndarray
    emitted: np.ndarray

    @classmethod
    def from_argument(cls, pulse: Any) -> Pulse:
        """Return a pulse: None, the width (s) of a Gaussian one, or ``delay_s`` and ``power``.

        Raises
        ------
        ValueError
            For a width that is not above 0, powers below 0, or columns of different lengths.
        """
        if pulse is None:
            return cls(np.zeros(1), np.ones(1))
        pulse = to_columns(pulse)
        if not isinstance(pulse, Mapping):
            width = check_range(
                "pulse", pulse, 0.0, MAX_DELAY_S, "s", open_low=True, hint=SECONDS_HINT
            )
            sigma = width / FWHM_PER_SIGMA
            x = np.linspace(-GAUSSIAN_HALF_LENGTH, GAUSSIAN_HALF_LENGTH, PULSE_POINTS)
            return cls._from_power(sigma * x, np.exp(-0.5 * x**2))
        if set(pulse) != {"delay_s", "power"}:
            allowed = "a width in seconds, or the columns delay_s and power"
            raise invalid("pulse", sorted(map(str, pulse)), allowed)
        delay, power = read_columns("pulse", dict(pulse))
        _check_seconds("pulse.delay_s", delay)
        check_increasing("pulse.delay_s", delay)
        if delay.size < 2 or power.shape != delay.shape:
            raise invalid("pulse.power", power.size, "as many numbers as delay_s, at least 2")
        if (power < 0.0).any() or not power.any():
            raise invalid("pulse.power", float(power.min()), "numbers from 0, not all 0")
        return cls._from_power(delay, power / power.max())

    @classmethod
    def _from_power(cls, delay: np.ndarray, power: np.ndarray) -> Pulse:
        """Return a pulse of a power that is linear between delays, with its centroid at 0."""
        uniform = np.linspace(delay[0], delay[-1], PULSE_POINTS)
        fine = np.union1d(delay, uniform)
        fine_power = np.interp(fine, delay, power)
        light = 0.5 * (fine_power[1:] + fine_power[:-1]) * np.diff(fine)
        emitted = np.concatenate([[0.0], np.cumsum(light)])
        emitted /= emitted[-1]
        width = float(np.interp(0.9, emitted, fine) - np.interp(0.1, emitted, fine))
        if width < MIN_PULSE_STEPS * (uniform[1] - uniform[0]):
            allowed = f"at most {PULSE_POINTS / MIN_PULSE_STEPS:.0f} times as long as most light"
            raise invalid(
                "pulse.delay_s", f"{delay[-1] - delay[0]:.4g} s long", allowed,
                f"80 % of it is emitted within {width:.4g} s; leave out delays with little light",
            )  # fmt: skip
        # The mean delay of light whose power is linear between delays.
        step, (begin, end) = np.diff(fine), (fine_power[:-1], fine_power[1:])
        moment = step * (fine[:-1] * (begin + end) / 2.0 + step * (begin + 2.0 * end) / 6.0)
        centroid = float(moment.sum() / (0.5 * (begin + end) * step).sum())
        return cls(uniform - centroid, np.interp(uniform, fine, emitted))


def describe_record(
    pulse: Any, acceptance_deg: float | None, footprint_radius_m: float | None
) -> dict[str, Any]:
    """Return the attributes of a pulse and of a receiver, without those that are not given.

    A pulse has its width ``pulse_s`` (s), or the columns ``pulse_delay_s`` and ``pulse_power``.
    """
    columns = to_columns(pulse)
    attributes: dict[str, Any] = {}
    if isinstance(columns, Mapping):
        attributes = {f"pulse_{name}": np.asarray(values) for name, values in columns.items()}
    elif columns is not None:
        attributes = {"pulse_s": float(as_scalar(columns))}
    receiver = {"acceptance_deg": acceptance_deg, "footprint_radius_m": footprint_radius_m}
    return attributes | {
        name: float(as_scalar(value)) for name, value in receiver.items() if value is not None
    }


def _check_seconds(key: str, delays: np.ndarray) -> None:
    """Check that delays are in seconds."""
    check_array_range(key, delays, -MAX_DELAY_S, MAX_DELAY_S, "s", hint=SECONDS_HINT)


def check_delay_edges(key: str, delay_s: Any) -> np.ndarray:
    """Return the delays between bins (s), perhaps evenly spaced, after checking them."""
    delay_s = expand_spacing(key, delay_s) if isinstance(delay_s, Mapping) else delay_s
    edges = as_1d_array(key, delay_s, "numbers in seconds")
    _check_seconds(key, edges)
    if edges.size < 2:
        raise invalid(key, edges.tolist(), "at least two delays, the edges of bins")
    check_increasing(key, edges)
    if np.diff(edges).min() < MIN_BIN_S:
        raise invalid(key, edges.tolist(), f"at least {MIN_BIN_S:g} s apart")
    return edges


def _check_pulse(_: str, pulse: Any) -> Any:
    Pulse.from_argument(pulse)
    return pulse


DelayEdges = Annotated[
    Numbers,
    Quantity(
        "edges of the bins of delay", "s", check=check_delay_edges,
        schema={"anyOf": [{**LIST_SCHEMA, "minItems": 2}, *describe_spacing()]},
    ),
]  # fmt: skip
RecordEnd = Annotated[
    float | None,
    Quantity(
        "delay until which light counts in moments, by default the last of the bins", "s",
        low=0.0, infinite=True,
    ),
]  # fmt: skip
PulseInput = Annotated[
    Any,
    Quantity(
        "full width at half maximum of a Gaussian pulse (s), or delay_s and power of any pulse; by "
        "default, the pulse is instantaneous",
        check=_check_pulse,
        schema={
            "anyOf": [
                {"type": "number", "exclusiveMinimum": 0.0, "maximum": MAX_DELAY_S},
                {
                    "type": "object", "properties": {"delay_s": LIST_SCHEMA, "power": LIST_SCHEMA},
                    "required": ["delay_s", "power"], "additionalProperties": False,
                },
                {"type": "null"},
            ]
        },
    ),
]  # fmt: skip
AcceptanceAngle = Annotated[
    float | None,
    Quantity(
        "largest angle between received light and the direction to the source, by default all "
        "light is received at the surface", "degree", low=0.0, high=90.0, open_low=True,
    ),
]  # fmt: skip
FootprintRadius = Annotated[
    float | None,
    Quantity("radius of the field of view on the surface", "m", low=0.0, open_low=True),
]
RecordDepths = Annotated[
    Numbers | None,
    Quantity(
        "depths that divide the light by the largest depth reached",
        "m",
        check=check_depths,
        schema=NUMBERS_SCHEMA,
    ),
]


def check_record(edges: np.ndarray, end_s: float | None, pulse: Pulse) -> tuple[np.ndarray, float]:
    """Return the delays between bins, and the end of the record (s), after checking them.

    Raises
    ------
    ValueError
        For delays before the pulse, or a record that is shorter than the pulse or than the bins.
    """
    earliest, length = float(pulse.delay_s[0]), float(np.ptp(pulse.delay_s))
    if edges[0] < earliest:
        hint = "light cannot return before it was sent; delays count from the centre of the pulse"
        raise invalid("delay_s", edges[0], f"at least {earliest:.4g} s", hint)
    if edges[-1] - edges[0] < length:
        raise invalid(
            "pulse", f"{length:.4g} s long", f"at most {edges[-1] - edges[0]:.4g} s, the record",
            "give a shorter pulse, or a longer delay_s",
        )  # fmt: skip
    if end_s is None:
        return edges, float(edges[-1])
    if end_s == math.inf:
        return edges, math.inf
    hint = "not before the end of the bins; it may be infinite"
    return edges, check_range("end_s", end_s, float(edges[-1]), math.inf, "s", hint=hint)


def check_granular_layers(medium: Medium) -> None:
    """Check that all layers consist of grains."""
    for number, layer in enumerate(medium.scene_layers):
        if not layer.has_grains:
            hint = "delays need materials with a group index"
            raise invalid(f"layers[{number}]", layer.kind, "a layer of grains", hint)


def limit_depths(depth_m: Any, medium: Medium) -> np.ndarray:
    """Return depths that divide light by the largest depth reached (m), after checking them."""
    if depth_m is None:
        return np.zeros(0)
    return check_axis(
        "depth_m", np.asarray(depth_m), 0.0, float(medium.depth_m), "m", open_low=True,
        open_high=True,
    )  # fmt: skip


def make_receiver(
    incidence_deg: float | str, acceptance_deg: float | None, radius_m: float | None
) -> Receiver:
    """Return the receiver of reflected light.

    Parameters
    ----------
    incidence_deg : float or "diffuse"
    acceptance_deg : float or None
        Largest angle between the light and the direction towards the source; None accepts all.
    radius_m : float or None
        Radius of the field of view on the surface; None for no limit.
    """
    radius = math.inf if radius_m is None else radius_m
    if isinstance(incidence_deg, str) and not (acceptance_deg is None and radius_m is None):
        given = {"acceptance_deg": acceptance_deg, "footprint_radius_m": radius_m}
        key = next(key for key, value in given.items() if value is not None)
        raise invalid(key, given[key], "left out for diffuse light", "it needs a beam")
    if acceptance_deg is None:
        return Receiver(np.array([0.0, 0.0, 1.0]), -2.0, radius, 0.0)
    angle = math.radians(float(incidence_deg))
    direction = np.array([-math.sin(angle), 0.0, math.cos(angle)])
    return Receiver(direction, math.cos(math.radians(acceptance_deg)), radius, 1.0 / SPEED_OF_LIGHT)


def compute_max_order(medium: Medium, layers: Layers, receiver: Receiver, end_s: float) -> int:
    """Return an order of scattering that no light reaches before a delay (s).

    Collisions are at least as far apart as the pore space between them, in which light has at most
    the speed of light in vacuum (group indices of pores of 1 or more).  Between two hits of the
    ground, light is scattered, or crosses the medium twice.
    """
    if math.isinf(end_s):
        return NO_MAX_ORDER
    pore_fraction = min(layer.pore_fraction for layer in medium.scene_layers)
    per_second = layers.collision_coefficient.max() * SPEED_OF_LIGHT / pore_fraction
    n_collisions = per_second * end_s
    tilt = SPEED_OF_LIGHT * receiver.inverse_speed * math.hypot(*receiver.direction[:2])
    # Light may leave closer to the receiver than the beam enters.
    distance = 2.0 * math.sqrt(TRANSPORT_COLLISIONS * max(n_collisions, 1.0))
    reach = per_second / SPEED_OF_LIGHT * receiver.footprint_radius
    n_collisions += tilt * min(MIN_PATHS_SIGMA * distance, reach)
    n_collisions += MIN_PATHS_SIGMA * math.sqrt(n_collisions) + MIN_PATHS_SIGMA**2
    if medium.reflecting_ground is not None:
        crossings = SPEED_OF_LIGHT * end_s / pore_fraction / medium.depth_m
        n_collisions = 2.0 * n_collisions + crossings
    return min(int(n_collisions) + 1, NO_MAX_ORDER)


# --------------------------------------------------------------------------------------------------
# Inverse of the group velocity of light along the paths that kernels record.


class Slowness(NamedTuple):
    """Inverse of the group velocity, per recorded path length in each material.

    Attributes
    ----------
    value, stderr : float, shape (wavelengths, columns)
        s/m; 0 for the ground.
    path_fractions : float, shape (columns,)
        Fraction of the recorded path length that lies in the material; 0 for the ground.
    """

    value: np.ndarray
    stderr: np.ndarray
    path_fractions: np.ndarray


def compute_slowness(medium: Medium, wavelengths: np.ndarray) -> Slowness:
    """Return the inverse of the group velocity in the materials of a medium (nm) and its ground."""
    group = compute_group_index(medium.compute_refractive_indices, wavelengths)
    _use_formulation_of_water(group, medium, wavelengths)
    fractions = compute_path_fractions(medium)
    values = [one * fractions / SPEED_OF_LIGHT for one in group]
    if medium.reflecting_ground is not None:
        values = [np.pad(one, ((0, 0), (0, 1))) for one in values]
        fractions = np.append(fractions, 0.0)
    return Slowness(values[0], values[1], fractions)


def _use_formulation_of_water(group: GroupIndex, medium: Medium, wavelengths: np.ndarray) -> None:
    """Set the group index of water to that of IAPWS, unless the user gave its refractive index."""
    layers: Any = medium.scene_layers
    rows = (wavelengths >= WATER_RANGE_NM[0]) & (wavelengths <= WATER_RANGE_NM[1])
    first = 0
    for layer in layers:
        has_water = layer.has_grains and layer.wet_fraction > 0.0
        if has_water and is_dataset("water", layer.refractive_index["water"]):
            water = compute_water_group_index(wavelengths[rows], isinstance(layer, Snow))
            for values, replacement in zip(group, water, strict=True):
                values[rows, first + WET_PORE] = replacement
            # The tables are those of warmer water.
            others = np.clip(wavelengths[~rows], *WATER_RANGE_NM)
            stderr = group.stderr[~rows, first + WET_PORE]
            effect = compute_temperature_effect(others)
            group.stderr[~rows, first + WET_PORE] = np.hypot(stderr, effect)
        first += len(layer.list_materials())
