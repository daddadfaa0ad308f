"""Declared inputs: an annotated type states the meaning, the unit and the range of an input once.

A class or a function declares its inputs as ``Annotated[type, Quantity(...)]``.  From these follow
the check and its one-line message, the keys of experiment files, their JSON schema, the pages of
keywords, names and units in datasets, labels of axes, and steps of derivatives.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import KW_ONLY, InitVar, dataclass
from types import NoneType, UnionType
from typing import (
    Any,
    NamedTuple,
    ParamSpec,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import pydantic.dataclasses
from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic_core import CoreSchema, core_schema

from splits.core.validation import (
    MAX_INT64,
    SEVERAL_HINTS,
    InvalidValue,
    as_scalar,
    check_flag,
    check_integer,
    check_range,
    format_key,
    invalid,
    is_list,
    short_repr,
    suggest_name,
    suggest_number,
    unknown_key,
)

Class = TypeVar("Class", bound=type)
Given = ParamSpec("Given")
Result = TypeVar("Result")

UNIT_SYMBOLS = {
    "1": "", "1e-9": "ng/g", "degC": "°C", "degree": "degrees", "kg m-3": "kg/m3",
    "m2 kg-1": "m2/kg", "um": "µm", "m-1": "1/m",
}  # fmt: skip
"""Units in messages, where they differ from those of UDUNITS."""
AXIS_UNITS = {
    **UNIT_SYMBOLS,
    "degree": "°", "kg m-3": "kg m⁻³", "m2 kg-1": "m²/kg", "ml-1": "cells/ml",
}  # fmt: skip
"""Units of axes."""


def invert_unit(unit: str) -> str:
    """Return the inverse of a unit (UDUNITS), its positive powers first."""
    if unit in ("1", "1e-9"):
        return "1" if unit == "1" else f"({UNIT_SYMBOLS[unit]})-1"
    powers = [re.fullmatch(r"([^-\d]+)(-?\d+)?", factor) for factor in unit.split()]
    inverse = [(one[1], -int(one[2] or 1)) for one in powers if one]
    inverse.sort(key=lambda one: -one[1])
    return " ".join(name + (str(power) if power != 1 else "") for name, power in inverse)


MAX_DEFAULT_CHARS = 80
"""Largest length of a default in JSON schemas."""

# --------------------------------------------------------------------------------------------------
# Meaning of an input.


@dataclass(frozen=True, eq=False)
class Quantity:
    """Meaning of an input, beside the type that it annotates.

    Parameters
    ----------
    long_name : str
        Name in datasets and in the pages of keywords.
    unit : str
        Unit (UDUNITS).
    low, high : float
        Limits of a number, included unless `open_low` or `open_high`.
    infinite : bool
        Whether a number may be infinite, beyond `high`.
    hint : str
        Hint in messages.
    label : str
        Label of an axis, without the unit; by default the words of the key.
    mean : int, optional
        Position of the mean in a distribution, whose values up to it are shifted together; −1 for
        a range, whose mean is that of its ends.
    parts : tuple of str
        Names of fractions that add up to 1.
    kinds : callable, optional
        Function that returns the known keys of a mapping of amounts by kind, an example first.
    scale : float
        Size of the value by which steps of finite differences are chosen where it is smaller.
    root_at : float, optional
        End of the range near which reflectance depends on the square root of the distance.
    check : callable, optional
        Function of key and value that returns the value in its final form, or raises
        `InvalidValue`.  That of a number replaces the check of the limits.
    schema : mapping, optional
        JSON schema, by default that of the type.
    """

    long_name: str
    unit: str = "1"
    _: KW_ONLY
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    infinite: bool = False
    hint: str = ""
    label: str = ""
    mean: int | None = None
    parts: tuple[str, ...] = ()
    kinds: Callable[[], Sequence[str]] | None = None
    scale: float = 0.0
    root_at: float | None = None
    check: Callable[[str, Any], Any] | None = None
    schema: Mapping[str, Any] | None = None

    def __repr__(self) -> str:
        """Return the long name with its unit."""
        return f"{self.long_name} ({self.unit})" if self.unit != "1" else self.long_name

    @property
    def attributes(self) -> dict[str, str]:
        """Long name and units of a variable or a coordinate of a dataset."""
        return {"long_name": self.long_name, "units": self.unit}

    @property
    def is_distribution(self) -> bool:
        """Whether the input is a distribution, which is shifted as a whole."""
        return self.mean is not None and self.mean >= 0

    @property
    def is_mapping(self) -> bool:
        """Whether the input is a mapping, of which an experiment may change some keys."""
        return (self.schema or {}).get("type") == "object"

    def compute_mean(self, values: Sequence[float]) -> float:
        """Return the mean of a range or a distribution."""
        assert self.mean is not None
        return values[self.mean] if self.mean >= 0 else 0.5 * (values[0] + values[-1])

    def check_number(self, key: str, value: Any) -> float:
        """Return a number after checking that it is in the range."""
        value = as_scalar(value)
        if self.infinite and isinstance(value, float) and value == math.inf:
            return math.inf
        try:
            return check_range(
                key, value, self.low, self.high, UNIT_SYMBOLS.get(self.unit, self.unit),
                open_low=self.open_low, open_high=self.open_high, hint=self.hint,
            )  # fmt: skip
        except InvalidValue as error:
            if self.infinite and str(value).lower().strip("+.") == "inf":
                error.hint = "infinite is .inf in YAML, math.inf in Python"
            raise

    def check_integer(self, key: str, value: Any) -> int:
        """Return a whole number after checking that it is in the range."""
        low, high = (
            int(limit) if math.isfinite(limit) else MAX_INT64 if limit > 0 else -MAX_INT64
            for limit in (self.low, self.high)
        )
        return check_integer(key, value, low, high)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Return the schema with which pydantic checks the annotated type."""
        members = get_args(source) if get_origin(source) in (Union, UnionType) else (source,)
        kinds = [one for one in members if one is not NoneType]
        limits: dict[str, Any] = {
            "gt" if self.open_low else "ge": self.low,
            "lt" if self.open_high else "le": math.inf if self.infinite else self.high,
        }
        limits = {name: limit for name, limit in limits.items() if math.isfinite(limit)}
        by_kind: dict[Any, tuple[Callable[[str, Any], Any], CoreSchema]] = {
            float: (self.check_number, core_schema.float_schema(**limits)),
            int: (self.check_integer, core_schema.int_schema(**{"le": MAX_INT64} | limits)),
            bool: (check_flag, core_schema.bool_schema()),
        }
        any_kind = (self.check, core_schema.any_schema())
        check, described = any_kind if len(kinds) > 1 else by_kind.get(kinds[0], any_kind)
        check = self.check or check
        if check is None:
            return handler(source)
        plain = core_schema.with_info_plain_validator_function(
            lambda value, info: check(info.field_name or info.context or "", value),
            json_schema_input_schema=described,
        )
        return core_schema.nullable_schema(plain) if len(kinds) < len(members) else plain

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        """Return the JSON schema of the annotated type, with its meaning."""
        described = dict(handler(schema) if self.schema is None else self.schema)
        if self.check and self.schema and schema["type"] == "nullable":
            described = {"anyOf": [*described.get("anyOf", [described]), {"type": "null"}]}
        return described | {"description": self.describe()}

    def describe(self) -> str:
        """Return the long name with the unit as in messages."""
        unit = UNIT_SYMBOLS.get(self.unit, self.unit)
        return f"{self.long_name} ({unit})" if unit else self.long_name


# --------------------------------------------------------------------------------------------------
# Inputs of a class or a function.


def defer_check(key: str, value: Any) -> Any:
    """Return a value whose limits depend on other inputs: its class or function checks it."""
    return value


class Input(NamedTuple):
    """Declared input.

    Attributes
    ----------
    quantity : Quantity
    adapter : TypeAdapter
        Check of the annotated type.
    default : object
        `inspect.Parameter.empty` where the input must be given.
    """

    quantity: Quantity
    adapter: TypeAdapter[Any]
    default: Any

    @property
    def has_default(self) -> bool:
        """Whether the input has a default, other than none at all."""
        return self.default is not inspect.Parameter.empty and self.default is not None

    def make_schema(self) -> dict[str, Any]:
        """Return the JSON schema, with the meaning and a default that is short enough to read."""
        schema = self.adapter.json_schema() | {"description": self.quantity.describe()}
        if "anyOf" in schema:
            # Not a second time in the schema of a type that may also be None.
            schema["anyOf"] = [
                {key: value for key, value in one.items() if key != "description"}
                for one in schema["anyOf"]
            ]
        with suppress(TypeError, ValueError):
            text = json.dumps(self.default, allow_nan=False)
            if text not in ("null", "{}") and len(text) <= MAX_DEFAULT_CHARS:
                schema["default"] = json.loads(text)
        return schema

    def check(self, key: str, value: Any) -> Any:
        """Return a value in its final form, or raise `InvalidValue` with the key."""
        try:
            return self.adapter.validate_python(value, context=key)
        except ValidationError as error:
            raise describe_error(error, key, value) from None


@functools.cache
def list_inputs(declared: Any) -> dict[str, Input]:
    """Return the declared inputs of a class or a function by name."""
    is_class = isinstance(declared, type)
    hints = get_type_hints(declared if is_class else inspect.unwrap(declared), include_extras=True)
    inputs = {}
    for name, parameter in inspect.signature(declared).parameters.items():
        hint = hints.get(name)
        hint = hint.type if isinstance(hint, InitVar) else hint
        quantity = find_quantity(hint)
        if quantity:
            adapter: TypeAdapter[Any] = TypeAdapter(hint)  # type: ignore[arg-type]
            inputs[name] = Input(quantity, adapter, parameter.default)
    return inputs


def find_quantity(hint: Any) -> Quantity | None:
    """Return the quantity of an annotated type, or of the first member of a union with one."""
    found = [one for one in get_args(hint) if isinstance(one, Quantity)]
    if get_origin(hint) in (Union, UnionType):
        found = [one for member in get_args(hint) if (one := find_quantity(member))]
    return found[0] if found else None


# --------------------------------------------------------------------------------------------------
# Messages of pydantic's errors: one line with the key, the value, what is allowed and a hint.

MAPPING = "a mapping of keys to values"
ALLOWED = {
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "string_type": "text",
    "bool_type": "true or false",
    "tuple_type": "a list",
    "too_long": "a list of {max_length} values",
    "greater_than": "above {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "below {lt}",
    "less_than_equal": "at most {le}",
    "missing": "given",
}
"""What is allowed, by the type of an error of pydantic; others are of mappings."""


def describe_error(error: ValidationError, key: str = "", content: Any = None) -> ValueError:
    """Return the error of the deepest key, for which the branches of a union are joined.

    Parameters
    ----------
    error : pydantic.ValidationError
    key : str
        Key of the checked value, "" for keywords.
    content : mapping, optional
        The checked value, whose keys are those of the error, unlike the branches of unions.
    """
    errors = [(_locate(one["loc"], one["type"], content), one) for one in error.errors()]
    location, _ = max(errors, key=lambda one: (len(one[0]), one[1]["type"] != "missing"))
    branches = [one for other, one in errors if other == location]
    first = next((one for one in branches if one["type"] == "value_error"), branches[0])
    full_key = _join_keys((key, *location) if key else location)
    kind, value = first["type"], first["input"]
    if kind == "value_error":
        return _add_section(full_key, first["ctx"]["error"])
    if kind == "missing" and isinstance(location[-1], int):
        # A list of a certain number of values has too few.
        section = _join_keys(location[:-1])
        return invalid(section, value, f"a list of {len(errors) + len(value)} values")
    if kind == "missing":
        return invalid(full_key, None, "given")
    allowed = " or ".join(dict.fromkeys(map(_describe_allowed, branches)))
    return invalid(full_key, value, allowed, _suggest_value(value, branches))


def _locate(location: Sequence[Any], kind: str, content: Any) -> tuple[Any, ...]:
    """Return the keys in the location of an error, without the branches of unions.

    They are those that the content has, and the last one if it is missing.
    """
    keys = []
    for part in location:
        known = range(len(content)) if isinstance(content, list | tuple) else content
        if isinstance(known, Mapping | range) and part in known:
            content = content[part]
        elif part != "[key]" and (kind != "missing" or part != location[-1]):
            continue
        keys.append(part)
    return tuple(keys)


def _join_keys(location: Sequence[Any]) -> str:
    # A key that is itself invalid is the value of the error.
    keys, mark = (location[:-2], " (key)") if "[key]" in location else (location, "")
    parts = [f"[{one}]" if isinstance(one, int) else f".{format_key(one)}" for one in keys]
    return "".join(parts).removeprefix(".") + mark


def _add_section(location: str, error: Exception) -> ValueError:
    """Return the error of a validator, with the location before its key.

    The key may be complete, or repeat the name of the field that a validator checks.
    """
    if not isinstance(error, InvalidValue):
        return ValueError(str(error))
    section, _, field = location.rpartition(".")
    first = re.split(r"\W", error.key, maxsplit=1)[0]
    if location.removeprefix(error.key).startswith("["):
        # A number in a list that has this key.
        return type(error)(location, error.value, error.allowed, error.hint)
    if first == location.partition(".")[0]:
        return error
    return error.add_prefix(section if first == field else location)


def _describe_allowed(error: Any) -> str:
    """Return what an error of pydantic allows."""
    if error["type"] == "literal_error":
        names = sorted(re.findall("'(.*?)'", error["ctx"]["expected"]))
        return f"one of {', '.join(names)}" if len(names) > 1 else f'"{names[0]}"'
    context = error.get("ctx", {}).items()
    limits = {key: f"{limit:g}" if isinstance(limit, float) else limit for key, limit in context}
    return ALLOWED.get(error["type"], MAPPING).format(**limits)


def _suggest_value(value: Any, errors: Sequence[Any]) -> str:
    """Return a correction of a value that is nearly valid, or an empty string."""
    kinds = {error["type"] for error in errors}
    expected = " ".join(error.get("ctx", {}).get("expected", "") for error in errors)
    if names := re.findall("'(.*?)'", expected):
        return SEVERAL_HINTS[1] if is_list(value) else suggest_name(value, names)
    if isinstance(value, str):
        if "tuple_type" in kinds and "," in value:
            return f"write [{value}]"
        return suggest_number(value) if "float_type" in kinds else ""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if "tuple_type" in kinds:
            return f"write [{short_repr(value)}]"
        return "put it into quotes" if "string_type" in kinds else ""
    return ""


# --------------------------------------------------------------------------------------------------
# Classes that declare their inputs.


def alternative(*, replaces: str, compute: str, default: None) -> Any:
    """Return the field of an input that replaces another one.

    It is a keyword of the class, and a property of its objects.

    Parameters
    ----------
    replaces : str
        Input that is left out where this one is given.
    compute : str
        Method that returns the property.
    default : None
    """
    meaning = {"replaces": replaces, "compute": compute}
    return dataclasses.field(default=default, kw_only=True, metadata=meaning)


@dataclass_transform(
    frozen_default=True, eq_default=False, field_specifiers=(dataclasses.field, alternative)
)
def declare_class(declared: Class) -> Class:
    """Make a frozen dataclass, whose inputs are checked by their declarations.

    Errors are raised from its constructor, so that the traceback shows the line of the call.
    `__post_init__` receives the alternatives that are given, or None, in their order.
    """
    cls: Any = declared
    given_fields = {**getattr(cls, "_alternatives", {}), **vars(cls)}
    alternatives = {
        name: one for name, one in given_fields.items()
        if isinstance(one, dataclasses.Field) and "replaces" in one.metadata
    }  # fmt: skip
    hints = get_type_hints(cls, include_extras=True)
    texts = dict(cls.__annotations__)
    for name, one in alternatives.items():
        hint = hints[name]
        if not isinstance(hint, InitVar):
            hint = InitVar[hint | None]  # type: ignore[valid-type]
        cls.__annotations__[name] = hint
        setattr(cls, name, one)
    make = pydantic.dataclasses.dataclass(
        frozen=True, eq=False, repr=False, config=ConfigDict(arbitrary_types_allowed=True)
    )
    cls = make(cls)
    for name, one in alternatives.items():
        setattr(cls, name, property(getattr(cls, one.metadata["compute"])))
        # `dataclasses.replace` would give it beside the input that it replaces.
        del cls.__dataclass_fields__[name]
    cls._alternatives = alternatives
    cls.ALTERNATIVES = {name: one.metadata["replaces"] for name, one in alternatives.items()}
    construct = cls.__init__
    parameters = inspect.signature(cls).parameters
    names = list(parameters)
    positional = [n for n in names if parameters[n].kind is not inspect.Parameter.KEYWORD_ONLY]

    @functools.wraps(construct)
    def __init__(self: Any, *values: Any, **keywords: Any) -> None:
        given = {**dict(zip(positional, values, strict=False)), **keywords}
        for name in keywords:
            if name not in names:
                raise unknown_key(name, names)
        if len(given) < len(values) + len(keywords):
            # Raises Python's error for too many values, or for a value given twice.
            cls.__signature__.bind(*values, **keywords)
        check_alternatives(cls.ALTERNATIVES, given)
        try:
            construct(self, **given)
        except ValidationError as error:
            raise describe_error(error, content=given).with_traceback(None) from None
        except (InvalidValue, FileNotFoundError) as error:
            raise error.with_traceback(None) from None

    signature = [
        one.replace(annotation=texts.get(name, one.annotation)) for name, one in parameters.items()
    ]

    def __replace__(self: Any, **changes: Any) -> Any:
        replaced = {*changes, *(cls.ALTERNATIVES.get(name) for name in changes)}
        kept = {f.name: getattr(self, f.name) for f in dataclasses.fields(cls)}
        return cls(**{n: value for n, value in kept.items() if n not in replaced}, **changes)

    receiver = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    __init__.__signature__ = inspect.Signature([receiver, *signature])  # type: ignore[attr-defined]
    cls.__init__, cls.__signature__ = __init__, inspect.Signature(signature)
    cls.__replace__ = __replace__
    return cls


class other_constructor:
    """Decorator of a method that completes the keywords of another constructor of its class.

    The constructor has the signature of its class, all of it as keywords, with other defaults.

    Parameters
    ----------
    defaults : mapping
        Defaults that differ from those of the class.
    """

    def __init__(self, defaults: Mapping[str, Any]) -> None:
        self.defaults = defaults
        self.constructors: dict[Any, Callable[..., Any]] = {}

    def __call__(
        self, complete: Callable[[Any, dict[str, Any]], dict[str, Any]]
    ) -> other_constructor:
        """Take the method."""
        self.complete = complete
        return self

    def __get__(self, instance: object, owner: Callable[Given, Result]) -> Callable[Given, Result]:
        """Return the constructor, the same at each access."""
        if owner not in self.constructors:
            self.constructors[owner] = self._make(owner)
        return self.constructors[owner]

    def _make(self, owner: Callable[Given, Result]) -> Callable[Given, Result]:
        signature = inspect.signature(owner)
        names = dict(signature.parameters)

        @functools.wraps(self.complete)
        def construct(*values: Given.args, **keywords: Given.kwargs) -> Result:
            if values:
                alternatives = getattr(owner, "ALTERNATIVES", {})
                first, name = short_repr(values[0]), next(iter(alternatives | names))
                raise TypeError(f"{first}: must have a keyword, such as {name}={first}")
            for name in keywords:
                if name not in names:
                    raise unknown_key(name, names)
            try:
                return owner(**self.complete(owner, keywords))  # type: ignore[call-arg]
            except (InvalidValue, FileNotFoundError) as error:
                raise error.with_traceback(None) from None

        # Alternatives, which users give more often, come first.
        ordered = sorted(names.values(), key=lambda one: one.kind is not one.KEYWORD_ONLY)
        shown = [
            one.replace(
                kind=one.KEYWORD_ONLY, default=copy(self.defaults.get(one.name, one.default))
            )
            for one in ordered
        ]
        construct.__signature__ = signature.replace(parameters=shown)  # type: ignore[attr-defined]
        return construct


def check_alternatives(alternatives: Mapping[str, str], keywords: Mapping[str, Any]) -> None:
    """Check that no two keywords, or parameters of a layer, set the same input."""
    seen: dict[str, str] = {}
    for name, value in keywords.items():
        layer, _, own_name = name.rpartition(".")
        if own_name in alternatives and value is None:
            continue
        target = f"{layer}.{alternatives.get(own_name, own_name)}"
        if target in seen:
            allowed = f"left out where {seen[target]} is given"
            raise invalid(name, value, allowed, "they set the same field")
        seen[target] = name
