"""Model of a simulation: medium, instrument and grid of an experiment file.

Media and instruments check their values themselves.  Of a grid, the first point and the values of
each axis are built when a file is read, and all points when it runs.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from inspect import signature
from typing import Annotated, Any

from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    PlainValidator,
    WithJsonSchema,
    model_validator,
)

from splits.core.inputs import check_incidence
from splits.core.validation import (
    SEVERAL_HINTS,
    InvalidValue,
    UnknownKey,
    check_choice,
    check_relations,
    expand_path,
    invalid,
    unknown_key,
)
from splits.experiments.config.instruments import (
    TABLE,
    USE_GRID_HINT,
    Instrument,
    list_section_inputs,
)
from splits.experiments.config.media import (
    MAX_GRID_POINTS,
    PACKS_KIND,
    SAMPLE_KEY,
    apply_paths,
    identify_by_content,
    is_merged,
    label_grid,
    list_table_paths,
    load_packs,
    merge_values,
    replace_table_paths,
)
from splits.experiments.config.sections import ConfigSection, match_pattern
from splits.media.kinds import LAYERS_KEY, MEDIUM_CLASSES, get_kind, make_medium
from splits.media.medium import Medium
from splits.media.parameters import (
    check_single_parts,
    find_whole,
    override_keywords,
    parse_impurity_parameter,
    replace_parameter,
)
from splits.media.snow_packs import SnowPacks
from splits.tables.axes import INCIDENCE, ParameterGrid

NAME_PATTERN = re.compile(r"(?!(con|prn|aux|nul|com\d|lpt\d)$)[a-z][a-z0-9_]{0,63}")
NAME_RULE = (
    "lower-case letters, digits and underscores, a letter first, no device such as con or nul"
)
"""Rule for names of experiments, studies and their products: valid file names on all systems."""
PACK_INSTRUMENTS = ("spectrophotometer", "albedo")
"""Instruments that measure the snowpacks of a file."""
Name = Annotated[
    str,
    match_pattern(NAME_PATTERN, NAME_RULE),
    WithJsonSchema({"type": "string", "pattern": f"^{NAME_PATTERN.pattern}$"}),
]
Point = tuple[dict[str, str], Medium, float | str]
"""Labels, medium and angle of incidence of a point of a grid."""


class SimulationConfig(ConfigSection):
    """A medium under an instrument, over a grid of parameters.

    `grid` maps parameters to lists of values, or to mappings from labels to values.  A parameter
    is any keyword of the medium, for a stack also one of a layer as a path such as
    ``layers.0.depth_m``, ``incidence_deg``, or ``medium`` for values that are mappings of several
    keywords.  All combinations are simulated.
    """

    name: Name
    """name of the experiment, of its files and of its target in the workflow, by default that of
    the file: lower-case letters, digits and underscores, beginning with a letter, at most 64; not
    the name of a rule, of a study or of a product of a study, nor of a device such as `con`"""
    medium: dict[str, Any] = Field(default_factory=lambda: {"kind": "snow"})
    """the sample, by default snow of SPLITSnow Table 1"""
    instrument: Annotated[
        Instrument,
        PlainValidator(Instrument.from_content),
        PlainSerializer(Instrument.to_content),
        WithJsonSchema({"type": "object"}),
    ] = Instrument()
    """the virtual instrument"""
    grid: Annotated[dict[str, dict[str, Any]], BeforeValidator(label_grid)] = Field(
        default_factory=dict
    )
    """parameters that vary"""

    @model_validator(mode="after")
    def _check_points(self) -> SimulationConfig:
        """Reject settings that exclude each other, and values that a medium does not have."""
        kind, instrument = get_kind(self.medium), self.instrument
        check_choice("medium.kind", kind, (*MEDIUM_CLASSES, PACKS_KIND))
        instrument.check_simulation(
            self.grid, is_single=not self.is_in_parts, has_packs=self.has_packs
        )
        if self.has_packs:
            of_packs = f"for medium.kind = {kind!r}"
            check_relations(
                (not self.grid, "grid", "given", f"left out {of_packs}"),
                (
                    instrument.kind in PACK_INSTRUMENTS, "instrument.kind", instrument.kind,
                    f"{' or '.join(PACK_INSTRUMENTS)} {of_packs}",
                ),
            )  # fmt: skip
            self.load_packs()
            return self
        if instrument.kind in (TABLE, "return_table"):
            self.make_axes()
        elif self.count_points() > MAX_GRID_POINTS:
            given, allowed = f"{self.count_points()} points", f"at most {MAX_GRID_POINTS} points"
            raise invalid("grid", given, allowed, "instrument.kind: table allows more")
        for label, sample in self.grid.get(SAMPLE_KEY, {}).items():
            key = f"grid.{SAMPLE_KEY}.{label}"
            if not isinstance(sample, Mapping):
                raise invalid(key, sample, "a mapping of the medium's keywords")
            check_choice(f"{key}.kind", sample.get("kind", kind), [kind])
        for labels, _, incidence in self.iter_points(self._iter_axis_labels()):
            with self.locate_errors(labels):
                check_incidence("incidence_deg", incidence)
        return self

    @property
    def has_packs(self) -> bool:
        """Whether the medium is a file of snowpacks."""
        return self.medium.get("kind") == PACKS_KIND

    @property
    def is_in_parts(self) -> bool:
        """Whether the experiment is simulated in parts, by several jobs."""
        return self.has_packs or self.instrument.kind == TABLE

    def count_points(self) -> int:
        """Return the number of points of the grid."""
        return math.prod(map(len, self.grid.values()))

    def load_packs(self) -> SnowPacks:
        """Return the snowpacks of a file."""
        return load_packs(self._get_keywords())

    def _get_keywords(self) -> dict[str, Any]:
        """Return the keywords of the medium."""
        return {key: value for key, value in self.medium.items() if key != "kind"}

    def list_table_paths(self) -> list[str]:
        """Return the paths of all files that the media read, on which the results depend."""
        points = [settings for _, settings, _ in self.iter_settings()]
        paths = {path for settings in points for path in list_table_paths(settings)}
        return sorted(str(expand_path(path)) for path in paths)

    def iter_points(self, rows: Iterable[tuple[str, ...]] | None = None) -> Iterator[Point]:
        """Yield points of the grid, by default all; `rows` are their labels.

        Of a table, by default those of each axis with the first values of all others: all points
        are checked when it is built.
        """
        for labels, settings, incidence in self.iter_settings(rows):
            with self.locate_errors(labels):
                medium = make_medium(get_kind(self.medium), settings)
            yield labels, medium, incidence

    def iter_settings(
        self, rows: Iterable[tuple[str, ...]] | None = None
    ) -> Iterator[tuple[dict[str, str], dict[str, Any], float | str]]:
        """Yield the labels, the keywords of the medium and the angle of incidence of points."""
        # Values of the grid are merged into it.
        interpretation = self.medium.get("interpretation", {})
        if not isinstance(interpretation, Mapping | str):
            allowed = "a mapping of named choices, or the name of a set"
            raise invalid("medium.interpretation", interpretation, allowed)
        if rows is None:
            is_table = self.instrument.kind == TABLE
            rows = self._iter_axis_labels() if is_table else itertools.product(*self.grid.values())
        for row in rows:
            labels = dict(zip(self.grid, row, strict=True))
            values = {p: self.grid[p][label] for p, label in labels.items()}
            incidence = values.pop("incidence_deg", self.instrument.get_incidence())
            with self.locate_errors(labels):
                settings = self.merge_settings(values)
            yield labels, settings, incidence

    def _iter_axis_labels(self) -> Iterator[tuple[str, ...]]:
        """Yield the labels of each value of the grid with the first of all other parameters."""
        first = tuple(next(iter(values)) for values in self.grid.values())
        yield first
        for index, (_, *others) in enumerate(self.grid.values()):
            for label in others:
                yield (*first[:index], label, *first[index + 1 :])

    @contextmanager
    def locate_errors(self, labels: Mapping[str, str]) -> Iterator[None]:
        """Prefix the key of an error with the section that defines it at a point of the grid."""
        try:
            yield
        except InvalidValue as error:
            # Only parts of a whole are replaced in a medium, see `merge_settings`.
            is_part = error.key.startswith("parameter ")
            error.key = error.key.removeprefix("medium.").removeprefix("parameter ")
            path = error.key.split(" ", 1)[0]
            key = path if path in self.grid else re.split(r"\W", path, maxsplit=1)[0]
            sample = self.grid.get(SAMPLE_KEY, {}).get(labels.get(SAMPLE_KEY, ""), {})
            part = next((p for p in labels if find_whole(p) == key == error.key), "")
            if part and not isinstance(error.value, str):
                prefix, error.key, error.value = "grid", part, self.grid[part][labels[part]]
            elif key in self.grid:
                prefix = "grid"
                if key == LAYERS_KEY != path and labels:
                    prefix = f"grid.{LAYERS_KEY}.{labels[LAYERS_KEY]}"
            elif key in sample:
                prefix = f"grid.{SAMPLE_KEY}.{labels[SAMPLE_KEY]}"
            elif key in list_section_inputs(self.instrument.kind):
                prefix = "instrument"
            else:
                prefix = "grid" if is_part else "medium"
            if prefix == "grid" and isinstance(error, UnknownKey) and path == key in self.grid:
                keywords = list(signature(MEDIUM_CLASSES[get_kind(self.medium)]).parameters)
                raise unknown_key(f"grid.{key}", [*keywords, INCIDENCE, SAMPLE_KEY]) from None
            if error.key == SAMPLE_KEY:
                raise
            if prefix == "medium" and error.hint in SEVERAL_HINTS:
                error.hint = USE_GRID_HINT
            raise error.add_prefix(prefix) from None

    def merge_settings(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return the keywords of the medium at a point of the grid, merged into the common ones."""
        base = self._get_keywords()
        for parameter in [p for p in values if parse_impurity_parameter(p)]:
            key, kind = parse_impurity_parameter(parameter) or ("", "")
            values[key] = {**values.get(key, {}), kind: values.pop(parameter)}
        # Layers of stacks, whose names have dots, have no parts on a grid.
        wholes = {p: find_whole(p) for p in values}
        parts = {p: values.pop(p) for p, whole in wholes.items() if whole and "." not in whole}
        check_single_parts(parts)
        sample = {k: v for k, v in values.pop(SAMPLE_KEY, {}).items() if k != "kind"}
        settings = apply_paths(override_keywords(base, sample), values)
        for key in filter(is_merged, {**base, **sample, **values}):
            given = [one[key] for one in (base, sample, values) if key in one]
            settings |= {key: merge_values(key, given)} if given else {}
        for name, value in parts.items():
            medium = replace_parameter(make_medium(get_kind(self.medium), settings), name, value)
            settings[find_whole(name)] = getattr(medium, find_whole(name))
        return settings

    def make_axes(self) -> ParameterGrid:
        """Return the grid as axes of a table: increasing numbers, or texts."""
        nodes: dict[str, Any] = {p: list(_get_axis_nodes(v)) for p, v in self.grid.items()}
        return ParameterGrid.from_mapping(nodes | self.instrument.get_views())

    def make_medium(self, **values: Any) -> Medium:
        """Return the medium at a point of the grid, or with other values of its keywords."""
        grid = self.grid
        point = {p: grid[p][v] if p in grid and _get_axis_nodes(grid[p]) is grid[p] else v
                  for p, v in values.items()}  # fmt: skip
        return make_medium(get_kind(self.medium), self.merge_settings(point))

    def dump_simulation(self) -> dict[str, Any]:
        """Return all settings that affect the results, for `SimulationConfig.model_validate`."""
        return self.model_dump(mode="json", include=set(SimulationConfig.model_fields))

    def dump_configuration(self) -> str:
        """Return `dump_simulation` as JSON, with users' tables identified by name and content."""
        content = replace_table_paths(self.dump_simulation(), identify_by_content)
        return json.dumps(content, sort_keys=True)


def _get_axis_nodes(values: Mapping[str, Any]) -> Iterable[Any]:
    """Return the nodes of a table's axis: the values, or their labels if any value is composite."""
    is_composite = any(isinstance(v, Mapping | list | tuple) for v in values.values())
    return values if is_composite else values.values()
