"""One way to refuse a bad value: name the key, the value, the allowed range and a hint."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from numbers import Real


def refuse(key: str, value: object, allowed: str, hint: str = "") -> ValueError:
    """Return the error that says why `value` cannot be taken for `key`."""
    return ValueError(f"{key} = {value!r}: must be {allowed}" + (f" ({hint})" if hint else ""))


def unknown_key(key: str, known: Iterable[str]) -> ValueError:
    """Return the error that says that there is no such key, and suggests the nearest."""
    names = list(known)
    hint = suggestion(key.rsplit(".", 1)[-1], names)
    text = f"{key}: unknown key, must be one of {', '.join(names)}"
    return ValueError(text + (f" ({hint})" if hint else ""))


@contextmanager
def under(place: str) -> Iterator[None]:
    """Put the place of a section before the key that a refusal within begins with."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{place}.{error}") from None


def number(key: str, value: object, allowed: str = "a finite number") -> float:
    """Return `value` as a float, or refuse it."""
    if isinstance(value, str):
        raise refuse(key, value, allowed, "this is text, not a number")
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(float(value)):
        raise refuse(key, value, allowed)
    return float(value)


def in_range(
    key: str,
    value: object,
    low: float,
    high: float,
    unit: str = "",
    *,
    open_low: bool = False,
    open_high: bool = False,
    hint: str = "",
) -> float:
    """Return `value` as a float if it lies between `low` and `high`, or refuse it.

    Parameters
    ----------
    key : str
        Name the user knows the value by.
    value : object
    low, high : float
        Limits, belonging to the range unless `open_low` or `open_high`; may be infinite.
    unit : str
        Shown with the range.
    hint : str
        What to do instead.
    """
    if math.isinf(high):
        allowed = f"{'above' if open_low else 'at least'} {low:g}"
    else:
        left, right = "(" if open_low else "[", ")" if open_high else "]"
        allowed = f"in {left}{low:g}, {high:g}{right}"
    allowed += f" {unit}" if unit else ""
    x = number(key, value, allowed)
    if x < low or x > high or (open_low and x == low) or (open_high and x == high):
        raise refuse(key, value, allowed, hint)
    return x


def numbers(key: str, value: object, names: tuple[str, ...]) -> tuple[float, ...]:
    """Return a sequence of ``len(names)`` floats, or refuse it."""
    allowed = f"{len(names)} numbers ({', '.join(names)})"
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise refuse(key, value, allowed)
    values = tuple(value)
    if len(values) != len(names):
        raise refuse(key, value, allowed)
    return tuple(number(f"{key} ({n})", v) for n, v in zip(names, values, strict=True))


def one_of(key: str, value: object, choices: Iterable[str]) -> str:
    """Return `value` if it is one of `choices`, or refuse it and suggest the nearest."""
    names = sorted(choices)
    if value in names:
        return str(value)
    raise refuse(key, value, "one of " + ", ".join(names), suggestion(value, names))


def suggestion(name: object, names: Iterable[str]) -> str:
    """Return "did you mean …?" for a misspelt name, or nothing."""
    near = get_close_matches(str(name), list(names), n=1)
    return f"did you mean {near[0]}?" if near else ""
