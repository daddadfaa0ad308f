"""Types of inputs that several media and instruments have, see `splits.core.declarations`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any

from splits.core.arrays import check_named_numbers
from splits.core.declarations import Quantity
from splits.core.validation import check_range, invalid, snap_to_limits

INFINITE_HINT = "or infinite: .inf in YAML, math.inf in Python"


def describe_numbers(count: int) -> dict[str, Any]:
    """Return the JSON schema of a list of numbers."""
    return {"type": "array", "items": {"type": "number"}, "minItems": count, "maxItems": count}


def check_truncated_normal(low: float) -> Callable[[str, Any], tuple[float, ...]]:
    """Return the check of (min, max, mean, sd) of a truncated normal distribution in [low, 1]."""

    def check(key: str, value: Any) -> tuple[float, ...]:
        *limits_and_mean, sd = check_named_numbers(key, value, ("min", "max", "mean", "sd"))
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
        return value

    return check


# --------------------------------------------------------------------------------------------------
# Media.

Facetness = Annotated[
    tuple[float, float, float, float],
    Quantity(
        "facetness of the grains, mean", mean=2, first_step=0.04,
        check=check_truncated_normal(0.0), schema=describe_numbers(4),
    ),
]  # fmt: skip
Sphericity = Annotated[
    tuple[float, float, float, float],
    Quantity(
        "sphericity of the grains, mean", mean=2, first_step=0.04,
        check=check_truncated_normal(0.1), schema=describe_numbers(4),
    ),
]  # fmt: skip
Saturation = Annotated[
    float,
    Quantity(
        "volume of water per volume of pores", low=0.0, high=1.0, first_step=0.04, root_at=0.0
    ),
]
Depth = Annotated[
    float,
    Quantity(
        "thickness of the sample", "m", low=0.0, high=1e4, open_low=True, infinite=True,
        hint=INFINITE_HINT,
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
