"""Section `figure` of an experiment file; the functions that draw check their data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from splits.core.validation import check_choice, invalid, key_prefix
from splits.experiments.config.media import find_label, to_coordinate_values
from splits.experiments.config.sections import (
    FiniteSection,
    Interval,
    Label,
    MeasuredFile,
    Number,
    Title,
    accept_single,
    check_different,
)
from splits.plotting.panels import INSTRUMENT_FIGURES, check_settings
from splits.tables.axes import ALL_QUANTITIES

if TYPE_CHECKING:
    from splits.experiments.config.simulation import SimulationConfig

QuantityName = Literal[
    "reflectance", "transmittance", "absorptance", "mean_grain_distance",
    "brdf", "btdf", "reflectance_factor", "anisotropy_factor", "brdf_dolp",
]  # fmt: skip
FigureKind = Literal[
    "spectra", "points", "refractive_index", "swatches",
    "principal_plane", "hemisphere", "lobes", "bins", "spread", "surface", "lens",
    "polarization", "return", "range_bias", "summary", "season", "none",
]  # fmt: skip

INSTRUMENT_QUANTITIES: dict[str, tuple[str, ...]] = {
    "spectrophotometer": ("reflectance", "transmittance", "absorptance", "mean_grain_distance"),
    "goniophotometer": ("brdf", "btdf", "reflectance_factor", "anisotropy_factor", "brdf_dolp"),
    "table": ALL_QUANTITIES,
}
"""Quantities that the figures of an instrument may show."""


def _check_mathematics(value: str) -> str:
    """Return a text that may contain formulas between dollar signs; reject invalid formulas."""
    # A single dollar sign starts no formula.
    n_dollars = value.count("$") - value.count(r"\$")
    if n_dollars < 2 or n_dollars % 2:
        return value
    from matplotlib.mathtext import MathTextParser  # a figure's job loads it anyway

    try:
        MathTextParser("path").parse(value)
    except (ValueError, RuntimeError):
        hint = r"write \$ for a dollar sign"
        raise invalid("", value, "text that matplotlib can typeset", hint) from None
    return value


Formula = AfterValidator(_check_mathematics)


class FigureSection(FiniteSection):
    """Settings of an experiment's figure."""

    quantity: Annotated[tuple[QuantityName, ...], accept_single(QuantityName)] = ("reflectance",)
    """one quantity, or several; `brdf` for a goniophotometer"""
    kind: FigureKind | None = None
    """kind of the figure, see the instruments above; by default the first one of the instrument, or
    `points` for a grid at one wavelength; `none` for no figure"""
    wavelength_nm: Interval | None = None
    """limits of the wavelength axis of spectra (nm); by default all"""
    select: dict[str, Number | str] = Field({})
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
    def _check_quantity(self) -> FigureSection:
        with key_prefix("quantity"):
            check_different(self.quantity)
        return self


def resolve_figure(simulation: SimulationConfig, figure: FigureSection) -> dict[str, Any]:
    """Return the given settings of a figure, with its kind, and selected values of coordinates.

    Kinds, quantities and values that the experiment does not have are rejected.
    """
    instrument, grid = simulation.instrument, simulation.grid
    kinds = [kind for kind in INSTRUMENT_FIGURES.get(instrument.kind, ()) if kind != "season"] or [
        "none"
    ]
    if simulation.has_packs:
        kinds = ["season"]
    is_single = kinds[0] == "spectra" and grid and instrument.get_wavelengths().size == 1
    kind = figure.kind or ("points" if is_single else kinds[0])
    if kind not in (*kinds, "none"):
        allowed = f"one of {', '.join(kinds)} or none for instrument.kind = {instrument.kind!r}"
        raise invalid("figure.kind", kind, allowed)
    given = figure.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    check_settings(kind, given)
    quantities = instrument.get("quantities") or INSTRUMENT_QUANTITIES.get(instrument.kind, ())
    for quantity in given.get("quantity", ()):
        check_choice("figure.quantity", quantity, quantities)
    fixed = {}
    for dimension, label in figure.select.items():
        if not grid:
            raise invalid("figure.select", dimension, "left out where there is no grid")
        check_choice("figure.select", dimension, grid)
        values = grid[dimension]
        index = list(values).index(find_label(dimension, values, label))
        fixed[dimension] = to_coordinate_values(values)[index].item()
    return {**given, "kind": kind, "select": fixed}
