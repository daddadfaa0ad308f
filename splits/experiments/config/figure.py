"""Section `figure` of an experiment file."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from splits.core.validation import check_choice, invalid
from splits.experiments.config.sections import (
    FiniteSection,
    Interval,
    Label,
    MeasuredFile,
    Title,
    check_mathematics,
    to_tuple,
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
               "polarization"),
}  # fmt: skip
"""Settings that only some kinds of figures have, with these kinds."""
QuantityName = Literal[
    "reflectance", "transmittance", "absorptance", "mean_grain_distance",
    "brdf", "btdf", "reflectance_factor", "anisotropy_factor",
]  # fmt: skip
FigureKind = Literal[
    "spectra", "points", "refractive_index", "swatches", "fit",
    "principal_plane", "hemisphere", "lobes", "bins", "spread", "surface", "lens",
    "polarization", "summary", "none",
]  # fmt: skip
Formula = AfterValidator(check_mathematics)


class FigureSection(FiniteSection):
    """Settings of an experiment's figure."""

    quantity: Annotated[
        tuple[QuantityName, ...],
        BeforeValidator(to_tuple, json_schema_input_type=QuantityName | tuple[QuantityName, ...]),
    ] = Field(
        ("reflectance",), description="one quantity, or several; `brdf` for a goniophotometer"
    )
    kind: FigureKind | None = Field(
        None,
        description="kind of the figure, see the instruments above; by default the first one of "
        "the instrument, or `points` for a grid at one wavelength; `none` for no figure",
    )
    wavelength_nm: Interval | None = Field(
        None, description="limits of the wavelength axis of spectra (nm); by default all"
    )
    select: dict[str, float | str] = Field(
        {},
        description="values at which parameters of the grid are fixed: a text is a label, a number "
        "is a value; required for figures that show one point",
    )
    measured: MeasuredFile | None = Field(
        None,
        description="name of a file of `config/measured/` that is drawn with spectra of one panel, "
        "with `wavelength_nm`, the quantity, and optionally its `…_min` and `…_max`",
    )
    legend: Annotated[Label, Formula] | None = Field(
        None,
        description="title of the legend, by default the parameters of the grid; may contain "
        "formulas between dollar signs",
    )
    ylim: Interval | None = Field(
        None,
        description="limits of the vertical axis of spectra and principal planes; in a figure of "
        "differences from `default`, those of the panel of the default",
    )
    note: Annotated[Title, Formula] | None = Field(
        None, description="a sentence below the figure; may contain formulas between dollar signs"
    )

    @field_validator("select", mode="before")
    @classmethod
    def _label_booleans(cls, value: Any) -> Any:
        # Labels of booleans on a grid are texts.
        if not isinstance(value, dict):
            return value
        return {key: str(v) if isinstance(v, bool) else v for key, v in value.items()}

    @model_validator(mode="after")
    def _check_settings(self) -> FigureSection:
        if not self.quantity:
            raise invalid("quantity", [], "at least one quantity")
        if self.kind == "none" and self.model_fields_set != {"kind"}:
            others = sorted(self.model_fields_set - {"kind"})
            raise invalid("kind", "none", f"left out with {', '.join(others)}")
        quantity = QUANTITY_OF_KIND.get(self.kind or "")
        if quantity and "quantity" in self.model_fields_set and self.quantity != (quantity,):
            raise invalid("quantity", self.quantity, f"{quantity} for a figure of {self.kind}")
        if "mean_grain_distance" in self.quantity and self.kind != "points":
            raise invalid("kind", self.kind, "points for mean_grain_distance")
        return self

    def check_quantities(self, measured: Iterable[str]) -> None:
        """Reject quantities that an instrument does not measure."""
        for quantity in self.quantity:
            check_choice("figure.quantity", quantity, measured)
