"""Model of a simulation: medium, instrument, grid and fit of an experiment file.

Each section is a pydantic model that rejects unknown keys.  Physical ranges are checked by the
media and instruments, so that each limit is defined once.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from splits.core.keywords import list_keywords
from splits.core.parameter_names import parse_impurity_parameter, parse_layer_parameter
from splits.core.paths import expand_path
from splits.core.validation import InvalidValue, check_choice, format_key, invalid, unknown_key
from splits.experiments.config.grid import MAX_GRID_POINTS, label_grid
from splits.experiments.config.instrument import USE_GRID_HINT, OpticalInstrument
from splits.experiments.config.instrument_kinds import (
    AnyInstrument,
    BeamSpread,
    Goniophotometer,
    ReturnTable,
    Spectrophotometer,
    TableInstrument,
)
from splits.experiments.config.medium import (
    MERGED_KEYWORDS,
    SAMPLE_KEY,
    apply_paths,
    check_grid_layers,
    check_layers,
    identify_by_content,
    list_table_paths,
    merge_values,
    replace_table_paths,
)
from splits.experiments.config.sections import ConfigSection, FitSection, match_pattern
from splits.experiments.config.snow_packs import PACKS_KIND, check_pack_experiment, load_packs
from splits.media.kinds import LAYERS_KEY, MEDIUM_CLASSES, check_thickness, get_kind, make_medium
from splits.media.medium import Medium
from splits.media.natural_snow import override_keywords
from splits.media.snow_packs import SnowPacks
from splits.simulation.run_options import MAX_DATASET_VALUES, check_beam_angle, check_incidence
from splits.simulation.scene import compute_optical_constants, make_height_fields
from splits.tables.axes import ParameterGrid

NAME_PATTERN = re.compile(r"(?!(con|prn|aux|nul|com\d|lpt\d)$)[a-z][a-z0-9_]{0,63}")
NAME_RULE = (
    "lower-case letters, digits and underscores, a letter first, no device such as con or nul"
)
"""Rule for names of experiments, studies and their products: valid file names on all systems."""


Name = Annotated[
    str,
    match_pattern(NAME_PATTERN, NAME_RULE),
    WithJsonSchema({"type": "string", "pattern": f"^{NAME_PATTERN.pattern}$"}),
]


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
    instrument: AnyInstrument = Spectrophotometer()
    """the virtual instrument"""
    grid: Annotated[dict[str, dict[str, Any]], BeforeValidator(label_grid)] = Field(
        default_factory=dict
    )
    """parameters that vary"""
    fit: FitSection | None = None
    """fits a sand to measured spectra instead of simulating given media"""

    @model_validator(mode="after")
    def _check_runnable(self) -> SimulationConfig:
        kind = self.medium.get("kind", "snow")
        check_choice("medium.kind", kind, (*MEDIUM_CLASSES, PACKS_KIND))
        self._check_point_errors()
        if self.has_packs:
            for key in ("grid", "fit"):
                if getattr(self, key):
                    raise invalid(key, "given", "left out for medium.kind = 'snow_packs'")
            check_pack_experiment(self.load_packs(), self.instrument)
            return self
        self._check_keywords(kind)
        self._check_fit(kind)
        self._check_size()
        wavelengths = self.instrument.get_wavelengths()
        has_ground: set[bool] = set()
        for labels, medium, incidence in self.iter_points():
            with self.locate_errors(labels):
                if not self.fit:
                    compute_optical_constants(medium, wavelengths)
                check = check_beam_angle if self.instrument.takes_beam_only else check_incidence
                check(incidence)
                check_thickness(medium)
            self._check_medium(kind, medium)
            has_ground.add(medium.reflecting_ground is not None)
        if len(has_ground) > 1 and isinstance(self.instrument, Goniophotometer):
            hint = "a BTDF exists only where light leaves the lower boundary"
            raise invalid("grid", "open and reflecting grounds", "of one kind", hint)
        self._check_grid()
        return self

    @property
    def has_packs(self) -> bool:
        """Whether the medium is a file of snowpacks."""
        return self.medium.get("kind") == PACKS_KIND

    @property
    def is_in_parts(self) -> bool:
        """Whether the experiment is simulated in parts, by several jobs."""
        return self.has_packs or isinstance(self.instrument, TableInstrument)

    def _get_keywords(self) -> dict[str, Any]:
        """Return the keywords of the medium."""
        return {key: value for key, value in self.medium.items() if key != "kind"}

    def list_medium_keywords(self) -> list[str]:
        """Return the keywords that the kind of the medium has."""
        return list_keywords(MEDIUM_CLASSES[get_kind(self.medium)])

    def load_packs(self) -> SnowPacks:
        """Return the snowpacks of a file."""
        return load_packs(self._get_keywords())

    def _check_keywords(self, kind: str) -> None:
        """Reject unknown keywords of the medium, of its layers and of the grid."""
        keywords = list_keywords(MEDIUM_CLASSES[kind])
        sections = {"medium": self.medium}
        for label, sample in self.grid.get(SAMPLE_KEY, {}).items():
            sections[f"grid.{SAMPLE_KEY}.{format_key(label)}"] = sample
        for prefix, settings in sections.items():
            if not isinstance(settings, Mapping):
                raise invalid(prefix, settings, "a mapping of the medium's keywords")
            for key in settings:
                if key not in (*keywords, "kind"):
                    raise unknown_key(f"{prefix}.{key}", keywords)
            check_choice(f"{prefix}.kind", settings.get("kind", kind), [kind])
            if kind == "stack" and (prefix == "medium" or LAYERS_KEY in settings):
                check_layers(prefix, settings.get(LAYERS_KEY))
        if kind == "stack":
            check_grid_layers(self.medium, self.grid)
        parameters = [*keywords, "incidence_deg", SAMPLE_KEY]
        for parameter in self.grid:
            keyword, _ = parse_impurity_parameter(parameter) or (parameter, "")
            is_path = kind == "stack" and parse_layer_parameter(parameter)
            if not is_path and keyword not in parameters:
                raise unknown_key(f"grid.{parameter}", parameters)

    def _check_fit(self, kind: str) -> None:
        """Reject settings that a fit does not allow."""
        if not self.fit:
            return
        key, instrument = "instrument", self.instrument
        if not isinstance(instrument, Spectrophotometer):
            raise invalid(f"{key}.kind", instrument.kind, "spectrophotometer with a section fit")
        if kind != "sand":
            raise invalid("medium.kind", kind, "sand in an experiment with a section fit")
        if "wavelength_nm" in instrument.model_fields_set:
            allowed = "left out: a fit uses the measured wavelengths"
            raise invalid(f"{key}.wavelength_nm", "given", allowed)
        if instrument.estimator == "analog":
            raise invalid(f"{key}.estimator", "analog", "left out: fits reuse paths")

    def _check_size(self) -> None:
        """Reject a grid whose dataset would not fit into memory."""
        if isinstance(self.instrument, TableInstrument):
            # The blocks of a table are written one by one.
            self.make_axes()
            return
        if isinstance(self.instrument, ReturnTable):
            self.make_axes()
        points = math.prod(len(values) for values in self.grid.values())
        if points > MAX_GRID_POINTS:
            hint = "instrument.kind: table allows more"
            raise invalid("grid", f"{points} points", f"at most {MAX_GRID_POINTS} points", hint)
        count = self.instrument.count_values()
        if points * count > MAX_DATASET_VALUES:
            given = f"{points} points of {count} values each"
            allowed = f"at most {MAX_DATASET_VALUES} values in all"
            raise invalid("grid", given, allowed, "split it into several experiments")

    def _check_grid(self) -> None:
        """Reject grids that an instrument does not allow."""
        instrument, incidence = self.instrument, self.grid.get("incidence_deg")
        if incidence and not isinstance(instrument, OpticalInstrument):
            allowed = f"left out for {instrument.kind}"
            raise invalid("grid.incidence_deg", list(incidence.values()), allowed)
        if incidence and instrument.get_incidence() != 0.0:
            allowed = "left out, because grid.incidence_deg sets it"
            raise invalid("instrument.incidence_deg", instrument.get_incidence(), allowed)
        if isinstance(instrument, BeamSpread) and self.grid and instrument.half_width_m is None:
            allowed, hint = "given where there is a grid", "all maps have the same axes"
            raise invalid("instrument.half_width_m", None, allowed, hint)
        varied = {key: list(given) for key, given in self.grid.items() if len(given) > 1}
        if instrument.kind == "refractive_index" and varied:
            raise invalid("grid", varied, "of one value for refractive_index")

    def _check_point_errors(self) -> None:
        """Reject target errors of points that are not those of the grid."""
        scales = getattr(self.instrument, "point_stderr_scale", None)
        n_points = math.prod(len(values) for values in self.grid.values())
        if scales is None or (len(scales) == n_points and not (self.is_in_parts or self.fit)):
            return
        allowed = f"{n_points} numbers, one for each point of the grid"
        if self.is_in_parts or self.fit:
            allowed = "left out for tables, fits and snowpacks"
        raise invalid("instrument.point_stderr_scale", list(scales), allowed)

    def _check_medium(self, kind: str, medium: Medium) -> None:
        """Reject a medium that the instrument or its estimator does not allow."""
        is_layer = kind == "particle_layer"
        is_rough = is_layer and make_height_fields(medium) is not None
        instrument = self.instrument
        if instrument.MEASURES_SURFACE and not is_rough:
            given = kind if not is_layer else "a layer without surface"
            raise invalid("medium.kind", given, f"a layer with a surface for {instrument.kind}")
        instrument.check_medium(medium)
        has_wavelengths = "wavelength_nm" in instrument.model_fields_set
        if is_layer and isinstance(instrument, OpticalInstrument) and not has_wavelengths:
            allowed = "given for a layer, for example [550]"
            hint = "properties of layers do not depend on wavelength"
            raise invalid("instrument.wavelength_nm", None, allowed, hint)

    def list_table_paths(self) -> list[str]:
        """Return the paths of all files that the media read, on which the results depend."""
        points = [settings for _, settings, _ in self.iter_settings()]
        paths = {path for settings in points for path in list_table_paths(settings)}
        return sorted(str(expand_path(path)) for path in paths)

    def iter_points(self) -> Iterator[tuple[dict[str, str], Medium, float | str]]:
        """Yield the labels, the medium and the angle of incidence of each point of the grid."""
        for labels, settings, incidence in self.iter_settings():
            with self.locate_errors(labels):
                medium = make_medium(get_kind(self.medium), settings)
            yield labels, medium, incidence

    @contextmanager
    def locate_errors(self, labels: Mapping[str, str]) -> Iterator[None]:
        """Prefix the key of an error with the section that defines it at a point of the grid."""
        try:
            yield
        except InvalidValue as error:
            path = error.key.split(" ", 1)[0]
            key = path if path in self.grid else re.split(r"\W", path, maxsplit=1)[0]
            sample = self.grid[SAMPLE_KEY][labels[SAMPLE_KEY]] if SAMPLE_KEY in self.grid else {}
            if key in self.grid:
                prefix = "grid"
            elif key in sample:
                prefix = f"grid.{SAMPLE_KEY}.{labels[SAMPLE_KEY]}"
            elif key in type(self.instrument).model_fields:
                prefix = "instrument"
            else:
                prefix = "fit" if key in FitSection.model_fields else "medium"
            has_several = prefix == "medium" and self._has_several_values(key)
            raise error.add_prefix(prefix, USE_GRID_HINT if has_several else "") from None

    def _has_several_values(self, key: str) -> bool:
        """Return whether a keyword of the medium has a list of values that belongs on a grid."""
        value = self.medium.get(key)
        default = getattr(MEDIUM_CLASSES[get_kind(self.medium)], key, None)
        if not isinstance(value, (list, tuple)) or default is None:
            return False
        return not isinstance(default, tuple) or any(isinstance(v, (list, tuple)) for v in value)

    def iter_settings(self) -> Iterator[tuple[dict[str, str], dict[str, Any], float | str]]:
        """Yield the labels, the keywords of the medium and the angle of incidence of each point."""
        interpretation = self.medium.get("interpretation", {})
        if not isinstance(interpretation, Mapping | str):
            allowed = "a mapping of interpretation keywords, or the name of a set"
            raise invalid("medium.interpretation", interpretation, allowed)
        for labels in self._iter_labels():
            point_labels = dict(zip(self.grid, labels, strict=True))
            values = {p: self.grid[p][label] for p, label in point_labels.items()}
            incidence = values.pop("incidence_deg", self.instrument.get_incidence())
            yield point_labels, self.merge_settings(values), incidence

    def _iter_labels(self) -> Iterator[tuple[str, ...]]:
        """Yield the labels of every point; for a table, each value with the first of all others.

        All points of a table are checked when it is built.
        """
        if not isinstance(self.instrument, TableInstrument):
            yield from itertools.product(*self.grid.values())
            return
        first = [next(iter(values)) for values in self.grid.values()]
        yield tuple(first)
        for index, (_, *others) in enumerate(self.grid.values()):
            for label in others:
                yield (*first[:index], label, *first[index + 1 :])

    def merge_settings(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return the keywords of the medium at a point of the grid, merged into the common ones."""
        base = self._get_keywords()
        for parameter in [p for p in values if parse_impurity_parameter(p)]:
            key, kind = parse_impurity_parameter(parameter) or ("", "")
            values[key] = {**values.get(key, {}), kind: values.pop(parameter)}
        sample = {k: v for k, v in values.pop(SAMPLE_KEY, {}).items() if k != "kind"}
        settings = apply_paths(override_keywords(base, sample), values)
        for key in MERGED_KEYWORDS:
            parts = [part[key] for part in (base, sample, values) if key in part]
            settings |= {key: merge_values(key, parts)} if parts else {}
        return settings

    def make_axes(self) -> ParameterGrid:
        """Return the grid as axes of a table: increasing numbers, or texts."""
        nodes: dict[str, Any] = {p: list(_get_axis_nodes(v)) for p, v in self.grid.items()}
        if isinstance(self.instrument, TableInstrument):
            nodes |= self.instrument.get_views()
        return ParameterGrid.from_mapping(nodes)

    def make_medium(self, **values: Any) -> Medium:
        """Return the medium at a point of the grid, or with other values of its keywords."""
        grid = self.grid
        point = {p: grid[p][v] if p in grid and _get_axis_nodes(grid[p]) is grid[p] else v
                  for p, v in values.items()}  # fmt: skip
        return make_medium(get_kind(self.medium), self.merge_settings(point))

    def dump_simulation(self) -> dict[str, Any]:
        """Return all settings that affect the results, for `SimulationConfig.model_validate`."""
        content = self.model_dump(mode="json", include=set(SimulationConfig.model_fields))
        if self.fit:
            del content["instrument"]["wavelength_nm"]
        if self.has_packs:
            # Snowpacks of a file have one solver only.
            content["instrument"].pop("solver", None)
        return content

    def dump_configuration(self) -> str:
        """Return `dump_simulation` as JSON, with users' tables identified by name and content."""
        content = replace_table_paths(self.dump_simulation(), identify_by_content)
        return json.dumps(content, sort_keys=True)


def _get_axis_nodes(values: Mapping[str, Any]) -> Iterable[Any]:
    """Return the nodes of a table's axis: the values, or their labels if any value is composite."""
    is_composite = any(isinstance(v, Mapping | list | tuple) for v in values.values())
    return values if is_composite else values.values()
