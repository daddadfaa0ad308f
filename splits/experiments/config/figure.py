"""Section `figure` of an experiment file, and its validation against the simulation."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from splits.analysis.colour import covers_visible
from splits.core.validation import check_choice, invalid, key_prefix
from splits.experiments.config.grid import find_label, to_coordinate_values
from splits.experiments.config.sections import (
    FiniteSection,
    Interval,
    Label,
    MeasuredFile,
    Title,
    accept_single,
    check_different,
    check_mathematics,
)
from splits.experiments.config.simulation import SimulationConfig
from splits.media.medium import Medium
from splits.plotting.panels import (
    DEFAULT_LABEL,
    MAX_COLUMNS,
    MAX_LINES,
    MAX_PANELS,
    MAX_ROWS,
    REDUCTION_HINT,
    check_count,
    choose_panel_parameters,
)

SINGLE_POINT_KINDS = ("spread", "lobes", "bins", "surface", "lens")
"""Kinds of figures that show one point of a grid; for lobes, one parameter may vary."""
QUANTITY_OF_KIND = {
    "lobes": "brdf", "bins": "brdf", "polarization": "brdf", "swatches": "reflectance",
    "fit": "reflectance",
}  # fmt: skip
"""Quantity of kinds of figures that always show the same one."""
KINDS_OF_SETTING = {
    "wavelength_nm": ("spectra",),
    "measured": ("spectra",),
    "ylim": ("spectra", "principal_plane"),
    "legend": ("spectra", "points", "summary", "fit", "principal_plane", "hemisphere",
               "polarization", "return", "range_bias"),
}  # fmt: skip
"""Settings that only some kinds of figures have, with these kinds."""
FIGURE_LIMITS = {
    "points": (MAX_LINES, "points", MAX_ROWS),
    "lobes": (MAX_PANELS, "surfaces", MAX_PANELS),
    "hemisphere": (MAX_PANELS, "maps", MAX_PANELS),
    "spread": (MAX_LINES // 2, "maps", MAX_LINES),
    "principal_plane": (MAX_LINES, "lines", MAX_LINES),
    "polarization": (MAX_LINES, "lines", MAX_LINES),
    "return": (MAX_LINES, "lines", MAX_LINES),
    "range_bias": (MAX_LINES, "points", MAX_ROWS),
    "fit": (None, "lines", MAX_LINES),
}
"""Largest number of wavelengths of kinds of figures, name of what they show, and its limit."""
QuantityName = Literal[
    "reflectance", "transmittance", "absorptance", "mean_grain_distance",
    "brdf", "btdf", "reflectance_factor", "anisotropy_factor", "brdf_dolp",
]  # fmt: skip
FigureKind = Literal[
    "spectra", "points", "refractive_index", "swatches", "fit",
    "principal_plane", "hemisphere", "lobes", "bins", "spread", "surface", "lens",
    "polarization", "return", "range_bias", "summary", "season", "none",
]  # fmt: skip
Formula = AfterValidator(check_mathematics)


class FigureSection(FiniteSection):
    """Settings of an experiment's figure."""

    quantity: Annotated[tuple[QuantityName, ...], accept_single(QuantityName)] = ("reflectance",)
    """one quantity, or several; `brdf` for a goniophotometer"""
    kind: FigureKind | None = None
    """kind of the figure, see the instruments above; by default the first one of the instrument, or
    `points` for a grid at one wavelength; `none` for no figure"""
    wavelength_nm: Interval | None = None
    """limits of the wavelength axis of spectra (nm); by default all"""
    select: dict[str, float | str] = Field({})
    """values at which parameters of the grid are fixed: a text is a label, a number is a value;
    required for figures that show one point"""
    measured: MeasuredFile | None = None
    """name of a file of `config/measured/` that is drawn with spectra of one panel, with
    `wavelength_nm`, the quantity, and optionally its `…_min` and `…_max`"""
    legend: Annotated[Label, Formula] | None = None
    """title of the legend, by default the parameters of the grid; may contain formulas between
    dollar signs"""
    ylim: Interval | None = None
    """limits of the vertical axis of spectra and principal planes; in a figure of differences from
    `default`, those of the panel of the default"""
    note: Annotated[Title, Formula] | None = None
    """a sentence below the figure; may contain formulas between dollar signs"""

    @field_validator("select", mode="before")
    @classmethod
    def _label_booleans(cls, value: Any) -> Any:
        # Labels of booleans on a grid are texts.
        if not isinstance(value, dict):
            return value
        return {key: str(v) if isinstance(v, bool) else v for key, v in value.items()}

    @model_validator(mode="after")
    def _check_settings(self) -> FigureSection:
        with key_prefix("quantity"):
            check_different(self.quantity)
        if self.kind == "none" and self.model_fields_set != {"kind"}:
            others = sorted(self.model_fields_set - {"kind"})
            raise invalid("kind", "none", f"left out with {', '.join(others)}")
        quantity = QUANTITY_OF_KIND.get(self.kind or "")
        if quantity and "quantity" in self.model_fields_set and self.quantity != (quantity,):
            raise invalid("quantity", self.quantity, f"{quantity} for a figure of {self.kind}")
        if "mean_grain_distance" in self.quantity and self.kind != "points":
            raise invalid("kind", self.kind, "points for mean_grain_distance")
        return self


def resolve_figure(simulation: SimulationConfig, figure: FigureSection) -> dict[str, Any]:
    """Return a section `figure` with its kind resolved and values of coordinates selected."""
    fixed = {}
    for dimension, label in figure.select.items():
        values = simulation.grid[dimension]
        index = list(values).index(find_label(dimension, values, label))
        fixed[dimension] = to_coordinate_values(values)[index].item()
    section = figure.model_dump(mode="json")
    return {**section, "kind": _resolve_kind(simulation, figure), "select": fixed}


def _resolve_kind(simulation: SimulationConfig, figure: FigureSection) -> str:
    """Return the kind of a figure, by default the first one of the instrument."""
    default = "season" if simulation.has_packs else simulation.instrument.FIGURES[0]
    if default == "spectra" and simulation.grid and simulation.instrument.count_values() == 1:
        default = "points"
    return figure.kind or default


def check_figure(simulation: SimulationConfig, figure: FigureSection) -> None:
    """Reject a figure that the instrument, the media or the grid do not allow.

    The error names the key, and a remedy for a figure that would not be legible.
    """
    for dimension, value in figure.select.items():
        if not simulation.grid:
            raise invalid("figure.select", dimension, "left out where there is no grid")
        check_choice("figure.select", dimension, simulation.grid)
        find_label(dimension, simulation.grid[dimension], value)
    kind = _resolve_kind(simulation, figure)
    if kind == "fit" and not simulation.fit:
        raise invalid("figure.kind", "fit", "another one for an experiment without section fit")
    is_given = "quantity" in figure.model_fields_set or kind == "summary"
    given_quantities = figure.quantity if is_given else ()
    simulation.instrument.check_figure(kind, given_quantities)
    if kind == "none":
        return
    if simulation.has_packs != (kind == "season"):
        allowed = "season or none" if simulation.has_packs else "another one"
        raise invalid("figure.kind", kind, f"{allowed} for this medium")
    _check_settings(simulation, figure, kind)
    if simulation.has_packs:
        return
    _check_grid(simulation, figure, kind)
    for _, medium, _ in simulation.iter_points():
        _check_quantity(simulation, figure, medium)


def _check_settings(simulation: SimulationConfig, figure: FigureSection, kind: str) -> None:
    """Reject settings that have no effect on the figure."""
    for key, kinds in KINDS_OF_SETTING.items():
        if getattr(figure, key) is not None and kind not in kinds:
            hint = f"it belongs to {' and '.join(kinds)}"
            allowed = f"left out for a figure of kind {kind}"
            raise invalid(f"figure.{key}", getattr(figure, key), allowed, hint)
    free = [values for name, values in simulation.grid.items() if name not in figure.select]
    lines = [values for values in free if len(values) > 1]
    compares_default = len(lines) == 1 and DEFAULT_LABEL in lines[0] and len(lines[0]) <= MAX_PANELS
    has_one_line = not free or compares_default
    if kind == "spectra" and figure.legend is not None and has_one_line and not figure.measured:
        differences = "panels show differences from the default"
        hint = differences if compares_default else "there is one line"
        raise invalid("figure.legend", figure.legend, "left out", hint)
    low, high = figure.wavelength_nm or (0.0, math.inf)
    x = simulation.instrument.get_wavelengths()
    if not ((x >= low) & (x <= high)).any():
        allowed = f"with some of the wavelengths from {x[0]:g} to {x[-1]:g} nm"
        raise invalid("figure.wavelength_nm", [low, high], allowed)
    if kind == "swatches" and not covers_visible(x):
        allowed = "400 to 780 nm in steps of at most 10 nm for figure.kind = 'swatches'"
        raise invalid("instrument.wavelength_nm", [float(x[0]), float(x[-1])], allowed)


def _check_grid(simulation: SimulationConfig, figure: FigureSection, kind: str) -> None:
    """Reject a figure of more points, lines or panels than it can show legibly."""
    grid, select = simulation.grid, figure.select
    sizes = {name: len(values) for name, values in grid.items() if name not in select}
    if kind in SINGLE_POINT_KINDS and len(sizes) > (kind == "lobes"):
        allowed = f"with a value of {', '.join(sizes)} for a figure of kind {kind}"
        hint = "it shows one point of the grid; the dataset holds all"
        raise invalid("figure.select", select, allowed, hint)
    if kind == "range_bias" and not any(
        len(grid[name]) > 1 and to_coordinate_values(grid[name]).dtype.kind == "f" for name in sizes
    ):
        allowed = "a parameter with several numbers for figure.kind = 'range_bias'"
        raise invalid("grid", list(grid), allowed)
    count, n_wavelengths = math.prod(sizes.values()), simulation.instrument.get_wavelengths().size
    if kind == "spectra":
        if choose_panel_parameters(sizes, len(figure.quantity), select) and figure.measured:
            allowed = f"left out for a figure of more than {MAX_LINES} lines"
            hint = "or fix more with figure.select"
            raise invalid("figure.measured", figure.measured, allowed, hint)
    elif kind == "swatches":
        if not 1 <= len(sizes) <= 2:
            raise invalid("grid", list(grid), "one or two parameters for figure.kind = 'swatches'")
        columns, *rows = sizes.values()
        check_count("columns of colours", columns, MAX_COLUMNS, select)
        check_count("rows of colours", math.prod(rows), MAX_ROWS, select)
    elif kind in FIGURE_LIMITS:
        max_wavelengths, items, limit = FIGURE_LIMITS[kind]
        if max_wavelengths and n_wavelengths > max_wavelengths:
            allowed = f"at most {max_wavelengths} wavelengths for this figure"
            given = f"{n_wavelengths} wavelengths"
            raise invalid("instrument.wavelength_nm", given, allowed, REDUCTION_HINT)
        count *= 1 if kind in ("points", "fit") else n_wavelengths
        count *= len(figure.quantity) if kind == "hemisphere" else 1
        check_count(items, count, limit, select)


def _check_quantity(simulation: SimulationConfig, figure: FigureSection, medium: Medium) -> None:
    """Reject a figure of a quantity that the medium does not have."""
    if "btdf" in figure.quantity:
        is_next_event = getattr(simulation.instrument, "estimator", None) == "next_event"
        if is_next_event and getattr(medium, "bottom_albedo", None) is not None:
            raise invalid("figure.quantity", "btdf", "brdf over a bottom with local estimation")
        if medium.reflecting_ground is not None:
            raise invalid("figure.quantity", "btdf", "brdf over a ground")
    is_polarized = medium.polarized or getattr(simulation.instrument, "stokes", False)
    shows_polarization = figure.kind == "polarization" or "brdf_dolp" in figure.quantity
    if shows_polarization and not is_polarized:
        hint = "layers of particles also need medium.polarized: true"
        raise invalid("instrument.stokes", False, "true for a figure of polarization", hint)
    if "mean_grain_distance" in figure.quantity and not hasattr(medium, "mean_grain_distance_m"):
        hint = "left out: a particle layer has no grains, and a stack has no single distance"
        raise invalid("figure.quantity", "mean_grain_distance", hint)
