"""What an experiment file may say.

One pydantic model per section (those of its parts are in `splits.experiments.sections`).  Unknown
keys are refused everywhere; physical ranges are checked by the media and instruments themselves,
so that a limit stands in one place only.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import numpy as np
from pydantic import Field, field_validator, model_validator

from splits.checks import one_of, refuse, unknown_key
from splits.experiments.sections import (
    FIGURES,
    OF_ONE_POINT,
    QUANTITIES,
    SEVERAL,
    SURFACES,
    FigureSection,
    FitSection,
    Instrument,
    Section,
)
from splits.experiments.user_tables import by_content, renamed, tables_in
from splits.instruments.arguments import check_beam, check_incidence
from splits.media import Layer, Sand, Snow
from splits.media.turbid import Medium, TurbidMedium

MEDIA: dict[str, Any] = {"snow": Snow, "sand": Sand, "layer": Layer}
SAMPLE = "medium"
"""Grid dimension whose values are whole media: their settings replace those of the base medium."""
MERGED = ("readings", "refractive_index")
"""Keywords that are mappings: a grid's values add to those of the medium."""
NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
RULES = (
    "all", "agreement", "angular_trends", "archive", "benchmark_kernels", "benchmarks", "figure",
    "figure_letcher", "figure_sensitivity", "figure_speed_against_error", "fitted_parameters",
    "layer_trends", "sand_compositions", "sand_tables", "sensitivity", "simulate",
    "speed_against_error",
)  # fmt: skip
"""Names that the workflow's own rules have taken."""


class ConfigError(ValueError):
    """A configuration that cannot be run; the message names file, key, value and range."""


class Experiment(Section):
    """A medium under an instrument, over a grid of parameters.

    `grid` maps parameters to lists of values, or to mappings from labels to values.  A parameter
    is any keyword of the medium, ``incidence_deg``, or ``medium`` for values that are mappings of
    several keywords; all combinations are run.
    """

    name: str
    title: str = ""
    caption: str = ""
    medium: dict[str, Any] = Field(default_factory=lambda: {"kind": "snow"})
    instrument: Instrument = Instrument()
    grid: dict[str, dict[str, Any]] = Field(default_factory=dict)
    fit: FitSection | None = None
    figure: FigureSection = FigureSection()

    @field_validator("name")
    @classmethod
    def _name(cls, value: str) -> str:
        if not NAME.fullmatch(value):
            raise refuse(
                "name", value, "lower-case letters, digits and underscores, a letter first"
            )
        if value in RULES:
            raise refuse("name", value, "none of the workflow's rules " + ", ".join(RULES))
        return value

    @field_validator("grid", mode="before")
    @classmethod
    def _labelled(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            raise refuse("grid", value, "a mapping from parameters to lists of values")
        grid = {}
        for parameter, values in value.items():
            if not isinstance(values, (list, tuple, dict)) or not values:
                raise refuse(f"grid.{parameter}", values, "a list of at least one value")
            if not isinstance(values, dict):
                labels = [label_of(parameter, v) for v in values]
                if len(set(labels)) < len(labels):
                    raise refuse(f"grid.{parameter}", values, "different values", "or name them")
                values = dict(zip(labels, values, strict=True))
            grid[str(parameter)] = {str(label): v for label, v in values.items()}
        return grid

    @model_validator(mode="after")
    def _runnable(self) -> Experiment:
        kind = self.medium.get("kind", "snow")
        one_of("medium.kind", kind, MEDIA)
        keywords = [field.name for field in fields(MEDIA[kind])]
        samples = self.grid.get(SAMPLE, {})
        for place, settings in {"medium": self.medium, **_places(samples)}.items():
            for key in settings:
                if key not in (*keywords, "kind"):
                    raise unknown_key(f"{place}.{key}", keywords)
            one_of(f"{place}.kind", settings.get("kind", kind), [kind])
        parameters = [*keywords, "incidence_deg", SAMPLE]
        for parameter in self.grid:
            if parameter not in parameters:
                raise unknown_key(f"grid.{parameter}", parameters)
        self._check_fit(kind)
        self._check_figure()
        for dimension, label in self.figure.at.items():
            one_of("figure.at", dimension, self.grid)
            labels = self.grid[dimension]
            if str(label) not in labels and label not in labels.values():
                raise refuse(f"figure.at.{dimension}", label, "one of " + ", ".join(labels))
        wavelengths = self.instrument.wavelengths()
        for labels, medium, incidence in self.points():
            with self.placed(labels):
                if not self.fit:
                    medium.indices(wavelengths)
                check_incidence(incidence)
            self._check_surface(kind, medium)
        return self

    def _check_surface(self, kind: str, medium: Medium) -> None:
        """Refuse what only layers, only smooth or only rough ones have, where they have it not."""
        layer = isinstance(medium, TurbidMedium)
        rough = isinstance(medium, TurbidMedium) and medium.fields() is not None
        instrument = self.instrument
        if instrument.kind in SURFACES and not rough:
            given = kind if not layer else "a layer without surface"
            raise refuse("medium.kind", given, f"a layer with a surface for {instrument.kind}")
        if instrument.kind in SURFACES and "incidence_deg" in self.grid:
            raise refuse(
                "grid.incidence_deg", list(self.grid["incidence_deg"].values()),
                f"left out for {instrument.kind}",
            )  # fmt: skip
        if instrument.estimator == "local" and (rough or not layer):
            raise refuse("instrument.estimator", "local", "left out but for smooth layers")
        if self.figure.kind == "polarization":
            if not (isinstance(medium, TurbidMedium) and medium.polarized):
                raise refuse("medium.polarized", False, "true for figure.kind = 'polarization'")
            if instrument.estimator not in ("local", "cells"):
                raise refuse(
                    "instrument.estimator", instrument.estimator,
                    "local or cells for figure.kind = 'polarization'",
                )  # fmt: skip
        if layer and "mean_grain_distance" in self.figure.quantity:
            raise refuse(
                "figure.quantity", "mean_grain_distance", "left out: layers have no grains"
            )
        told = "wavelength_nm" in self.instrument.model_fields_set
        if layer and not told and self.instrument.kind not in (*SURFACES, "refractive_index"):
            raise refuse(
                "instrument.wavelength_nm", None, "given for a layer, for example [550]",
                "layers have no colour: one wavelength says all",
            )  # fmt: skip

    def _check_fit(self, kind: str) -> None:
        """Refuse what does not go with a fit, or a figure of one without it."""
        if self.figure.kind == "fit" and not self.fit:
            raise refuse("figure.kind", "fit", "another one for an experiment without section fit")
        if self.fit and kind != "sand":
            raise refuse("medium.kind", kind, "sand in an experiment with a section fit")
        if self.fit and "wavelength_nm" in self.instrument.model_fields_set:
            raise refuse(
                "instrument.wavelength_nm",
                "given",
                "left out: a fit takes the measured wavelengths",
            )
        if self.fit and self.instrument.estimator == "analog":
            raise refuse("instrument.estimator", "analog", "left out: fits share their paths")
        if self.figure.kind == "swatches":
            x = self.instrument.wavelengths()
            if x[0] > 400.0 or x[-1] < 780.0 or np.diff(x).max(initial=0.0) > 10.0:
                raise refuse(
                    "instrument.wavelength_nm", [float(x[0]), float(x[-1])],
                    "400 to 780 nm in steps of at most 10 nm for figure.kind = 'swatches'",
                )  # fmt: skip
            if not 1 <= len(self.grid) - len(self.figure.at) <= 2:
                raise refuse(
                    "grid", list(self.grid), "one or two parameters for figure.kind = 'swatches'"
                )

    def _check_figure(self) -> None:
        """Refuse a figure that does not show what the instrument measures."""
        instrument = self.instrument
        known = FIGURES[instrument.kind]
        if self.figure.kind is not None and self.figure.kind not in known:
            raise refuse(
                "figure.kind",
                self.figure.kind,
                f"one of {', '.join(known)} for instrument.kind = {instrument.kind!r}",
            )
        if "quantity" in self.figure.model_fields_set:
            for quantity in self.figure.quantity:
                one_of("figure.quantity", quantity, QUANTITIES.get(instrument.kind, ()))
        bottoms = [s.get("bottom_albedo", 0.5) for _, s, _ in self.settings()]
        heard = instrument.estimator == "local" and "btdf" in self.figure.quantity
        if heard and any(bottom is not None for bottom in bottoms):
            raise refuse("figure.quantity", "btdf", "brdf over a bottom with local estimation")
        free = [parameter for parameter in self.grid if parameter not in self.figure.at]
        kind = self.figure.kind or known[0]
        if kind in OF_ONE_POINT and len(free) > (kind == "lobes"):
            raise refuse(
                "figure.at", self.figure.at, f"with a value of {', '.join(free)} for a figure of "
                f"kind {kind}", "it shows one point of the grid; the dataset holds all",
            )  # fmt: skip
        if instrument.kind == "bssrdf" and self.grid and instrument.half_width_m is None:
            raise refuse(
                "instrument.half_width_m", None, "given where there is a grid",
                "all maps of one dataset have the same axes",
            )  # fmt: skip
        turned = instrument.azimuth_deg
        if turned is not None and not {0.0, 180.0} <= set(turned):
            raise refuse(
                "instrument.azimuth_deg", turned, "with 0 and 180",
                "figures show the principal plane",
            )  # fmt: skip
        if instrument.cells is not None and instrument.cells[1] % 2:
            raise refuse(
                "instrument.cells", instrument.cells, "an even number around",
                "figures show the principal plane",
            )  # fmt: skip
        if self.figure.kind == "cells" and instrument.estimator != "cells":
            raise refuse(
                "instrument.estimator", instrument.estimator, "cells for figure.kind = cells"
            )
        if instrument.kind in ("goniophotometer", "bssrdf"):
            for labels, _, incidence in self.settings():
                with self.placed(labels):
                    check_beam(incidence)
        several = {key: list(given) for key, given in self.grid.items() if len(given) > 1}
        if instrument.kind == "refractive_index" and several:
            raise refuse("grid", several, "of one value for refractive_index")

    def drawing(self) -> dict[str, Any]:
        """Return the section `figure` for `splits.figures.draw`, with a kind that fits."""
        usual = FIGURES[self.instrument.kind][0]
        if usual == "spectra" and self.grid and self.instrument.wavelengths().size == 1:
            usual = "points"
        return {**self.figure.model_dump(mode="json"), "kind": self.figure.kind or usual}

    def tables(self) -> list[str]:
        """Return the files of users' own refractive indices, on which the numbers depend."""
        return tables_in([settings for _, settings, _ in self.settings()])

    def points(self) -> Iterator[tuple[dict[str, str], Medium, float | str]]:
        """Yield the labels, the medium and the angle of incidence of each point of the grid."""
        for labels, settings, incidence in self.settings():
            with self.placed(labels):
                medium = MEDIA[self.medium.get("kind", "snow")](**settings)
            yield labels, medium, incidence

    @contextmanager
    def placed(self, labels: Mapping[str, str]) -> Iterator[None]:
        """Put before the key of a refusal the section that gives it at a point of the grid."""
        try:
            yield
        except ValueError as error:
            key = re.split(r"\W", str(error), maxsplit=1)[0]
            sample = self.grid[SAMPLE][labels[SAMPLE]] if SAMPLE in self.grid else {}
            if key in self.grid:
                place = "grid"
            elif key in sample:
                place = f"grid.{SAMPLE}.{labels[SAMPLE]}"
            else:
                place = "fit" if key in FitSection.model_fields else "medium"
                place = "instrument" if key in Instrument.model_fields else place
            hint = f" ({SEVERAL})" if place == "medium" and self._is_several(key) else ""
            raise ValueError(f"{place}.{error}{hint}") from None

    def _is_several(self, key: str) -> bool:
        """Tell whether a keyword of the medium holds a list of what a grid takes."""
        given = self.medium.get(key)
        usual = getattr(MEDIA[self.medium.get("kind", "snow")], key, None)
        if not isinstance(given, (list, tuple)) or usual is None:
            return False
        return not isinstance(usual, tuple) or any(isinstance(v, (list, tuple)) for v in given)

    def settings(self) -> Iterator[tuple[dict[str, str], dict[str, Any], float | str]]:
        """Yield what `points` yields, with the medium's keywords in its place."""
        base = {k: v for k, v in self.medium.items() if k != "kind"}
        if not isinstance(base.get("readings", {}), Mapping):
            raise refuse("medium.readings", base["readings"], "a mapping of named readings")
        for labels in itertools.product(*self.grid.values()):
            chosen = dict(zip(self.grid, labels, strict=True))
            values = {p: self.grid[p][label] for p, label in chosen.items()}
            incidence = values.pop("incidence_deg", self.instrument.incidence_deg)
            sample = {k: v for k, v in values.pop(SAMPLE, {}).items() if k != "kind"}
            settings = {**base, **sample, **values}
            for key in MERGED:
                parts = [part[key] for part in (base, sample, values) if key in part]
                if parts and all(isinstance(part, Mapping) for part in parts):
                    settings[key] = {k: v for part in parts for k, v in part.items()}
            yield chosen, settings, incidence

    def simulation(self) -> dict[str, Any]:
        """Return what decides the numbers: everything but title, caption and figure."""
        content = self.model_dump(
            mode="json", include={"name", "medium", "instrument", "grid", "fit"}
        )
        if self.fit:
            del content["instrument"]["wavelength_nm"]
        return content

    def configuration(self) -> str:
        """Return `simulation` as JSON for a dataset, users' tables by name and content."""
        return json.dumps(renamed(self.simulation(), by_content), sort_keys=True)


def label_of(parameter: str, value: Any) -> str:
    """Return a short label for a grid value: "300-750" for a range, the mean of a distribution."""
    if isinstance(value, (list, tuple)):
        if len(value) == 4:
            return f"{value[2]:g}"
        return "-".join(f"{v:g}" if isinstance(v, (int, float)) else str(v) for v in value)
    if isinstance(value, dict):
        raise refuse(f"grid.{parameter}", value, "named: use a mapping from labels to values")
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)


def _places(samples: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the media of a grid by the place that an error message names."""
    places = {f"grid.{SAMPLE}.{label}": settings for label, settings in samples.items()}
    for place, settings in places.items():
        if not isinstance(settings, Mapping):
            raise refuse(place, settings, "a mapping of the medium's keywords")
    return places
