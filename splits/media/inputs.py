"""Validation and description of inputs common to several media."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

from splits.core.arrays import check_named_numbers
from splits.core.validation import as_scalar, check_range, invalid, snap_to_limits, suggest_name
from splits.materials import RefractiveIndex, make_refractive_index, parse_refractive_index
from splits.media.ground import Ground, describe_ground

EXPANDED_INPUTS = (
    "refractive_index", "interpretation", "ground", "pores",
    "impurities_ng_g", "algae_cells_ml", "impurities_in",
)  # fmt: skip
"""Inputs that expand to several dataset attributes."""
_TRUNCATED_NORMAL_NAMES = ("min", "max", "mean", "sd")


def check_truncated_normal(key: str, value: Any, low: float) -> tuple[float, ...]:
    """Return the validated (min, max, mean, sd) of a truncated normal distribution in [low, 1]."""
    *limits_and_mean, sd = check_named_numbers(key, value, _TRUNCATED_NORMAL_NAMES)
    minimum, maximum, mean = snap_to_limits(limits_and_mean, low, 1.0).tolist()
    if not low <= minimum <= mean <= maximum <= 1.0:
        raise invalid(key, value, f"{low:g} <= min <= mean <= max <= 1 (min, max, mean, sd)")
    check_range(f"{key} (sd)", sd, 0.0, 1.0)
    return minimum, maximum, mean, sd


def check_sample_depth(depth_m: Any) -> float:
    """Return the validated thickness of a granular layer (m), above 0 to 1e4 or infinite."""
    hint = "or infinite: .inf in YAML, math.inf in Python"
    if isinstance(as_scalar(depth_m), float) and depth_m == math.inf:
        return math.inf
    return check_range("depth_m", depth_m, 0.0, 1e4, "m", open_low=True, hint=hint)


def check_ground_reached(
    ground: Ground | None, is_semi_infinite: bool, above: str = "an infinite depth"
) -> None:
    """Check that a medium over a ground has a finite depth."""
    if ground is not None and is_semi_infinite:
        hint = f"no light reaches it below {above}: give depth_m"
        raise invalid("ground", ground.name, "left out", hint)


def make_refractive_indices(
    materials: Iterable[str], given: Any, pore_fluids: Iterable[str] = ()
) -> dict[str, RefractiveIndex]:
    """Return the refractive index of every material, by default that of its default dataset.

    Parameters
    ----------
    materials : iterable of str
    given : mapping
        Refractive indices by material; air may be among them and is 1 otherwise.
    pore_fluids : iterable of str, optional
        Other pore fluids; each must be given.

    Raises
    ------
    ValueError
        If `given` is not a mapping, or for a material that the medium does not have.
    """
    solids = list(materials)
    optional_materials = (
        [*pore_fluids, "air"]
        if isinstance(given, Mapping) and "air" in given
        else list(pore_fluids)
    )
    names = solids + optional_materials
    if not isinstance(given, Mapping):
        raise invalid("refractive_index", given, "a mapping by material")
    for name in given:
        if name not in names:
            raise invalid(
                "refractive_index",
                name,
                "a mapping with keys " + ", ".join(names),
                suggest_name(name, names),
            )
    return {m: make_refractive_index(m, given.get(m)) for m in solids} | {
        m: parse_refractive_index(m, given[m]) for m in optional_materials
    }


def describe_inputs(medium: Any) -> dict[str, Any]:
    """Return the inputs of a medium as dataset attributes.

    Parameters
    ----------
    medium : dataclass
        With the fields ``refractive_index``, ``interpretation`` and ``ground``, among others.
    """
    inputs = {
        f.name: getattr(medium, f.name) for f in fields(medium) if f.name not in EXPANDED_INPUTS
    }
    inputs |= {f"pores_{name}": fraction for name, fraction in medium.pores.items()}
    for material, index in medium.refractive_index.items():
        inputs[f"refractive_index_{material}"] = index.name
        if digest := getattr(index, "sha256", ""):
            inputs[f"refractive_index_{material}_sha256"] = digest
    inputs |= {f"interpretation_{k}": v for k, v in medium.interpretation.as_dict().items()}
    return inputs | describe_ground(medium.ground)
