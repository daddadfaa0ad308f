"""JSON schemas of configuration files, with which editors check and complete them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from inspect import signature
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from splits.core.atomic import atomic_write
from splits.core.declarations import list_inputs
from splits.core.spacing import GEOMSPACE_KEY, STEP_KEYS, describe_spacing
from splits.experiments.config.experiment import RESERVED_NAMES, ExperimentConfig
from splits.experiments.config.instruments import DEFAULT_KIND, make_instrument_schemas
from splits.experiments.config.media import PACKS_KIND, SAMPLE_KEY
from splits.experiments.config.settings import OUTPUT_FOLDERS, Settings
from splits.experiments.config.simulation import NAME_PATTERN
from splits.media.kinds import LAYERS_KEY, MEDIUM_CLASSES, MEDIUM_FACTORIES
from splits.media.parameters import list_amounts, list_declared_quantities
from splits.media.snow_pack_files import read_snow_packs
from splits.tables.axes import INCIDENCE


def write_schemas(folder: Path) -> list[Path]:
    """Write the schemas of files of experiments, media and settings; return their paths."""
    paths = []
    experiment = make_schema(ExperimentConfig)
    medium = {"$ref": "#/$defs/medium"} | {key: experiment[key] for key in ("$schema", "$defs")}
    schemas = {"experiment": experiment, "medium": medium, "config": make_schema(Settings)}
    for name, schema in schemas.items():
        paths.append(folder / f"{name}.schema.json")
        text = json.dumps(schema, indent=1, ensure_ascii=False) + "\n"
        with atomic_write(paths[-1]) as temporary_path:
            temporary_path.write_text(text, encoding="utf-8")
    return paths


def make_schema(model: type[BaseModel]) -> dict[str, Any]:
    """Return the schema of `ExperimentConfig` or `Settings`."""
    dialect = "https://json-schema.org/draft/2020-12/schema"
    schema = {"$schema": dialect, **model.model_json_schema()}
    definitions: dict[str, Any] = schema["$defs"]
    properties = schema["properties"]
    # The name of a file is the default of that of an experiment; settings may be in several files.
    del schema["required"]
    if model is ExperimentConfig:
        _add_media(properties, definitions)
        for key, allowed in (("name", ()), ("group", ("explorer",))):
            properties[key]["not"] = {"enum": [n for n in RESERVED_NAMES if n not in allowed]}
    else:
        properties["studies"]["propertyNames"] = {"pattern": f"^{NAME_PATTERN.pattern}$"}
        suffixes = "|".join(OUTPUT_FOLDERS).replace(".", "")
        definitions["Study"]["properties"]["outputs"]["propertyNames"] = {
            "pattern": rf"^{NAME_PATTERN.pattern}\.({suffixes})$"
        }
    return dict(_simplify(schema, definitions))


def _add_media(properties: dict[str, Any], definitions: dict[str, Any]) -> None:
    """Add the keywords of media, and the parameters of grids, to the schema of experiments."""
    media = {kind: _make_medium(kind, factory) for kind, factory in MEDIUM_FACTORIES.items()}
    keywords = {key: True for medium in media.values() for key in medium["properties"]}
    media[PACKS_KIND] = _make_medium(PACKS_KIND, read_snow_packs)
    based = {"type": "object", "properties": keywords, "additionalProperties": False}
    # The kind of a medium with a base may be that of its base.
    choice = {"if": {"required": ["base"]}, "then": based, "else": {"$ref": "#/$defs/snow"}}
    definitions |= media
    references = {kind: {"$ref": f"#/$defs/{kind}"} for kind in media}
    definitions["medium"] = _make_choice(references, choice)
    description = properties["instrument"]["description"]
    instruments = make_instrument_schemas()
    choice = _make_choice(instruments, instruments[DEFAULT_KIND])
    properties["instrument"] = {**choice, "description": description}
    description = properties["medium"]["description"]
    properties["medium"] = {"$ref": "#/$defs/medium", "description": description}
    names = [*(key for key in keywords if key not in ("kind", "base")), INCIDENCE, SAMPLE_KEY]
    wholes = [name for name, one in list_declared_quantities().items() if one.parts]
    paths = rf"^(({'|'.join([*list_amounts(), *wholes])})\.\w+|{LAYERS_KEY}\.\d+\.\w+)$"
    given = {"type": ["array", "object"], "minItems": 1, "minProperties": 1}
    is_spacing = {"anyOf": [{"required": [STEP_KEYS[0]]}, {"required": [GEOMSPACE_KEY]}]}
    properties["grid"] |= {
        "propertyNames": {"anyOf": [{"enum": names}, {"pattern": paths}]},
        "properties": {SAMPLE_KEY: given, LAYERS_KEY: given},
        "additionalProperties": {
            **given,
            "if": {"type": "object", **is_spacing},
            "then": {"anyOf": describe_spacing()},
        },
    }  # fmt: skip


def _make_medium(kind: str, factory: Callable[..., Any]) -> dict[str, Any]:
    """Return the schema of a kind of medium, from the declared inputs of its class."""
    meaning = "name of a named medium, or of a file of config/media without its ending"
    base = {"type": "string", "description": f"{meaning}, with the other keywords"}
    properties: dict[str, Any] = {"kind": {"const": kind}, "base": base}
    declared = list_inputs(MEDIUM_CLASSES.get(kind, factory))
    for name, parameter in signature(factory).parameters.items():
        one = declared.get(name)
        properties[name] = one._replace(default=parameter.default).make_schema() if one else {}
    if LAYERS_KEY in properties:
        layers = {"type": "array", "items": {"$ref": "#/$defs/medium"}, "minItems": 1}
        properties[LAYERS_KEY] |= layers
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _make_choice(by_kind: Mapping[str, Any], default: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of a mapping whose key `kind` determines its schema."""
    has_kind = {"required": ["kind"]}
    return {
        "type": "object",
        "properties": {"kind": {"enum": list(by_kind)}},
        "allOf": [
            {"if": {"properties": {"kind": {"const": kind}}, **has_kind}, "then": schema}
            for kind, schema in by_kind.items()
        ] + [{"if": {"not": has_kind}, "then": default}],
    }  # fmt: skip


def _simplify(schema: Any, definitions: Mapping[str, Any]) -> Any:
    """Return a schema without titles, and with the key `kind` as the condition of its unions.

    Editors then report the wrong key, instead of a mapping that matches no alternative.
    """
    if isinstance(schema, list):
        return [_simplify(item, definitions) for item in schema]
    if not isinstance(schema, dict):
        return schema
    simplified: dict[str, Any] = {}
    for key, value in schema.items():
        if key == "description" and isinstance(value, str):
            # A docstring, whose lines end at the margin of the source.
            simplified[key] = " ".join(value.split())
        elif key != "title" or not isinstance(value, str):
            simplified[key] = _simplify(value, definitions)
    if "oneOf" in simplified:
        references = simplified.pop("oneOf")
        models = [definitions[one["$ref"].rpartition("/")[2]] for one in references]
        kinds = [model["properties"]["kind"]["const"] for model in models]
        pairs = zip(references, models, strict=True)
        optional = [one for one, model in pairs if "kind" not in model.get("required", ())]
        by_kind = dict(zip(kinds, references, strict=True))
        simplified |= _make_choice(by_kind, optional[0] if optional else {"required": ["kind"]})
    return simplified
