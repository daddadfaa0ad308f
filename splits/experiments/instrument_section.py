"""The instrument of an experiment file: which one, and its settings.

Settings that the instrument chosen does not know are refused.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from splits.checks import in_range, refuse, under
from splits.experiments.grids import evenly_spaced
from splits.experiments.sections import Section
from splits.instruments.arguments import (
    check_angles,
    check_cells,
    check_half_width,
    check_incidence,
    check_wavelengths,
    check_whole,
)
from splits.instruments.bssrdf import CELLS, SIDES
from splits.instruments.cells import CELLS_OF_5_DEG
from splits.instruments.goniophotometer import AZIMUTH_DEG, POLAR_DEG
from splits.instruments.lens import RAYS, check_depths, check_radius, check_ring
from splits.instruments.surface_map import MOST_REALISATIONS, POINTS

ESTIMATORS = {
    "spectrophotometer": ("spectral", "analog"),
    "goniophotometer": ("expansion", "cells", "local"),
}
ONLY_FOR = {
    "rays": ("goniophotometer", "bssrdf", "lens"),
    "target": ("goniophotometer",),
    "polar_deg": ("goniophotometer",),
    "azimuth_deg": ("goniophotometer",),
    "cells": ("goniophotometer",),
    "half_width_m": ("bssrdf", "surface", "lens"),
    "radius_m": ("lens",),
    "screen_depth_m": ("lens",),
    "over": ("lens",),
    "realisations": ("lens", "surface"),
    "quantities": ("table",),
    "covariance": ("table",),
    "blocks": ("table",),
}
"""Settings that only some instruments know."""
IGNORED = {
    "surface": ("wavelength_nm", "incidence_deg", "error_factor"),
    "lens": ("wavelength_nm", "incidence_deg", "error_factor"),
    "refractive_index": ("incidence_deg", "error_factor", "seed"),
}
"""Settings that all others know, but not these instruments."""
SEVERAL = "several values go under grid"
SURFACES = ("surface", "lens")
"""Instruments that look at a rough surface alone."""
REQUIRED = {"surface": ("half_width_m",), "lens": ("radius_m", "screen_depth_m")}
"""Settings that an instrument cannot do without."""


class WavelengthGrid(Section):
    """Equidistant wavelengths in nm, both ends included, and single ones besides."""

    model_config = ConfigDict(allow_inf_nan=False)

    start: float
    stop: float
    step: float = Field(gt=0)
    also: tuple[float, ...] = ()

    def to_array(self) -> np.ndarray:
        """Return the wavelengths (nm), increasing."""
        steps = evenly_spaced("wavelength_nm", self.start, self.stop, self.step)
        return np.unique(np.concatenate([steps, self.also]))


class Instrument(Section):
    """A virtual instrument and its settings."""

    model_config = ConfigDict(allow_inf_nan=False)

    kind: Literal[
        "spectrophotometer", "goniophotometer", "bssrdf", "refractive_index", "surface", "lens",
        "table",
    ] = "spectrophotometer"  # fmt: skip
    wavelength_nm: WavelengthGrid | tuple[float, ...] = WavelengthGrid(
        start=400, stop=2500, step=10
    )
    incidence_deg: float | str = 0.0
    estimator: Literal["spectral", "analog", "expansion", "cells", "local"] | None = None
    error_factor: float = 1.0
    seed: int | None = Field(default=None, ge=0)
    rays: int | None = Field(default=None, ge=1)
    target: Literal["brdf", "btdf"] | None = None
    polar_deg: tuple[float, ...] | None = None
    azimuth_deg: tuple[float, ...] | None = None
    cells: tuple[int, int] | None = None
    half_width_m: float | None = Field(default=None, gt=0)
    radius_m: float | None = Field(default=None, gt=0)
    screen_depth_m: tuple[float, ...] | None = None
    over: Literal["crest", "trough", "origin"] | None = None
    realisations: int | None = Field(default=None, ge=1)
    quantities: tuple[Literal["reflectance", "transmittance"], ...] | None = None
    covariance: Literal["keep", "leave_out"] | None = None
    blocks: int | None = Field(default=None, ge=1, le=10_000)

    @field_validator("incidence_deg", mode="before")
    @classmethod
    def _check_incidence(cls, value: float | str) -> float | str:
        with under("instrument"):
            if isinstance(value, (list, tuple)):
                raise refuse("incidence_deg", value, "one angle or diffuse", SEVERAL)
            return check_incidence(value)

    @field_validator("error_factor")
    @classmethod
    def _check_error_factor(cls, value: float) -> float:
        return in_range("instrument.error_factor", value, 0.01, 100.0)

    @model_validator(mode="after")
    def _check_settings(self) -> Instrument:
        known = ESTIMATORS.get(self.kind, ())
        if self.estimator is not None and self.estimator not in known:
            allowed = "one of " + ", ".join(known) if known else "left out"
            raise refuse("instrument.estimator", self.estimator, f"{allowed} for {self.kind}")
        for key, kinds in ONLY_FOR.items():
            if getattr(self, key) is not None and self.kind not in kinds:
                raise refuse(
                    f"instrument.{key}", getattr(self, key), f"left out for {self.kind}",
                    "it belongs to " + " and ".join(kinds),
                )  # fmt: skip
        for key in REQUIRED.get(self.kind, ()):
            if getattr(self, key) is None:
                raise refuse(f"instrument.{key}", None, f"given for {self.kind}")
        for key, low in (("rays", 1), ("seed", 0), ("realisations", 1)):
            if getattr(self, key) is not None:
                check_whole(f"instrument.{key}", getattr(self, key), low)
        with under("instrument"):
            self._check_extent()
        for key in ("polar_deg", "azimuth_deg") if self.estimator == "cells" else ():
            if getattr(self, key) is not None:
                raise refuse(f"instrument.{key}", getattr(self, key), "left out with cells")
        if self.cells is not None and self.estimator != "cells":
            raise refuse("instrument.cells", self.cells, "left out without estimator = cells")
        for key, end in (("polar_deg", 90.0), ("azimuth_deg", 360.0)):
            if getattr(self, key) is not None:
                check_angles(f"instrument.{key}", getattr(self, key), end)
        if self.cells is not None:
            with under("instrument"):
                check_cells(self.cells)
        self._check_unused()
        return self

    def _check_extent(self) -> None:
        """Refuse what an instrument that looks at places cannot look at."""
        if self.half_width_m is not None:
            check_half_width(self.kind, self.half_width_m)
        if self.kind == "surface" and self.realisations is not None:
            check_whole("realisations", self.realisations, 2, MOST_REALISATIONS)
        if self.kind == "lens":
            if self.half_width_m is None and self.over != "origin":
                hint = "where to look for the crest; or over: origin"
                raise refuse("half_width_m", None, "given for lens", hint)
            if self.half_width_m is not None and self.over == "origin":
                hint = "nothing is searched for"
                raise refuse("half_width_m", self.half_width_m, "left out over the origin", hint)
            depths = check_depths("screen_depth_m", self.screen_depth_m)
            check_radius(self.radius_m)
            check_ring(self.rays or RAYS, self.realisations or 1, depths.size)

    def _check_unused(self) -> None:
        """Refuse settings that would change nothing."""
        for key in IGNORED.get(self.kind, ()):
            value = getattr(self, key)
            if value != type(self).model_fields[key].default:
                given = value.model_dump() if isinstance(value, BaseModel) else value
                raise refuse(f"instrument.{key}", given, f"left out for {self.kind}")
        counted = "rays" if self.rays is not None else "cells" if self.estimator == "cells" else ""
        if counted and self.error_factor != 1.0:
            raise refuse(
                "instrument.error_factor", self.error_factor, f"left out with {counted}",
                "the number of rays is fixed there, not the error",
            )  # fmt: skip

    def get_wavelengths(self) -> np.ndarray:
        """Return the wavelengths (nm)."""
        grid = self.wavelength_nm
        with under("instrument"):
            return check_wavelengths(grid.to_array() if isinstance(grid, WavelengthGrid) else grid)

    def count_values(self) -> int:
        """Return how many values a quantity has at one point of a grid."""
        if self.kind == "lens":
            return len(self.screen_depth_m or ()) * (self.rays or RAYS)
        if self.kind == "surface":
            return POINTS**2
        places = 1
        if self.kind == "bssrdf":
            places = len(SIDES) * CELLS**2
        elif self.estimator == "cells":
            places = math.prod(self.cells or CELLS_OF_5_DEG)
        elif self.kind == "goniophotometer":
            places = len(self.polar_deg or POLAR_DEG) * len(self.azimuth_deg or AZIMUTH_DEG)
        return places * self.get_wavelengths().size
