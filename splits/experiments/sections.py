"""Sections of an experiment file: figure, fit, and what all sections have in common."""

from __future__ import annotations

from pathlib import PurePath
from typing import Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from splits.checks import refuse, under
from splits.experiments.parameters import checked_ranges
from splits.experiments.texts import (
    LONGEST_LABEL,
    LONGEST_TITLE,
    check_mathematics,
    check_path,
    check_text,
)

FIGURES = {
    "spectrophotometer": ("spectra", "points", "swatches", "fit"),
    "goniophotometer": ("principal_plane", "hemisphere", "lobes", "cells", "polarization"),
    "bssrdf": ("spread",),
    "refractive_index": ("refractive_index",),
    "surface": ("surface",),
    "lens": ("lens",),
    "table": ("summary",),
}
"""Kinds of figures that show what an instrument measures, the usual one first."""
OF_ONE_POINT = ("spread", "lobes", "cells", "surface", "lens")
"""Kinds of figures that show one point of a grid; of lobes, one parameter may vary."""
QUANTITIES = {
    "spectrophotometer": ("reflectance", "transmittance", "absorptance", "mean_grain_distance"),
    "goniophotometer": ("brdf", "btdf", "reflectance_factor", "anisotropy_factor"),
    "table": ("reflectance", "transmittance"),
}
"""What figures of an instrument may show."""
SHOWN = {
    "lobes": "brdf", "cells": "brdf", "polarization": "brdf", "swatches": "reflectance",
    "fit": "reflectance",
}  # fmt: skip
"""What kinds of figures show that do not let one choose."""
USED_BY = {
    "wavelength_nm": ("spectra",),
    "measured": ("spectra",),
    "ylim": ("spectra", "principal_plane"),
    "legend": ("spectra", "points", "summary", "fit", "principal_plane", "hemisphere",
               "polarization"),
}  # fmt: skip
"""Settings of figures that only some kinds show."""
Quantity = Literal[
    "reflectance", "transmittance", "absorptance", "mean_grain_distance",
    "brdf", "btdf", "reflectance_factor", "anisotropy_factor",
]  # fmt: skip


def check_file(key: str, name: str) -> str:
    """Return the name of a file of config/measured, or refuse a path that leads elsewhere."""
    if not name.isprintable() or len(name) > 100 or PurePath(name).name != name or "\\" in name:
        raise refuse(key, name, "the name of a file of config/measured, without folders")
    return check_path(key, name)


class Section(BaseModel):
    """A configuration section: unknown keys are refused, values are fixed once read."""

    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="constants")

    @field_validator("*", mode="before")
    @classmethod
    def _reject_booleans(cls, value: Any) -> Any:
        # Nothing here is switched on and off; pydantic would take true for the number 1.
        if isinstance(value, bool):
            raise PydanticCustomError("no_switch", "true or false")
        return value


class FigureSection(Section):
    """How an experiment's figure shows its dataset."""

    model_config = ConfigDict(allow_inf_nan=False)

    quantity: tuple[Quantity, ...] = ("reflectance",)
    kind: Literal[
        "spectra", "points", "refractive_index", "swatches", "fit",
        "principal_plane", "hemisphere", "lobes", "cells", "spread", "surface", "lens",
        "polarization", "summary", "none",
    ] | None = None  # fmt: skip
    wavelength_nm: tuple[float, float] | None = None
    at: dict[str, float | str] = {}
    measured: str | None = None
    legend: str | None = None
    ylim: tuple[float, float] | None = None
    note: str | None = None

    @field_validator("quantity", mode="before")
    @classmethod
    def _to_tuple(cls, value: Any) -> Any:
        return (value,) if isinstance(value, str) else value

    @field_validator("at", mode="before")
    @classmethod
    def _label_booleans(cls, value: Any) -> Any:
        # Grids label true and false by these words.
        if not isinstance(value, dict):
            return value
        return {key: str(v) if isinstance(v, bool) else v for key, v in value.items()}

    @field_validator("measured")
    @classmethod
    def _check_measured(cls, value: str | None) -> str | None:
        return value if value is None else check_file("figure.measured", value)

    @field_validator("legend", "note")
    @classmethod
    def _check_text(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value is None:
            return None
        key = f"figure.{info.field_name}"
        longest = LONGEST_LABEL if info.field_name == "legend" else LONGEST_TITLE
        return check_mathematics(key, check_text(key, value, longest))

    @model_validator(mode="after")
    def _check_settings(self) -> FigureSection:
        if not self.quantity:
            raise refuse("figure.quantity", [], "at least one quantity")
        for key in ("wavelength_nm", "ylim"):
            limits = getattr(self, key)
            if limits is not None and not limits[0] < limits[1]:
                raise refuse(f"figure.{key}", list(limits), "low < high")
        if self.kind == "none" and self.model_fields_set != {"kind"}:
            others = sorted(self.model_fields_set - {"kind"})
            raise refuse("figure.kind", "none", f"left out with {', '.join(others)}")
        shown = SHOWN.get(self.kind or "")
        if shown and "quantity" in self.model_fields_set and self.quantity != (shown,):
            raise refuse("figure.quantity", self.quantity, f"{shown} for a figure of {self.kind}")
        if "mean_grain_distance" in self.quantity and self.kind != "points":
            raise refuse("figure.kind", self.kind, "points for mean_grain_distance")
        return self


class FitSection(Section):
    """Measured spectra to find sands for, instead of simulating given ones.

    `measured` names a file of config/measured with a column ``wavelength_nm`` and a column per
    sample; `samples` chooses some of them.  `ranges` replaces those of
    `splits.experiments.parameters.RANGES`.
    """

    measured: str
    samples: tuple[str, ...] = ()
    ranges: dict[str, tuple[float, float]] = {}

    @field_validator("measured")
    @classmethod
    def _check_measured(cls, value: str) -> str:
        return check_file("fit.measured", value)

    @field_validator("ranges")
    @classmethod
    def _check_ranges(cls, value: dict[str, Any]) -> dict[str, Any]:
        with under("fit"):
            checked_ranges(value)
        return value
