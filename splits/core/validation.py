"""One way to refuse a bad value: name the key, the value, the allowed range and a hint."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter, signature
from numbers import Real
from reprlib import Repr
from typing import Any, ParamSpec, TypeVar

import numpy as np

MAX_LISTED_NAMES = 24
"""A message lists so many names at most."""
NON_NUMERIC_TYPES = (bool, np.timedelta64)
"""Types that Python and NumPy count among the numbers."""
ROUNDING_TOLERANCE = 1e-9
"""Part of the end of a range by which rounding may take a number beyond it."""
ZERO_TOLERANCE = 1e-12
"""The same where the end is 0."""


class _ShortRepr(Repr):
    """Bounded representations; mappings keep their order."""

    def repr_dict(self, x: dict[Any, Any], level: int) -> str:
        """Return a mapping with as many keys as `maxdict` allows."""
        if level <= 0:
            return "{...}"
        pairs = [f"{self.repr1(k, level - 1)}: {self.repr1(v, level - 1)}" for k, v in
                 itertools.islice(x.items(), self.maxdict)]  # fmt: skip
        return "{" + ", ".join(pairs + ["..."] * (len(x) > self.maxdict)) + "}"


_SHORT_REPR = _ShortRepr()
_SHORT_REPR.maxlist = _SHORT_REPR.maxtuple = _SHORT_REPR.maxset = _SHORT_REPR.maxdict = 8
_SHORT_REPR.maxstring = _SHORT_REPR.maxother = 90
_SHORT_REPR.maxlevel = 4

Class = TypeVar("Class", bound=type)
Given = ParamSpec("Given")
Result = TypeVar("Result")


def short_repr(value: object) -> str:
    """Return a value as messages show it: on one line, and shortened where it is long."""
    text = _SHORT_REPR.repr(as_scalar(value))
    return text if "\n" not in text else " ".join(text.split())


def format_key(key: object) -> str:
    """Return a key that a user gave as messages show it: as it is, if that is short and plain."""
    text = str(key)
    return text if text.isprintable() and len(text) <= 90 else short_repr(text)


def join_names(names: Iterable[str]) -> str:
    """Return names with commas between them, of many the first."""
    known = [str(name) for name in names]
    more = f", … ({len(known)} in all)" if len(known) > MAX_LISTED_NAMES else ""
    return ", ".join(known[:MAX_LISTED_NAMES]) + more


class InvalidValue(ValueError):
    """A value that cannot be taken.

    Attributes
    ----------
    key : str
        What the user knows it by, with the sections that it stands in.
    value : object
    allowed : str
        What it must be.
    hint : str
        What to do instead, or nothing.
    """

    def __init__(self, key: str, value: object, allowed: str, hint: str = "") -> None:
        super().__init__(key, value, allowed, hint)
        self.key, self.value, self.allowed, self.hint = key, value, allowed, hint

    def __str__(self) -> str:
        """Return the message, one line."""
        return self.format_message() + (f" ({self.hint})" if self.hint else "")

    def format_message(self) -> str:
        """Return the message without the hint."""
        return f"{self.key} = {short_repr(self.value)}: must be {self.allowed}"

    def add_prefix(self, prefix: str, extra_hint: str = "") -> InvalidValue:
        """Return the refusal of the same value in a section, with one more hint."""
        hint = ") (".join(part for part in (self.hint, extra_hint) if part)
        return type(self)(f"{prefix}.{self.key}", self.value, self.allowed, hint)


class UnknownKey(InvalidValue):
    """A key that there is not; `value` is None, `allowed` names those that there are."""

    def format_message(self) -> str:
        """Return the message without the hint."""
        return f"{format_key(self.key)}: unknown key, must be {self.allowed}"


def invalid(key: str, value: object, allowed: str, hint: str = "") -> InvalidValue:
    """Return the error that says why `value` cannot be taken for `key`."""
    return InvalidValue(key, value, allowed, hint)


def unknown_key(key: str, known_names: Iterable[str]) -> UnknownKey:
    """Return the error that says that there is no such key, and suggests the nearest."""
    names = list(known_names)
    hint = suggest_name(key.rsplit(".", 1)[-1], names)
    return UnknownKey(key, None, f"one of {join_names(names)}", hint)


def list_keywords(kind: Any) -> list[str]:
    """Return the keywords of a dataclass: its fields, and others that it says it takes."""
    return [field.name for field in fields(kind)] + list(getattr(kind, "OTHER_KEYWORDS", ()))


def reject_unknown_keywords(kind: Class) -> Class:
    """Let a dataclass refuse keywords that it does not have by the list of those it has.

    Refusals are raised from here, see `reject_unknown_arguments`.
    """
    construct: Callable[..., None] = kind.__init__  # type: ignore[misc]

    @wraps(construct)
    def checked(self: Any, *values: Any, **keywords: Any) -> None:
        _call_checked(construct, list_keywords(kind), (self, *values), keywords)

    kind.__init__ = checked  # type: ignore[misc]
    return kind


def reject_unknown_arguments(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Let a public function refuse keywords that it does not have by the list of those it has.

    Refusals, and the news that a file is not there, are raised from here: a traceback shows the
    line that holds the mistake, and not what lies between it and the check.
    """
    parameters = signature(function).parameters
    open_ended = any(one.kind is Parameter.VAR_KEYWORD for one in parameters.values())
    names = None if open_ended else [name for name in parameters if name not in ("self", "cls")]

    @wraps(function)
    def checked(*values: Given.args, **keywords: Given.kwargs) -> Result:
        found: Result = _call_checked(function, names, values, keywords)
        return found

    return checked


def to_text_keys(key: str, mapping: Mapping[Any, Any]) -> dict[str, Any]:
    """Return a mapping with texts for names, or refuse two names that are the same text."""
    found: dict[str, Any] = {}
    for name, value in mapping.items():
        if str(name) in found:
            raise invalid(key, name, "names that differ as texts", f"{name} is there twice")
        found[str(name)] = value
    return found


def _call_checked(
    function: Callable[..., Any],
    names: list[str] | None,
    values: tuple[Any, ...],
    keywords: Mapping[str, Any],
) -> Any:
    """Call a function; raise from here that a keyword is unknown, or that a value is refused."""
    for key in keywords:
        if names is not None and key not in names:
            raise TypeError(str(unknown_key(key, names)))
    try:
        return function(*values, **keywords)
    except (InvalidValue, FileNotFoundError) as error:
        raise error.with_traceback(None) from None


@contextmanager
def key_prefix(prefix: str) -> Iterator[None]:
    """Put the place of a section before the key of a refusal within."""
    try:
        yield
    except InvalidValue as error:
        raise error.add_prefix(prefix) from None


def as_scalar(value: object) -> Any:
    """Return the number that a NumPy scalar or an array without dimensions holds, or the value.

    What is masked holds none, and `item` of a date is a number by which the date is no longer told.
    """
    if getattr(value, "shape", None) != () or not hasattr(value, "item"):
        return value
    date = getattr(getattr(value, "dtype", None), "kind", "") in "mM"
    return value if date or np.ma.is_masked(value) else value.item()


def check_number(key: str, value: object, allowed: str = "a finite number") -> float:
    """Return `value` as a float, or refuse it; an array without dimensions is a number."""
    value = as_scalar(value)
    if isinstance(value, str):
        raise invalid(key, value, allowed, "this is text, not a number")
    if isinstance(value, NON_NUMERIC_TYPES) or not isinstance(value, Real):
        raise invalid(key, value, allowed)
    try:
        x = float(value)
    except OverflowError:
        raise invalid(key, value, allowed) from None
    if not math.isfinite(x):
        raise invalid(key, value, allowed)
    return x


def snap_to_limits(values: Any, low: float, high: float) -> np.ndarray:
    """Return numbers, with those at the end of a range that only rounding has taken beyond it."""
    x = np.asarray(values, dtype=float)
    for end, beyond in ((float(low), x < low), (float(high), x > high)):
        if beyond.any():
            near = np.abs(x - end) <= (ROUNDING_TOLERANCE * abs(end) if end else ZERO_TOLERANCE)
            x = np.where(beyond & near, end, x)
    return x


def check_range(
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

    What rounding has taken beyond an end is that end.

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
    x = float(snap_to_limits(check_number(key, value, allowed), low, high))
    if x < low or x > high or (open_low and x == low) or (open_high and x == high):
        raise invalid(key, value, allowed, hint)
    return x


def check_choice(key: str, value: object, choices: Iterable[str]) -> str:
    """Return `value` if it is one of `choices`, or refuse it and suggest the nearest."""
    names = sorted(choices)
    if isinstance(value, str) and value in names:
        return value
    raise invalid(key, value, "one of " + join_names(names), suggest_name(value, names))


KEYWORD_ALIASES = {
    "ssa": "specific_surface_area_m2_kg",
    "surface_area": "specific_surface_area_m2_kg",
    "grain_radius": "optical_radius_um",
    "effective_radius": "optical_radius_um",
    "radius": "optical_radius_um",
    "lwc": "liquid_water_content",
    "wetness": "liquid_water_content",
    "water": "liquid_water_content",
    "impurities": "impurities_ng_g",
    "black_carbon": "impurities_ng_g",
    "algae": "algae_cells_ml",
    "thickness": "depth_m",
    "temperature": "temperature_c",
    "sza": "incidence_deg",
    "solar_zenith": "incidence_deg",
}
"""What others call some keywords."""
IMPURITY_ALIASES = {
    "soot": ("black_carbon", "impurities_ng_g"),
    "bc": ("black_carbon", "impurities_ng_g"),
    "dust": ("dust_sahara", "impurities_ng_g"),
}
"""What others call some kinds of impurities, which may stand for the keyword, too."""


def suggest_name(name: object, names: Iterable[str]) -> str:
    """Return "did you mean …?" for a misspelt name or one that others use, or nothing."""
    known = list(names)
    lower = str(name).lower()
    others = (lower, *IMPURITY_ALIASES.get(lower, ()), KEYWORD_ALIASES.get(lower))
    near = [one for one in others if one in known]
    near = near or get_close_matches(str(name)[:90], known, n=1)
    return f"did you mean {near[0]}?" if near else ""
