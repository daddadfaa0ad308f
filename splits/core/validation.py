"""Input validation: errors that name key, value, allowed range and a hint; paths of users."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from numbers import Integral, Real
from pathlib import Path
from reprlib import Repr
from typing import Any

import numpy as np

MAX_LISTED_NAMES = 24
"""Largest number of names listed in a message."""
NON_NUMERIC_TYPES = (bool, np.timedelta64)
"""Types that Python or NumPy treat as numbers but that are not accepted as such."""
ROUNDING_TOLERANCE = 1e-9
"""Relative tolerance at the limits of a range, for rounding."""
ZERO_TOLERANCE = 1e-12
"""Absolute tolerance at a limit of 0."""


TEXT_HINT = "this is text, not a number"
SEVERAL_HINTS = "one number, not several", "one value, not several"
"""Hints for several values in place of a number, and of another value."""
UNIT_SLIPS: dict[str, tuple[tuple[str, float, float], ...]] = {
    "°C": (("kelvin", 1.0, -273.15),),
    "nm": (("micrometres", 1e3, 0.0),),
    "µm": (("millimetres", 1e3, 0.0), ("metres", 1e6, 0.0)),
    "kg/m3": (("g/cm3", 1e3, 0.0),),
    "m": (("centimetres", 1e-2, 0.0),),
}
"""Units that are given in place of another one: name, factor and offset."""


class _ShortRepr(Repr):
    """Bounded representations; mappings keep their order."""

    def repr_dict(self, x: dict[Any, Any], level: int) -> str:
        """Return the text of a mapping with at most `maxdict` keys."""
        if level <= 0:
            return "{...}"
        pairs = [f"{self.repr1(k, level - 1)}: {self.repr1(v, level - 1)}" for k, v in
                 itertools.islice(x.items(), self.maxdict)]  # fmt: skip
        return "{" + ", ".join(pairs + ["..."] * (len(x) > self.maxdict)) + "}"


_SHORT_REPR = _ShortRepr()
_SHORT_REPR.maxlist = _SHORT_REPR.maxtuple = _SHORT_REPR.maxset = _SHORT_REPR.maxdict = 8
_SHORT_REPR.maxstring = _SHORT_REPR.maxother = 90
_SHORT_REPR.maxlevel = 4


def short_repr(value: object) -> str:
    """Return the text of a value for messages: one line, shortened if long.

    A function or a class is given by its name.
    """
    if callable(value) and hasattr(value, "__qualname__"):
        return str(value.__qualname__)
    text = _SHORT_REPR.repr(as_scalar(value))
    return text if "\n" not in text else " ".join(text.split())


def format_key(key: object) -> str:
    """Return the text of a user's key for messages: unchanged if short and printable."""
    text = str(key)
    return text if text.isprintable() and len(text) <= 90 else short_repr(text)


def join_names(names: Iterable[str]) -> str:
    """Return names joined by commas; a long list is truncated."""
    items = [str(name) for name in names]
    suffix = f", … ({len(items)} in all)" if len(items) > MAX_LISTED_NAMES else ""
    return ", ".join(items[:MAX_LISTED_NAMES]) + suffix


class InvalidValue(ValueError):
    """Invalid value of a key.

    Attributes
    ----------
    key : str
        Key, prefixed by its sections.
    value : object
    allowed : str
        Allowed values.
    hint : str
        Suggestion, may be empty.
    """

    def __init__(self, key: str, value: object, allowed: str, hint: str = "") -> None:
        super().__init__(key, value, allowed, hint)
        self.key, self.value, self.allowed, self.hint = key, value, allowed, hint

    def __repr__(self) -> str:
        """Return the message, also where a part of it has been replaced."""
        return f"{type(self).__name__}({str(self)!r})"

    def __str__(self) -> str:
        """Return the message, one line."""
        return self.format_message() + (f" ({self.hint})" if self.hint else "")

    def format_message(self) -> str:
        """Return the message without the hint."""
        return f"{self.key} = {short_repr(self.value)}: must be {self.allowed}"

    def add_prefix(self, prefix: str, extra_hint: str = "") -> InvalidValue:
        """Return the error with a section before the key and an additional hint."""
        hint = ") (".join(part for part in (self.hint, extra_hint) if part)
        key = ".".join(part for part in (prefix, self.key) if part)
        return type(self)(key, self.value, self.allowed, hint)


class UnknownKey(InvalidValue, TypeError):
    """Unknown key; `value` is None, and `allowed` names the known keys.

    In Python it is a keyword, for which a `TypeError` is expected.
    """

    def format_message(self) -> str:
        """Return the message without the hint."""
        return f"{format_key(self.key)}: unknown key, must be {self.allowed}"


class ConfigError(ValueError):
    """Invalid configuration; the message names file, line, key, value and range."""


def invalid(key: str, value: object, allowed: str, hint: str = "") -> InvalidValue:
    """Return the error for an invalid value of a key."""
    return InvalidValue(key, value, allowed, hint)


def check_relations(*relations: tuple[Any, str, object, str, *tuple[str, ...]]) -> None:
    """Check relations between inputs, and raise the error of the first one that does not hold.

    The values and texts of all relations are evaluated first.

    Parameters
    ----------
    *relations : (bool, str, object, str, str)
        Whether it holds, and the key, the value, the allowed values and, optionally, the hint of
        its error.
    """
    for holds, key, value, allowed, *hint in relations:
        if not holds:
            raise invalid(key, value, allowed, *hint)


MAX_LABEL_CHARS, MAX_TITLE_CHARS = 80, 200


def check_text(key: str, value: str, max_chars: int, multiline: bool = False) -> str:
    """Return a printable text of one or several lines; reject others."""
    joined = value.replace("\n", "").replace("\t", "") if multiline else value
    check_relations(
        (len(value) <= max_chars, key, value, f"at most {max_chars} characters"),
        (joined.isprintable(), key, value, "text without control characters or line breaks"),
    )
    return value


def unknown_key(key: str, known_names: Iterable[str]) -> UnknownKey:
    """Return the error for an unknown key, with the nearest known name as a hint."""
    names = list(known_names)
    hint = suggest_name(key.rsplit(".", 1)[-1].removeprefix("parameter "), names)
    return UnknownKey(key, None, f"one of {join_names(names)}", hint)


def has_surrogates(text: str) -> bool:
    """Return whether a text has halves of characters, which no file in UTF-8 holds."""
    return any("\ud800" <= character <= "\udfff" for character in text)


def to_text_keys(key: str, mapping: Mapping[Any, Any]) -> dict[str, Any]:
    """Return a mapping with keys converted to text; raise ValueError for duplicates."""
    renamed: dict[str, Any] = {}
    for name, value in mapping.items():
        if has_surrogates(str(name)):
            raise invalid(key, ascii(name), "texts that files in UTF-8 hold")
        if str(name) in renamed:
            raise invalid(key, name, "names that differ as texts", f"{name} is given twice")
        renamed[str(name)] = value
    return renamed


@contextmanager
def key_prefix(prefix: str) -> Iterator[None]:
    """Prefix the key of validation errors raised in the block with a section."""
    try:
        yield
    except InvalidValue as error:
        raise error.add_prefix(prefix) from None


def as_scalar(value: object) -> Any:
    """Return the Python scalar of a NumPy scalar or zero-dimensional array; others unchanged.

    Masked values have no scalar.  Dates are unchanged, because their `item` may be a plain number.
    """
    if getattr(value, "shape", None) != () or not hasattr(value, "item"):
        return value
    is_date = getattr(getattr(value, "dtype", None), "kind", "") in "mM"
    return value if is_date or np.ma.is_masked(value) else value.item()


def is_list(value: object) -> bool:
    """Return whether a value consists of several ones in some order."""
    is_other = isinstance(value, str | bytes | Mapping) or getattr(value, "shape", None) == ()
    return isinstance(value, Iterable) and not is_other


def suggest_number(text: object) -> str:
    """Return a hint for a number that is written as text, such as 0,3, or ""."""
    for decimal, hint in ((".", "without quotes"), (",", "with a decimal point")):
        with suppress(ValueError):
            number = float(str(text).replace(decimal, "."))
            return f"write {number:g}, {hint}" if math.isfinite(number) else ""
    return ""


def format_limit(limit: float, value: float) -> str:
    """Return the text of a limit, with as many digits as show on which side of it a value is."""
    texts = (f"{limit:.{digits}g}" for digits in (6, 9, 12, 15))
    return next((text for text in texts if _compare(float(text), value) == _compare(limit, value)),
                repr(float(limit)))  # fmt: skip


def _compare(one: float, other: float) -> int:
    return int(one > other) - int(one < other)


def suggest_unit(value: float, low: float, high: float, unit: str) -> str:
    """Return a hint for a number outside a range that would be in it in another unit, or ""."""
    slips = UNIT_SLIPS.get(unit, ())
    if not unit and low >= 0.0 and high <= 1.0:
        slips = (("per cent", 1e-2, 0.0),)
    # A number up to 2 is rather a fraction, or a length in metres, that is too large.
    if unit in ("", "m") and value <= 2.0:
        slips = ()
    for name, factor, offset in slips:
        converted = factor * value + offset
        if low <= converted <= high and not low <= value <= high:
            return f"in {name}? write {converted:.6g}"
    return ""


def check_number(key: str, value: object, allowed: str = "a finite number") -> float:
    """Return a finite number as a float; a zero-dimensional array counts as a number."""
    value = as_scalar(value)
    if isinstance(value, str):
        raise invalid(key, value, allowed, suggest_number(value) or TEXT_HINT)
    if isinstance(value, NON_NUMERIC_TYPES) or not isinstance(value, Real):
        raise invalid(key, value, allowed, SEVERAL_HINTS[0] if is_list(value) else "")
    with suppress(OverflowError):
        if math.isfinite(value):
            return float(value)
    raise invalid(key, value, allowed)


def snap_to_limits(values: Any, low: float, high: float) -> np.ndarray:
    """Return numbers, with those outside a range by rounding only set to its limit."""
    x = np.asarray(values, dtype=float)
    for limit, outside in ((float(low), x < low), (float(high), x > high)):
        if outside.any():
            within_rounding = np.abs(x - limit) <= (
                ROUNDING_TOLERANCE * abs(limit) if limit else ZERO_TOLERANCE
            )
            x = np.where(outside & within_rounding, limit, x)
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
    """Return a number as a float after checking that it is in a range.

    Numbers outside the range by rounding only are set to the limit.

    Parameters
    ----------
    key : str
        Key named in error messages.
    value : object
    low, high : float
        Limits, included unless `open_low` or `open_high`; may be infinite.
    unit : str
        Unit shown with the range.
    hint : str
        Suggestion for the message.
    """

    def describe_range(value: float) -> str:
        lower, upper = (format_limit(limit, value) for limit in (low, high))
        if math.isinf(high):
            allowed = f"{'above' if open_low else 'at least'} {lower}"
        else:
            left, right = "(" if open_low else "[", ")" if open_high else "]"
            allowed = f"in {left}{lower}, {upper}{right}"
        return f"{allowed} {unit}" if unit else allowed

    try:
        x = check_number(key, value)
    except InvalidValue as error:
        error.allowed = describe_range(math.nan)
        raise
    if not low <= x <= high:
        x = float(snap_to_limits(x, low, high))
    if x < low or x > high or (open_low and x == low) or (open_high and x == high):
        hints = suggest_unit(x, low, high, unit), hint
        raise invalid(key, value, describe_range(x), "; ".join(filter(None, hints)))
    return x


def check_flag(key: str, value: Any) -> bool:
    """Return a truth value; raise `InvalidValue` for any other type, such as a text."""
    if not isinstance(value, bool | np.bool_):
        raise invalid(key, value, "true or false", SEVERAL_HINTS[1] if is_list(value) else "")
    return bool(value)


def check_choice(key: str, value: object, choices: Iterable[str]) -> str:
    """Return `value` after checking that it is one of `choices`."""
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
    "ground_albedo": "ground",
    "sza": "incidence_deg",
    "solar_zenith": "incidence_deg",
    "vza": "polar_deg",
    "view_zenith": "polar_deg",
    "sensor_zenith": "polar_deg",
    "raa": "azimuth_deg",
    "relative_azimuth": "azimuth_deg",
}
"""Common synonyms of keywords, also with the unit ``_deg``."""
SYNONYM_NOTES = {
    "azimuth_deg": "azimuth_deg is 180 minus a relative azimuth that is 0 on the side of the sun",
}
"""How keywords differ from their synonyms."""
LOCATION_NOTES = {
    "incidence_deg": "incidence_deg is an argument of instruments, and of tables with this axis",
}
"""Where keywords are given that a call does not take."""
NAME_ALIASES = {
    "soot": ("black_carbon", "impurities_ng_g"),
    "bc": ("black_carbon", "impurities_ng_g"),
    "dust": ("dust_sahara", "impurities_ng_g"),
    "incidence_deg": ("zenith_deg",),
    "end": ("stop",),
    "from": ("start",),
    "to": ("stop",),
    "by": ("step",),
    "overcast": ("midlatitude_winter_cloudy",),
    "diffuse": ("midlatitude_winter_cloudy",),
    "am1.5": ("astm_g173",),
    "spectrometer": ("spectrophotometer",),
    "brdf": ("goniophotometer",),
    "bssrdf": ("beam_spread",),
    "lidar": ("time_of_flight",),
}
"""Other names: of impurities and the keyword that takes them, of skies, keywords, instruments."""


def suggest_name(name: object, names: Iterable[str]) -> str:
    """Return a hint for a misspelt name or a common synonym, such as "did you mean …?", or ""."""
    known = list(names)
    lower = str(name).lower()
    keyword = KEYWORD_ALIASES.get(lower.removesuffix("_deg"), lower)
    synonyms = (lower, *NAME_ALIASES.get(lower, ()), keyword, *NAME_ALIASES.get(keyword, ()))
    matches = [synonym for synonym in synonyms if synonym in known][:1]
    # Names with other letter cases or separators, similar ones, and longer ones with this word.
    normalized = lower.replace("-", "_").replace(" ", "_")
    matches = matches or [one for one in known if one.lower() in (lower, normalized)]
    matches = matches or get_close_matches(str(name)[:90], known, n=1)
    matches = matches or [one for one in known if lower in one.lower().split("_")]
    if not matches:
        return LOCATION_NOTES.get(keyword, "")
    note = SYNONYM_NOTES.get(keyword, "") if matches[0] == keyword != lower else ""
    return f"did you mean {' or '.join(matches[:4])}? {note}".strip()


MAX_INT64 = 2**63 - 1


def check_integer(key: str, value: Any, low: int, high: int = MAX_INT64) -> int:
    """Return a whole number from `low` to `high`, by default the largest that fits into 63 bits."""
    value = as_scalar(value)
    is_whole = isinstance(value, Integral) and not isinstance(value, NON_NUMERIC_TYPES)
    if is_whole and low <= value <= high:
        return int(value)
    is_too_large = is_whole and value > high
    limits = (
        f"of at least {low}" if high == MAX_INT64 and not is_too_large else f"from {low} to {high}"
    )
    hint = f"write {int(value)}" if isinstance(value, float) and value.is_integer() else ""
    raise invalid(key, value, f"a whole number {limits}", hint)


def expand_path(value: Any, key: str = "path", hint: str = "") -> Path:
    """Return a path with a leading ``~`` or ``~NAME`` expanded to the home directory.

    All paths given by users pass through this function: the shell does not expand ``~`` in
    ``--output=~/results``, and neither Python nor YAML expands it at all.

    Parameters
    ----------
    value : str or path
    key : str
        Key named in error messages.
    hint : str
        Hint for a value that is not a path.

    Raises
    ------
    ValueError
        If the value is not a path, or the home directory is unknown.
    """
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str):
        raise invalid(key, type(value).__name__, "the path of a file or a folder", hint)
    # The second characters are those of os.fsdecode for bytes that are no text.
    if "\0" in text or any(
        "\ud800" <= one <= "\udfff" and not "\udc80" <= one <= "\udcff" for one in text
    ):
        raise invalid(key, ascii(text), "a path of characters that file names may have")
    path = Path(os.path.expanduser(text))
    if not str(path).startswith("~"):
        return path
    if text.startswith("~"):
        hint = "write it in full, or with ./ in front if it lies here"
        raise invalid(key, text, "a path whose home is known", hint)
    # A relative path that begins with ~ after expansion is made absolute, so that a second
    # expansion leaves it unchanged.
    return Path.cwd() / path
