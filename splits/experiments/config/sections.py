"""Sections `figure` and `fit` of an experiment file, their base class, and checks of texts."""

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

from splits.core.validation import invalid, key_prefix
from splits.retrieval.sand_parameters import resolve_ranges

MAX_LABEL_CHARS = 80
MAX_TITLE_CHARS = 200
MAX_CAPTION_CHARS = 5000
FIGURE_SUFFIXES = (".png", ".svg", ".pdf")
"""File suffixes of figures."""


def check_text(key: str, value: str, max_chars: int, multiline: bool = False) -> str:
    """Return a printable text of one or several lines; reject others.

    Parameters
    ----------
    key, value : str
    max_chars : int
        Largest number of characters.
    multiline : bool
        Whether several lines are allowed.
    """
    if len(value) > max_chars:
        raise invalid(key, value, f"at most {max_chars} characters")
    joined = value.replace("\n", "").replace("\t", "") if multiline else value
    if not joined.isprintable():
        raise invalid(key, value, "text without control characters or line breaks")
    return value


def check_path(key: str, value: str) -> str:
    """Return the path of a folder or file; reject one that Snakemake would read as a pattern."""
    if not value.isprintable() or set(value) & set("{}<>"):
        allowed = "a path without { } < > and control characters"
        raise invalid(key, value, allowed, "Snakemake reads braces as wildcards")
    return value


def check_mathematics(key: str, value: str) -> str:
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
        raise invalid(key, value, "text that matplotlib can typeset", hint) from None
    return value


FIGURE_KINDS = {
    "spectrophotometer": ("spectra", "points", "swatches", "fit"),
    "goniophotometer": ("principal_plane", "hemisphere", "lobes", "bins", "polarization"),
    "beam_spread": ("spread",),
    "refractive_index": ("refractive_index",),
    "surface_map": ("surface",),
    "lens": ("lens",),
    "table": ("summary",),
}
"""Kinds of figures for an instrument, the default first."""
SINGLE_POINT_KINDS = ("spread", "lobes", "bins", "surface", "lens")
"""Kinds of figures that show one point of a grid; for lobes, one parameter may vary."""
FIGURE_QUANTITIES = {
    "spectrophotometer": ("reflectance", "transmittance", "absorptance", "mean_grain_distance"),
    "goniophotometer": ("brdf", "btdf", "reflectance_factor", "anisotropy_factor"),
    "table": ("reflectance", "transmittance"),
}
"""Quantities that figures of an instrument may show."""
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


def check_measured_file(key: str, name: str) -> str:
    """Return the name of a file of config/measured; reject paths to other folders."""
    if not name.isprintable() or len(name) > 100 or PurePath(name).name != name or "\\" in name:
        raise invalid(key, name, "the name of a file of config/measured, without folders")
    return check_path(key, name)


class ConfigSection(BaseModel):
    """A configuration section: immutable, and unknown keys are rejected."""

    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="constants")

    @field_validator("*", mode="before")
    @classmethod
    def _reject_booleans(cls, value: Any) -> Any:
        # No setting is a boolean; pydantic would convert true to the number 1.
        if isinstance(value, bool):
            raise PydanticCustomError("no_switch", "true or false")
        return value


class FigureSection(ConfigSection):
    """Settings of an experiment's figure."""

    model_config = ConfigDict(allow_inf_nan=False)

    quantity: tuple[QuantityName, ...] = ("reflectance",)
    kind: Literal[
        "spectra", "points", "refractive_index", "swatches", "fit",
        "principal_plane", "hemisphere", "lobes", "bins", "spread", "surface", "lens",
        "polarization", "summary", "none",
    ] | None = None  # fmt: skip
    wavelength_nm: tuple[float, float] | None = None
    select: dict[str, float | str] = {}
    measured: str | None = None
    legend: str | None = None
    ylim: tuple[float, float] | None = None
    note: str | None = None

    @field_validator("quantity", mode="before")
    @classmethod
    def _to_tuple(cls, value: Any) -> Any:
        return (value,) if isinstance(value, str) else value

    @field_validator("select", mode="before")
    @classmethod
    def _label_booleans(cls, value: Any) -> Any:
        # Labels of booleans on a grid are texts.
        if not isinstance(value, dict):
            return value
        return {key: str(v) if isinstance(v, bool) else v for key, v in value.items()}

    @field_validator("measured")
    @classmethod
    def _check_measured(cls, value: str | None) -> str | None:
        return value if value is None else check_measured_file("figure.measured", value)

    @field_validator("legend", "note")
    @classmethod
    def _check_text(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value is None:
            return None
        key = f"figure.{info.field_name}"
        max_chars = MAX_LABEL_CHARS if info.field_name == "legend" else MAX_TITLE_CHARS
        return check_mathematics(key, check_text(key, value, max_chars))

    @model_validator(mode="after")
    def _check_settings(self) -> FigureSection:
        if not self.quantity:
            raise invalid("figure.quantity", [], "at least one quantity")
        for key in ("wavelength_nm", "ylim"):
            limits = getattr(self, key)
            if limits is not None and not limits[0] < limits[1]:
                raise invalid(f"figure.{key}", list(limits), "low < high")
        if self.kind == "none" and self.model_fields_set != {"kind"}:
            others = sorted(self.model_fields_set - {"kind"})
            raise invalid("figure.kind", "none", f"left out with {', '.join(others)}")
        quantity = QUANTITY_OF_KIND.get(self.kind or "")
        if quantity and "quantity" in self.model_fields_set and self.quantity != (quantity,):
            raise invalid(
                "figure.quantity", self.quantity, f"{quantity} for a figure of {self.kind}"
            )
        if "mean_grain_distance" in self.quantity and self.kind != "points":
            raise invalid("figure.kind", self.kind, "points for mean_grain_distance")
        return self


class FitSection(ConfigSection):
    """Measured spectra to which sands are fitted.

    `measured` names a file of config/measured with a column ``wavelength_nm`` and a column per
    sample; `samples` selects some of them.  `ranges` replaces ranges of
    `splits.retrieval.sand_parameters.DEFAULT_RANGES`.
    """

    measured: str
    samples: tuple[str, ...] = ()
    ranges: dict[str, tuple[float, float]] = {}

    @field_validator("measured")
    @classmethod
    def _check_measured(cls, value: str) -> str:
        return check_measured_file("fit.measured", value)

    @field_validator("ranges")
    @classmethod
    def _check_ranges(cls, value: dict[str, Any]) -> dict[str, Any]:
        with key_prefix("fit"):
            resolve_ranges(value)
        return value
