"""Evenly or geometrically spaced numbers, given as `{start, stop, step}` or `{geomspace: …}`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from splits.core.validation import (
    check_number,
    check_relations,
    format_key,
    invalid,
    suggest_name,
    unknown_key,
)

MAX_NUMBERS = 20_000
"""Largest length of a sequence of numbers, such as wavelengths."""
STEP_KEYS = ("start", "stop", "step")
GEOMSPACE_KEY = "geomspace"


def describe_spacing(**others: Any) -> list[dict[str, Any]]:
    """Return the JSON schemas of evenly and of geometrically spaced numbers.

    The former may have other keys, each with its schema.
    """
    number = {"type": "number"}
    steps = dict.fromkeys(STEP_KEYS, number) | {"step": {"type": "number", "exclusiveMinimum": 0.0}}
    terms = {"type": "array", "items": number, "minItems": 3, "maxItems": 3}
    forms = [({**steps, **others}, list(STEP_KEYS)), ({GEOMSPACE_KEY: terms}, [GEOMSPACE_KEY])]
    return [
        {
            "type": "object", "properties": properties, "required": required,
            "additionalProperties": False,
        }
        for properties, required in forms
    ]  # fmt: skip


def make_even_spacing(key: str, start: float, stop: float, step: float) -> np.ndarray:
    """Return start, start + step, … up to and including stop."""
    enough = f"large enough for at most {MAX_NUMBERS} values"
    check_relations(
        (step > 0.0, f"{key}.step", step, "above 0"),
        (stop >= start, f"{key}.stop", stop, f"at least start = {start:g}"),
        # A step may be so small that the quotient is infinite.
        ((stop - start) / MAX_NUMBERS < step, f"{key}.step", step, enough),
    )
    values = start + step * np.arange(round((stop - start) / step) + 1)
    if not np.isclose(values[-1], stop, rtol=0.0, atol=1e-6 * step):
        last = start + step * math.floor((stop - start) / step)
        allowed = f"a whole number of steps from start, such as {last:g} or {last + step:g}"
        raise invalid(f"{key}.stop", stop, allowed)
    return values


def expand_spacing(key: str, values: Mapping[str, Any], others: tuple[str, ...] = ()) -> np.ndarray:
    """Return evenly or geometrically spaced numbers.

    Parameters
    ----------
    key : str
        Key in error messages.
    values : mapping
        ``{start, stop, step}``, or ``{geomspace: [first, last, number]}``.
    others : tuple of str
        Other keys of the mapping.
    """
    if set(values) == {GEOMSPACE_KEY}:
        return _expand_geomspace(f"{key}.{GEOMSPACE_KEY}", values[GEOMSPACE_KEY])
    if GEOMSPACE_KEY in values:
        raise invalid(key, dict(values), f"{GEOMSPACE_KEY} without other keys")
    hint = "start, stop and step give evenly spaced values"
    if not others:
        hint += "; label others otherwise"
    for name in [one for one in values if one not in (*STEP_KEYS, *others)]:
        if others:
            raise unknown_key(f"{key}.{format_key(name)}", [*STEP_KEYS, *others])
        list_hint = "list the values instead" if name == "also" else ""
        nearest = list_hint or suggest_name(name, STEP_KEYS) or hint
        raise invalid(f"{key}.{format_key(name)}", values[name], "left out", nearest)
    check_relations(*((name in values, f"{key}.{name}", None, "given", hint) for name in STEP_KEYS))
    start, stop, step = (check_number(f"{key}.{name}", values[name]) for name in STEP_KEYS)
    # Rounding removes digits such as those of 0.30000000000000004.
    return _round(make_even_spacing(key, start, stop, step), 12)


def _round(values: np.ndarray, digits: int) -> np.ndarray:
    return np.array([float(f"{x:.{digits}g}") for x in values])


def _expand_geomspace(key: str, given: Any) -> np.ndarray:
    """Return geometrically spaced numbers."""
    allowed = "[first, last, number of values]: 0 < first < last, at least two"
    if not isinstance(given, (list, tuple)) or len(given) != 3:
        raise invalid(key, given, allowed)
    first, last, count = (check_number(key, value) for value in given)
    if not 0.0 < first < last or count != int(count) or not 2 <= count <= MAX_NUMBERS:
        raise invalid(key, given, allowed)
    # Four digits keep the labels of figures short.
    return _round(np.geomspace(first, last, int(count)), 4)
