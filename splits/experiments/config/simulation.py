"""What an experiment file says that decides numbers: medium, instrument, grid, fit.

One pydantic model per section (those of its parts are in `splits.experiments.config.sections`).  Unknown
keys are refused everywhere; physical ranges are checked by the media and instruments themselves,
so that a limit stands in one place only.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from pydantic import Field, field_validator, model_validator

from splits.core.parameter_names import parse_impurity_parameter, parse_layer_parameter
from splits.core.validation import (
    InvalidValue,
    check_choice,
    format_key,
    invalid,
    list_keywords,
    unknown_key,
)
from splits.experiments.config.grid import MAX_GRID_POINTS, label_grid
from splits.experiments.config.instrument import (
    SURFACE_INSTRUMENTS,
    USE_GRID_HINT,
    InstrumentSection,
)
from splits.experiments.config.medium import LAYER_CLASSES as LAYER_MEDIA
from splits.experiments.config.medium import (
    LAYERS_KEY,
    MEDIUM_FACTORIES,
    MERGED_KEYWORDS,
    apply_paths,
    check_grid_layers,
    check_layers,
    identify_by_content,
    list_table_paths,
    make_stack,
    replace_table_paths,
)
from splits.experiments.config.sections import ConfigSection, FitSection
from splits.media import Stack
from splits.media.interpretations import merge_interpretations
from splits.media.measured_inputs import override_keywords
from splits.media.medium import (
    GranularMedium,
    LayeredMedium,
    Medium,
    ParticleMedium,
    check_thickness,
)
from splits.simulation.arguments import MAX_DATASET_VALUES, check_beam_angle, check_incidence
from splits.simulation.scene import compute_optical_constants, get_reflecting_ground
from splits.tables.axes import ParameterGrid

MEDIUM_CLASSES: dict[str, Any] = {**LAYER_MEDIA, "stack": Stack}
SAMPLE_KEY = "medium"
"""Grid dimension whose values are whole media: their settings replace those of the base medium."""
SEMI_INFINITE_INSTRUMENTS = ("spectrophotometer", "refractive_index", "table")
"""Instruments that take packs without end."""
NAME_PATTERN = re.compile(r"(?!(con|prn|aux|nul|com\d|lpt\d)$)[a-z][a-z0-9_]{0,63}")
NAME_RULE = (
    "lower-case letters, digits and underscores, a letter first, no device such as con or nul"
)
"""What names of experiments, of studies and of what these make are: files on all systems."""


class SimulationConfig(ConfigSection):
    """A medium under an instrument, over a grid of parameters.

    `grid` maps parameters to lists of values, or to mappings from labels to values.  A parameter
    is any keyword of the medium, for a stack also one of a layer as a path such as
    ``layers.0.depth_m``, ``incidence_deg``, or ``medium`` for values that are mappings of several
    keywords; all combinations are run.
    """

    name: str
    medium: dict[str, Any] = Field(default_factory=lambda: {"kind": "snow"})
    instrument: InstrumentSection = InstrumentSection()
    grid: dict[str, dict[str, Any]] = Field(default_factory=dict)
    fit: FitSection | None = None

    @field_validator("name")
    @classmethod
    def _check_name(cls, value: str) -> str:
        if not NAME_PATTERN.fullmatch(value):
            raise invalid("name", value, NAME_RULE)
        return value

    @field_validator("grid", mode="before")
    @classmethod
    def _label_grid(cls, value: Any) -> Any:
        return label_grid(value)

    @model_validator(mode="after")
    def _check_runnable(self) -> SimulationConfig:
        kind = self.medium.get("kind", "snow")
        check_choice("medium.kind", kind, MEDIUM_CLASSES)
        keywords = list_keywords(MEDIUM_CLASSES[kind])
        samples = self.grid.get(SAMPLE_KEY, {})
        for place, settings in {"medium": self.medium, **_map_sample_keys(samples)}.items():
            for key in settings:
                if key not in (*keywords, "kind"):
                    raise unknown_key(f"{place}.{key}", keywords)
            check_choice(f"{place}.kind", settings.get("kind", kind), [kind])
            if kind == "stack" and (place == "medium" or LAYERS_KEY in settings):
                check_layers(place, settings.get(LAYERS_KEY))
        if kind == "stack":
            check_grid_layers(self.medium, self.grid, SAMPLE_KEY)
        parameters = [*keywords, "incidence_deg", SAMPLE_KEY]
        for parameter in self.grid:
            if kind == "stack" and parse_layer_parameter(parameter):
                continue
            amount = parse_impurity_parameter(parameter)
            if amount and amount[0] in keywords:
                continue
            if parameter not in parameters:
                raise unknown_key(f"grid.{parameter}", parameters)
        self._check_fit(kind)
        self._check_size()
        wavelengths = self.instrument.get_wavelengths()
        grounded: set[bool] = set()
        beam = self.instrument.kind in ("goniophotometer", "beam_spread")
        for labels, medium, incidence in self.iter_points():
            with self.locate_errors(labels):
                if not self.fit:
                    compute_optical_constants(medium, wavelengths)
                check_beam_angle(incidence) if beam else check_incidence(incidence)
                if isinstance(medium, GranularMedium | LayeredMedium):
                    check_thickness(medium)
            self._check_medium(kind, medium)
            grounded.add(get_reflecting_ground(medium) is not None)
        if len(grounded) > 1 and self.instrument.kind == "goniophotometer":
            why = "a BTDF is there only where light leaves below"
            raise invalid("grid", "open and reflecting grounds", "of one sort", why)
        self._check_grid()
        return self

    def _check_fit(self, kind: str) -> None:
        """Refuse what does not go with a fit."""
        if self.fit and self.instrument.kind != "spectrophotometer":
            allowed = "spectrophotometer with a section fit"
            raise invalid("instrument.kind", self.instrument.kind, allowed)
        if self.fit and kind != "sand":
            raise invalid("medium.kind", kind, "sand in an experiment with a section fit")
        if self.fit and "wavelength_nm" in self.instrument.model_fields_set:
            raise invalid(
                "instrument.wavelength_nm",
                "given",
                "left out: a fit takes the measured wavelengths",
            )
        if self.fit and self.instrument.estimator == "analog":
            raise invalid("instrument.estimator", "analog", "left out: fits share their paths")

    def _check_size(self) -> None:
        """Refuse a grid whose dataset would not fit into memory."""
        if self.instrument.kind == "table":
            # Its blocks are written one by one.
            self.make_axes()
            return
        points = math.prod(len(values) for values in self.grid.values())
        if points > MAX_GRID_POINTS:
            hint = "instrument.kind: table takes more"
            raise invalid("grid", f"{points} points", f"at most {MAX_GRID_POINTS} points", hint)
        values = points * self.instrument.count_values()
        if values > MAX_DATASET_VALUES:
            raise invalid(
                "grid", f"{points} points of {self.instrument.count_values()} values each",
                f"at most {MAX_DATASET_VALUES} values in all", "several experiments hold more",
            )  # fmt: skip

    def _check_grid(self) -> None:
        """Refuse grids that an instrument cannot look at."""
        instrument = self.instrument
        if instrument.kind in SURFACE_INSTRUMENTS and "incidence_deg" in self.grid:
            raise invalid(
                "grid.incidence_deg", list(self.grid["incidence_deg"].values()),
                f"left out for {instrument.kind}",
            )  # fmt: skip
        if "incidence_deg" in self.grid and instrument.incidence_deg != 0.0:
            allowed = "left out beside grid.incidence_deg, the same"
            raise invalid("instrument.incidence_deg", instrument.incidence_deg, allowed)
        if instrument.kind == "beam_spread" and self.grid and instrument.half_width_m is None:
            raise invalid(
                "instrument.half_width_m", None, "given where there is a grid",
                "all maps of one dataset have the same axes",
            )  # fmt: skip
        several = {key: list(given) for key, given in self.grid.items() if len(given) > 1}
        if instrument.kind == "refractive_index" and several:
            raise invalid("grid", several, "of one value for refractive_index")

    def _check_medium(self, kind: str, medium: Medium) -> None:
        """Refuse what only layers, only smooth or only rough ones have, where they have it not."""
        layer = isinstance(medium, ParticleMedium)
        rough = isinstance(medium, ParticleMedium) and medium.make_height_fields() is not None
        instrument = self.instrument
        if instrument.kind in SURFACE_INSTRUMENTS and not rough:
            given = kind if not layer else "a layer without surface"
            raise invalid("medium.kind", given, f"a layer with a surface for {instrument.kind}")
        endless = not layer and math.isinf(medium.depth_m)  # type: ignore[union-attr]
        if endless and (
            instrument.kind not in SEMI_INFINITE_INSTRUMENTS or instrument.estimator == "analog"
        ):
            hint = "the spectrophotometer takes packs without end"
            raise invalid("medium.depth_m", math.inf, "finite", hint)
        if instrument.estimator == "next_event" and (rough or not layer):
            hint = "of these, cells have Stokes parameters"
            raise invalid("instrument.estimator", "next_event", "expansion or bins", hint)
        if instrument.target == "btdf" and get_reflecting_ground(medium) is not None:
            raise invalid("instrument.target", "btdf", "brdf over a ground")
        told = "wavelength_nm" in instrument.model_fields_set
        if layer and not told and instrument.kind not in (*SURFACE_INSTRUMENTS, "refractive_index"):
            raise invalid(
                "instrument.wavelength_nm", None, "given for a layer, for example [550]",
                "layers have no colour: one wavelength says all",
            )  # fmt: skip

    def list_table_paths(self) -> list[str]:
        """Return the files of users' own refractive indices, on which the numbers depend."""
        return list_table_paths([settings for _, settings, _ in self.iter_settings()])

    def iter_points(self) -> Iterator[tuple[dict[str, str], Medium, float | str]]:
        """Yield the labels, the medium and the angle of incidence of each point of the grid."""
        for labels, settings, incidence in self.iter_settings():
            with self.locate_errors(labels):
                medium = self._make_medium(settings)
            yield labels, medium, incidence

    @contextmanager
    def locate_errors(self, labels: Mapping[str, str]) -> Iterator[None]:
        """Put before the key of a refusal the section that gives it at a point of the grid."""
        try:
            yield
        except InvalidValue as error:
            path = error.key.split(" ", 1)[0]
            key = path if path in self.grid else re.split(r"\W", path, maxsplit=1)[0]
            sample = self.grid[SAMPLE_KEY][labels[SAMPLE_KEY]] if SAMPLE_KEY in self.grid else {}
            if key in self.grid:
                place = "grid"
            elif key in sample:
                place = f"grid.{SAMPLE_KEY}.{labels[SAMPLE_KEY]}"
            else:
                place = "fit" if key in FitSection.model_fields else "medium"
                place = "instrument" if key in InstrumentSection.model_fields else place
            several = place == "medium" and self._has_several_values(key)
            raise error.add_prefix(place, USE_GRID_HINT if several else "") from None

    def _has_several_values(self, key: str) -> bool:
        """Tell whether a keyword of the medium holds a list of what a grid takes."""
        given = self.medium.get(key)
        usual = getattr(MEDIUM_CLASSES[self.medium.get("kind", "snow")], key, None)
        if not isinstance(given, (list, tuple)) or usual is None:
            return False
        return not isinstance(usual, tuple) or any(isinstance(v, (list, tuple)) for v in given)

    def iter_settings(self) -> Iterator[tuple[dict[str, str], dict[str, Any], float | str]]:
        """Yield what `iter_points` yields, with the medium's keywords in its place."""
        base = {k: v for k, v in self.medium.items() if k != "kind"}
        if not isinstance(base.get("interpretation", {}), Mapping | str):
            allowed = "a mapping of named readings, or the name of a set"
            raise invalid("medium.interpretation", base["interpretation"], allowed)
        for labels in self._iter_labels():
            chosen = dict(zip(self.grid, labels, strict=True))
            values = {p: self.grid[p][label] for p, label in chosen.items()}
            incidence = values.pop("incidence_deg", self.instrument.incidence_deg)
            yield chosen, self.merge_settings(base, values), incidence

    def _iter_labels(self) -> Iterator[tuple[str, ...]]:
        """Yield the labels of every point; of a table, each value with the first of all others.

        All of a table's points are looked at where it is made.
        """
        if self.instrument.kind != "table":
            yield from itertools.product(*self.grid.values())
            return
        first = [next(iter(values)) for values in self.grid.values()]
        yield tuple(first)
        for place, values in enumerate(self.grid.values()):
            for label in list(values)[1:]:
                yield (*first[:place], label, *first[place + 1 :])

    def merge_settings(self, base: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the medium's keywords at a point of the grid, on top of those of all points."""
        values = dict(values)
        for parameter in [p for p in values if parse_impurity_parameter(p)]:
            key, kind = parse_impurity_parameter(parameter) or ("", "")
            values[key] = {**values.get(key, {}), kind: values.pop(parameter)}
        sample = {k: v for k, v in values.pop(SAMPLE_KEY, {}).items() if k != "kind"}
        settings = apply_paths(override_keywords(base, sample), values)
        for key in MERGED_KEYWORDS:
            parts = [part[key] for part in (base, sample, values) if key in part]
            if key == "interpretation":
                settings |= {key: merge_interpretations(parts)} if parts else {}
            elif parts and all(isinstance(part, Mapping) for part in parts):
                settings[key] = {k: v for part in parts for k, v in part.items()}
        return settings

    def make_axes(self) -> ParameterGrid:
        """Return the grid as the axes of a table: increasing numbers, or texts."""
        return ParameterGrid.from_mapping(
            {p: list(_get_axis_nodes(values)) for p, values in self.grid.items()}
        )

    def make_medium(self, **values: Any) -> Medium:
        """Return the medium at a point of the grid, without the incidence."""
        base = {k: v for k, v in self.medium.items() if k != "kind"}
        chosen = {p: self.grid[p][v] if _get_axis_nodes(self.grid[p]) is self.grid[p] else v
                  for p, v in values.items()}  # fmt: skip
        return self._make_medium(self.merge_settings(base, chosen))

    def _make_medium(self, settings: Mapping[str, Any]) -> Medium:
        kind = self.medium.get("kind", "snow")
        made: Medium = (
            make_stack(**settings) if kind == "stack" else MEDIUM_FACTORIES[kind](**settings)
        )
        return made

    def dump_simulation(self) -> dict[str, Any]:
        """Return what decides the numbers; `Simulation.model_validate` makes the same of it."""
        content = self.model_dump(mode="json", include=set(SimulationConfig.model_fields))
        if self.fit:
            del content["instrument"]["wavelength_nm"]
        return content

    def dump_configuration(self) -> str:
        """Return `dump_simulation` as JSON for a dataset, users' tables by name and content."""
        return json.dumps(
            replace_table_paths(self.dump_simulation(), identify_by_content), sort_keys=True
        )


def _get_axis_nodes(values: Mapping[str, Any]) -> Iterable[Any]:
    """Return what a table has along an axis: its values, or their labels where these say more."""
    more = any(isinstance(v, Mapping | list | tuple) for v in values.values())
    return values if more else values.values()


def _map_sample_keys(samples: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the media of a grid by the place that an error message names."""
    places = {
        f"grid.{SAMPLE_KEY}.{format_key(label)}": settings for label, settings in samples.items()
    }
    for place, settings in places.items():
        if not isinstance(settings, Mapping):
            raise invalid(place, settings, "a mapping of the medium's keywords")
    return places
