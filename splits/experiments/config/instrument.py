"""Section `instrument` of an experiment file.

Settings that the chosen instrument does not have are rejected.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from splits.core.validation import check_integer, check_range, invalid, key_prefix
from splits.experiments.config.grid import make_even_spacing
from splits.experiments.config.sections import ConfigSection
from splits.instruments.angular_bins import DEFAULT_N_BINS
from splits.instruments.beam_spread_tally import N_MAP_PIXELS, SIDES
from splits.instruments.goniophotometer import AZIMUTH_DEG, POLAR_DEG
from splits.instruments.lens import (
    DEFAULT_RAYS,
    check_ring_radius,
    check_ring_size,
    check_screen_depths,
)
from splits.instruments.surface_map import DEFAULT_POINTS, MAX_REALIZATIONS
from splits.simulation.arguments import (
    check_direction_angles,
    check_half_width,
    check_incidence,
    check_n_bins,
    check_wavelengths,
)

ESTIMATORS = {
    "spectrophotometer": ("spectral", "analog"),
    "goniophotometer": ("expansion", "bins", "next_event"),
}
INSTRUMENTS_OF_SETTING = {
    "rays": ("goniophotometer", "beam_spread", "lens"),
    "target": ("goniophotometer",),
    "polar_deg": ("goniophotometer",),
    "azimuth_deg": ("goniophotometer",),
    "n_bins": ("goniophotometer",),
    "half_width_m": ("beam_spread", "surface_map", "lens"),
    "radius_m": ("lens",),
    "screen_depth_m": ("lens",),
    "centre_on": ("lens",),
    "realizations": ("lens", "surface_map"),
    "quantities": ("table",),
    "covariance": ("table",),
    "blocks": ("table",),
}
"""Settings that only some instruments have, with these instruments."""
UNUSED_SETTINGS = {
    "surface_map": ("wavelength_nm", "incidence_deg", "stderr_scale"),
    "lens": ("wavelength_nm", "incidence_deg", "stderr_scale"),
    "refractive_index": ("incidence_deg", "stderr_scale", "seed"),
}
"""Settings that these instruments do not have, unlike all others."""
USE_GRID_HINT = "several values belong under grid"
SURFACE_INSTRUMENTS = ("surface_map", "lens")
"""Instruments that measure a rough surface only."""
REQUIRED_SETTINGS = {"surface_map": ("half_width_m",), "lens": ("radius_m", "screen_depth_m")}
"""Settings that an instrument requires."""


class WavelengthGrid(ConfigSection):
    """Equidistant wavelengths in nm, both ends included, and additional single ones."""

    model_config = ConfigDict(allow_inf_nan=False)

    start: float
    stop: float
    step: float = Field(gt=0)
    also: tuple[float, ...] = ()

    def to_array(self) -> np.ndarray:
        """Return the wavelengths (nm), increasing."""
        steps = make_even_spacing("wavelength_nm", self.start, self.stop, self.step)
        return np.unique(np.concatenate([steps, self.also]))


class InstrumentSection(ConfigSection):
    """A virtual instrument and its settings."""

    model_config = ConfigDict(allow_inf_nan=False)

    kind: Literal[
        "spectrophotometer",
        "goniophotometer",
        "beam_spread",
        "refractive_index",
        "surface_map",
        "lens",
        "table",
    ] = "spectrophotometer"
    wavelength_nm: WavelengthGrid | tuple[float, ...] = WavelengthGrid(
        start=400, stop=2500, step=10
    )
    incidence_deg: float | str = 0.0
    estimator: Literal["spectral", "analog", "expansion", "bins", "next_event"] | None = None
    stderr_scale: float = 1.0
    seed: int | None = Field(default=None, ge=0)
    rays: int | None = Field(default=None, ge=1)
    target: Literal["brdf", "btdf"] | None = None
    polar_deg: tuple[float, ...] | None = None
    azimuth_deg: tuple[float, ...] | None = None
    n_bins: tuple[int, int] | None = None
    half_width_m: float | None = Field(default=None, gt=0)
    radius_m: float | None = Field(default=None, gt=0)
    screen_depth_m: tuple[float, ...] | None = None
    centre_on: Literal["crest", "trough", "origin"] | None = None
    realizations: int | None = Field(default=None, ge=1)
    quantities: tuple[Literal["reflectance", "transmittance"], ...] | None = None
    covariance: Literal["keep", "leave_out"] | None = None
    blocks: int | None = Field(default=None, ge=1, le=10_000)

    @field_validator("incidence_deg", mode="before")
    @classmethod
    def _check_incidence(cls, value: float | str) -> float | str:
        with key_prefix("instrument"):
            if isinstance(value, (list, tuple)):
                raise invalid("incidence_deg", value, "one angle or diffuse", USE_GRID_HINT)
            return check_incidence(value)

    @field_validator("stderr_scale")
    @classmethod
    def _check_error_factor(cls, value: float) -> float:
        return check_range("instrument.stderr_scale", value, 0.01, 100.0)

    @model_validator(mode="after")
    def _check_settings(self) -> InstrumentSection:
        allowed_estimators = ESTIMATORS.get(self.kind, ())
        if self.estimator is not None and self.estimator not in allowed_estimators:
            allowed = (
                "one of " + ", ".join(allowed_estimators) if allowed_estimators else "left out"
            )
            raise invalid("instrument.estimator", self.estimator, f"{allowed} for {self.kind}")
        for key, kinds in INSTRUMENTS_OF_SETTING.items():
            if getattr(self, key) is not None and self.kind not in kinds:
                raise invalid(
                    f"instrument.{key}", getattr(self, key), f"left out for {self.kind}",
                    "it belongs to " + " and ".join(kinds),
                )  # fmt: skip
        for key in REQUIRED_SETTINGS.get(self.kind, ()):
            if getattr(self, key) is None:
                raise invalid(f"instrument.{key}", None, f"given for {self.kind}")
        for key, low in (("rays", 1), ("seed", 0), ("realizations", 1)):
            if getattr(self, key) is not None:
                check_integer(f"instrument.{key}", getattr(self, key), low)
        with key_prefix("instrument"):
            self._check_extent()
        for key in ("polar_deg", "azimuth_deg") if self.estimator == "bins" else ():
            if getattr(self, key) is not None:
                raise invalid(f"instrument.{key}", getattr(self, key), "left out with bins")
        if self.n_bins is not None and self.estimator != "bins":
            raise invalid("instrument.n_bins", self.n_bins, "left out without estimator = bins")
        for key, end in (("polar_deg", 90.0), ("azimuth_deg", 360.0)):
            if getattr(self, key) is not None:
                check_direction_angles(f"instrument.{key}", getattr(self, key), end)
        if self.n_bins is not None:
            with key_prefix("instrument"):
                check_n_bins(self.n_bins)
        self._check_unused()
        return self

    def _check_extent(self) -> None:
        """Reject an extent that an imaging instrument cannot measure."""
        if self.half_width_m is not None:
            check_half_width(self.kind, self.half_width_m)
        if self.kind == "surface_map" and self.realizations is not None:
            check_integer("realizations", self.realizations, 2, MAX_REALIZATIONS)
        if self.kind == "lens":
            if self.half_width_m is None and self.centre_on != "origin":
                hint = "range of the search for the crest; or centre_on: origin"
                raise invalid("half_width_m", None, "given for lens", hint)
            if self.half_width_m is not None and self.centre_on == "origin":
                hint = "there is no search for a crest"
                raise invalid("half_width_m", self.half_width_m, "left out over the origin", hint)
            depths = check_screen_depths("screen_depth_m", self.screen_depth_m)
            check_ring_radius(self.radius_m)
            check_ring_size(self.rays or DEFAULT_RAYS, self.realizations or 1, depths.size)

    def _check_unused(self) -> None:
        """Reject settings that have no effect."""
        for key in UNUSED_SETTINGS.get(self.kind, ()):
            value = getattr(self, key)
            if value != type(self).model_fields[key].default:
                shown = value.model_dump() if isinstance(value, BaseModel) else value
                raise invalid(f"instrument.{key}", shown, f"left out for {self.kind}")
        fixed_by = "rays" if self.rays is not None else "bins" if self.estimator == "bins" else ""
        if fixed_by and self.stderr_scale != 1.0:
            raise invalid(
                "instrument.stderr_scale", self.stderr_scale, f"left out with {fixed_by}",
                "the number of rays is fixed there, not the error",
            )  # fmt: skip

    def get_wavelengths(self) -> np.ndarray:
        """Return the wavelengths (nm)."""
        grid = self.wavelength_nm
        with key_prefix("instrument"):
            return check_wavelengths(grid.to_array() if isinstance(grid, WavelengthGrid) else grid)

    def count_values(self) -> int:
        """Return the number of values of a quantity at one point of a grid."""
        if self.kind == "lens":
            return len(self.screen_depth_m or ()) * (self.rays or DEFAULT_RAYS)
        if self.kind == "surface_map":
            return DEFAULT_POINTS**2
        n_values = 1
        if self.kind == "beam_spread":
            n_values = len(SIDES) * N_MAP_PIXELS**2
        elif self.estimator == "bins":
            n_values = math.prod(self.n_bins or DEFAULT_N_BINS)
        elif self.kind == "goniophotometer":
            n_values = len(self.polar_deg or POLAR_DEG) * len(self.azimuth_deg or AZIMUTH_DEG)
        return n_values * self.get_wavelengths().size
