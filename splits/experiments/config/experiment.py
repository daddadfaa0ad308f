"""Model of an experiment file: simulation, figure, retrieval and their validation."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field, field_validator, model_validator

from splits.analysis.colour import covers_visible
from splits.core.validation import check_choice, invalid
from splits.experiments.config.grid import find_label, to_coordinate_values
from splits.experiments.config.reproduces import ReproducesSection
from splits.experiments.config.retrieve import RetrieveSection
from splits.experiments.config.retrieve_checks import check_retrieve_section
from splits.experiments.config.sections import (
    FIGURE_KINDS,
    FIGURE_QUANTITIES,
    FIGURE_SUFFIXES,
    KINDS_OF_SETTING,
    MAX_CAPTION_CHARS,
    MAX_TITLE_CHARS,
    SINGLE_POINT_KINDS,
    FigureSection,
    check_text,
)
from splits.experiments.config.simulation import NAME_PATTERN, NAME_RULE, SimulationConfig
from splits.instruments.goniophotometer import AZIMUTH_DEG, POLAR_DEG
from splits.media.medium import Medium
from splits.plotting.panels import (
    DEFAULT_LABEL,
    MAX_AZIMUTH_GAP_DEG,
    MAX_PANELS,
    MIN_AZIMUTHS,
    MIN_POLAR_ANGLES,
    can_map_hemisphere,
)

RESERVED_NAMES = (
    "all", "everything", "archive", "explorer", "explorer_page", "benchmark", "benchmarks",
    "update_docs", "figure", "figure_benchmark", "fitted_parameters", "report", "retrieve",
    "simulate", "table", "table_part",
)  # fmt: skip
"""Names of rules of the workflow, which experiments may not have."""


OWN_GROUP = "own"
"""Group of experiments that name none."""


class ExperimentConfig(SimulationConfig):
    """A simulation with its title, caption, figure and retrieval."""

    group: str = OWN_GROUP
    reproduces: ReproducesSection | None = None
    title: str = ""
    caption: str = ""
    figure: FigureSection = Field(default_factory=FigureSection)
    retrieve: RetrieveSection | None = None

    @field_validator("name")
    @classmethod
    def _check_name_is_free(cls, value: str) -> str:
        if value in RESERVED_NAMES:
            raise invalid(
                "name", value, "none of the workflow's rules " + ", ".join(RESERVED_NAMES)
            )
        return value

    @field_validator("group")
    @classmethod
    def _check_group(cls, value: str) -> str:
        if not NAME_PATTERN.fullmatch(value) or value in {*RESERVED_NAMES} - {"explorer"}:
            raise invalid("group", value, f"{NAME_RULE}, none of the workflow's rules")
        return value

    @field_validator("figure", mode="before")
    @classmethod
    def _parse_no_figure(cls, value: Any) -> Any:
        return {"kind": "none"} if value == "none" else value

    @field_validator("title")
    @classmethod
    def _check_title(cls, value: str) -> str:
        return check_text("title", value, MAX_TITLE_CHARS)

    @field_validator("caption")
    @classmethod
    def _check_caption(cls, value: str) -> str:
        return check_text("caption", value, MAX_CAPTION_CHARS, multiline=True)

    @model_validator(mode="after")
    def _check_drawable(self) -> ExperimentConfig:
        if self.figure.kind == "fit" and not self.fit:
            raise invalid("figure.kind", "fit", "another one for an experiment without section fit")
        self._check_figure()
        for dimension, value in self.figure.select.items():
            if not self.grid:
                raise invalid("figure.select", dimension, "left out where there is no grid")
            check_choice("figure.select", dimension, self.grid)
            find_label(dimension, self.grid[dimension], value)
        self._check_unused_figure_settings()
        self._check_single_point()
        self._check_swatches()
        if self.retrieve:
            check_retrieve_section(self, self.retrieve, self.figure.model_fields_set)
        for _, medium, _ in self.iter_points():
            self._check_quantity(medium)
        return self

    def _check_figure(self) -> None:
        """Reject a figure of quantities that the instrument does not measure."""
        instrument = self.instrument
        allowed_kinds = FIGURE_KINDS[instrument.kind]
        is_drawn = self.figure.kind != "none"
        if is_drawn and self.figure.kind is not None and self.figure.kind not in allowed_kinds:
            raise invalid(
                "figure.kind",
                self.figure.kind,
                f"one of {', '.join(allowed_kinds)} for instrument.kind = {instrument.kind!r}",
            )
        if "quantity" in self.figure.model_fields_set:
            for quantity in self.figure.quantity:
                check_choice(
                    "figure.quantity", quantity, FIGURE_QUANTITIES.get(instrument.kind, ())
                )
        if self.figure.kind == "hemisphere":
            self._check_hemisphere()
        azimuths = instrument.azimuth_deg
        if is_drawn and azimuths is not None and not {0.0, 180.0} <= set(azimuths):
            raise invalid(
                "instrument.azimuth_deg", azimuths, "with 0 and 180",
                "figures show the principal plane",
            )  # fmt: skip
        if is_drawn and instrument.n_bins is not None and instrument.n_bins[1] % 2:
            raise invalid(
                "instrument.n_bins", instrument.n_bins, "an even number around",
                "figures show the principal plane",
            )  # fmt: skip
        if self.figure.kind == "bins" and instrument.estimator != "bins":
            raise invalid(
                "instrument.estimator", instrument.estimator, "bins for figure.kind = bins"
            )

    def _check_unused_figure_settings(self) -> None:
        """Reject settings that have no effect on the figure."""
        figure, kind = self.figure, self.resolve_figure()["kind"]
        for key, kinds in KINDS_OF_SETTING.items():
            if getattr(figure, key) is not None and kind not in kinds and kind != "none":
                allowed = f"left out for a figure of kind {kind}"
                hint = f"it belongs to {' and '.join(kinds)}"
                raise invalid(f"figure.{key}", getattr(figure, key), allowed, hint)
        free = [values for name, values in self.grid.items() if name not in figure.select]
        lines = [values for values in free if len(values) > 1]
        compares_default = (
            len(lines) == 1 and DEFAULT_LABEL in lines[0] and len(lines[0]) <= MAX_PANELS
        )
        has_one_line = not free or compares_default
        if kind == "spectra" and figure.legend is not None and has_one_line and not figure.measured:
            hint = (
                "panels show differences from the default"
                if compares_default
                else "there is one line"
            )
            raise invalid("figure.legend", figure.legend, "left out", hint)
        low, high = figure.wavelength_nm or (0.0, np.inf)
        x = self.instrument.get_wavelengths()
        if not ((x >= low) & (x <= high)).any():
            allowed = f"with some of the wavelengths from {x[0]:g} to {x[-1]:g} nm"
            raise invalid("figure.wavelength_nm", [low, high], allowed)

    def _check_hemisphere(self) -> None:
        """Reject a hemisphere map of directions that do not cover all azimuths."""
        instrument = self.instrument
        polar = np.asarray(instrument.polar_deg or POLAR_DEG)
        azimuth = np.asarray(instrument.azimuth_deg or AZIMUTH_DEG)
        key = "azimuth_deg" if instrument.azimuth_deg is not None else "polar_deg"
        given: Any = getattr(instrument, key)
        if instrument.n_bins is not None:
            key, given = "n_bins", instrument.n_bins
            rows, columns = given
            polar = np.linspace(0.0, 90.0, rows)
            azimuth = np.linspace(0.0, 360.0, columns, endpoint=False)
        if not can_map_hemisphere(polar, azimuth):
            raise invalid(
                f"instrument.{key}",
                given,
                f"at least {MIN_POLAR_ANGLES} polar angles and {MIN_AZIMUTHS} azimuths at most "
                f"{MAX_AZIMUTH_GAP_DEG:g} degrees apart, all around, "
                "for figure.kind = 'hemisphere'",
            )

    def _check_single_point(self) -> None:
        """Reject figures of one grid point that do not select it."""
        free = [parameter for parameter in self.grid if parameter not in self.figure.select]
        kind = self.figure.kind or FIGURE_KINDS[self.instrument.kind][0]
        if kind in SINGLE_POINT_KINDS and len(free) > (kind == "lobes"):
            raise invalid(
                "figure.select",
                self.figure.select,
                f"with a value of {', '.join(free)} for a figure of kind {kind}",
                "it shows one point of the grid; the dataset holds all",
            )

    def _check_swatches(self) -> None:
        """Reject colours of spectra without the visible range, or of too many parameters."""
        if self.figure.kind != "swatches":
            return
        x = self.instrument.get_wavelengths()
        if not covers_visible(x):
            raise invalid(
                "instrument.wavelength_nm", [float(x[0]), float(x[-1])],
                "400 to 780 nm in steps of at most 10 nm for figure.kind = 'swatches'",
            )  # fmt: skip
        if not 1 <= len(self.grid) - len(self.figure.select) <= 2:
            raise invalid(
                "grid", list(self.grid), "one or two parameters for figure.kind = 'swatches'"
            )

    def _check_quantity(self, medium: Medium) -> None:
        """Reject a figure of a quantity that the medium does not have."""
        has_no_grain_distance = not hasattr(medium, "mean_grain_distance_m")
        is_next_event = self.instrument.estimator == "next_event" and "btdf" in self.figure.quantity
        if is_next_event and getattr(medium, "bottom_albedo", None) is not None:
            raise invalid("figure.quantity", "btdf", "brdf over a bottom with local estimation")
        if "btdf" in self.figure.quantity and medium.reflecting_ground is not None:
            raise invalid("figure.quantity", "btdf", "brdf over a ground")
        if self.figure.kind == "polarization":
            if not medium.polarized:
                raise invalid("medium.polarized", False, "true for figure.kind = 'polarization'")
            if self.instrument.estimator not in ("next_event", "bins"):
                raise invalid(
                    "instrument.estimator", self.instrument.estimator,
                    "next_event or bins for figure.kind = 'polarization'",
                )  # fmt: skip
        if has_no_grain_distance and "mean_grain_distance" in self.figure.quantity:
            hint = "left out: a particle layer has no grains, and a stack has no single distance"
            raise invalid("figure.quantity", "mean_grain_distance", hint)

    def list_product_paths(self) -> list[str]:
        """Return the files of the experiment, relative to the results folder."""
        figure = f"figures/{self.name}"
        return [
            f"data/{self.name}.nc",
            *(figure + suffix for suffix in FIGURE_SUFFIXES if self.figure.kind != "none"),
            *([f"tables/{self.name}_parameters.csv"] if self.fit else []),
            *([f"tables/{self.name}_retrieved.csv"] if self.retrieve else []),
        ]

    def resolve_figure(self) -> dict[str, Any]:
        """Return the section `figure` for `splits.plotting.draw`, with its kind resolved.

        The selected values are those of the dataset's coordinates.
        """
        default_kind = FIGURE_KINDS[self.instrument.kind][0]
        if default_kind == "spectra" and self.grid and self.instrument.get_wavelengths().size == 1:
            default_kind = "points"
        fixed = {}
        for dimension, label in self.figure.select.items():
            values = self.grid[dimension]
            index = list(values).index(find_label(dimension, values, label))
            fixed[dimension] = to_coordinate_values(values)[index].item()
        section = self.figure.model_dump(mode="json")
        return {**section, "kind": self.figure.kind or default_kind, "select": fixed}
