"""Section `instrument` of an experiment file: what all instruments have in common."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from splits.core.validation import check_choice, invalid
from splits.experiments.config.grid import make_even_spacing
from splits.experiments.config.sections import FiniteSection
from splits.instruments.snow_packs import SUN
from splits.media.kinds import INFINITE_DEPTH_HINT
from splits.media.medium import Medium
from splits.simulation.run_options import check_incidence, check_wavelengths

USE_GRID_HINT = "several values belong under grid"
MAX_STDERR = 0.5
"""Largest target error of a simulation."""


class WavelengthGrid(FiniteSection):
    """Equidistant wavelengths in nm, both ends included, and additional single ones."""

    start: float
    """first wavelength (nm)"""
    stop: float
    """last wavelength (nm)"""
    step: float = Field(gt=0)
    """distance between wavelengths (nm)"""
    also: tuple[float, ...] = ()
    """additional wavelengths (nm)"""

    def to_array(self) -> np.ndarray:
        """Return the wavelengths (nm), increasing."""
        steps = make_even_spacing("wavelength_nm", self.start, self.stop, self.step)
        return np.unique(np.concatenate([steps, self.also]))


def _check_incidence(value: Any) -> float | str:
    if isinstance(value, list | tuple):
        raise invalid("", value, "one angle or diffuse", USE_GRID_HINT)
    return value if value == SUN else check_incidence(value)


BeamAngle = Annotated[float, Field(ge=0.0, le=89.9999)]
Rays = Annotated[
    int | None, Field(ge=1, lt=2**63, description="number of rays, instead of a target error")
]
Seed = Annotated[
    int | None,
    Field(ge=0, lt=2**63, description="seed of this experiment; by default that of the main file"),
]


class Instrument(FiniteSection):
    """A virtual instrument."""

    FIGURES: ClassVar[tuple[str, ...]]
    """Kinds of its figures, the default first."""
    QUANTITIES: ClassVar[tuple[str, ...]] = ()
    """Quantities that its figures may show."""
    N_POSITIONS: ClassVar[int] = 1
    """Number of directions or positions for each wavelength."""
    MEASURES_SURFACE: ClassVar[bool] = False
    """Whether it measures a rough surface only."""
    MEASURES_BEAM: ClassVar[bool] = False
    """Whether its light is a beam."""
    ALLOWS_SEMI_INFINITE: ClassVar[bool] = False
    """Whether it simulates semi-infinite media."""

    kind: str

    def get_wavelengths(self) -> np.ndarray:
        """Return the wavelengths (nm); an arbitrary one if they have no effect."""
        return np.array([550.0])

    def get_incidence(self) -> float | str:
        """Return the incidence angle (°) or "diffuse"."""
        incidence: float | str = getattr(self, "incidence_deg", 0.0)
        return incidence

    def get_seed(self, default: int) -> int:
        """Return the seed of the experiment, by default that of the main file."""
        seed: int | None = getattr(self, "seed", None)
        return default if seed is None else seed

    def select_point(self, position: int) -> Self:
        """Return the instrument at a point of a grid, with the target error of this point."""
        scales = getattr(self, "point_stderr_scale", None)
        if scales is None:
            return self
        scale = scales[position] * getattr(self, "stderr_scale", 1.0)
        return self.model_copy(update={"stderr_scale": scale, "point_stderr_scale": None})

    def scale_stderr(self, stderr: float) -> float:
        """Return the target error of the experiment for that of the accuracy."""
        return min(getattr(self, "stderr_scale", 1.0) * stderr, MAX_STDERR)

    @property
    def takes_beam_only(self) -> bool:
        """Whether its light is a beam."""
        return self.MEASURES_BEAM

    def count_values(self) -> int:
        """Return the number of values of a quantity at one point of a grid."""
        return self.N_POSITIONS * self.get_wavelengths().size

    def list_arguments(self) -> dict[str, Any]:
        """Return the keyword arguments of the instrument's function that no other one has."""
        shared = {"kind", "wavelength_nm", "incidence_deg", "seed"}
        errors = {"stderr_scale", "point_stderr_scale"}
        return self.model_dump(exclude=shared | errors, exclude_none=True)

    def check_medium(self, medium: Medium) -> None:
        """Reject a medium that the instrument or its estimator cannot measure."""
        is_semi_infinite = medium.is_semi_infinite and medium.lowest_layer.has_grains
        is_analog = getattr(self, "estimator", None) == "analog"
        if is_semi_infinite and (is_analog or not self.ALLOWS_SEMI_INFINITE):
            raise invalid("medium.depth_m", math.inf, "finite", INFINITE_DEPTH_HINT)

    def check_figure(self, kind: str, quantities: Iterable[str]) -> None:
        """Reject a kind of figure, or given quantities, that the instrument does not have."""
        if kind != "none" and kind not in self.FIGURES:
            allowed = f"one of {', '.join(self.FIGURES)} for instrument.kind = {self.kind!r}"
            raise invalid("figure.kind", kind, allowed)
        for quantity in quantities:
            check_choice("figure.quantity", quantity, self.QUANTITIES)


class SpectralInstrument(Instrument):
    """An instrument with wavelengths."""

    wavelength_nm: WavelengthGrid | tuple[float, ...] = WavelengthGrid(
        start=400, stop=2500, step=10
    )
    """vacuum wavelengths (nm), increasing, by default 400 to 2500 in steps of 10; required for
    particle layers"""

    @model_validator(mode="after")
    def _check_wavelengths(self) -> SpectralInstrument:
        self.get_wavelengths()
        return self

    def get_wavelengths(self) -> np.ndarray:
        """Return the wavelengths (nm)."""
        grid = self.wavelength_nm
        return check_wavelengths(grid.to_array() if isinstance(grid, WavelengthGrid) else grid)


class OpticalInstrument(SpectralInstrument):
    """An instrument that traces light to a target error."""

    incidence_deg: Annotated[
        float | str,
        BeforeValidator(
            _check_incidence, json_schema_input_type=BeamAngle | Literal["diffuse", "sun"]
        ),
    ] = 0.0
    """incidence angle of the beam (°), from 0 to 89.9999, or `diffuse`; for snowpacks of a file
    also `sun`, the zenith angle of each"""
    stderr_scale: float = Field(1.0, ge=0.01, le=100.0)
    """factor of the target error of the accuracy; not with `rays` or bins"""
    point_stderr_scale: tuple[Annotated[float, Field(ge=0.01, le=100.0)], ...] | None = None
    """further factors of the target error, one for each point of the grid, of which the last
    parameter varies fastest; not for tables"""
    seed: Seed = None

    @model_validator(mode="after")
    def _check_stderr_scale(self) -> OpticalInstrument:
        uses_bins = getattr(self, "estimator", None) == "bins"
        has_rays = getattr(self, "rays", None) is not None
        for key, default in (("stderr_scale", 1.0), ("point_stderr_scale", None)):
            if (has_rays or uses_bins) and getattr(self, key) != default:
                allowed = f"left out with {'rays' if has_rays else 'bins'}"
                hint = "the number of rays is fixed there, not the error"
                raise invalid(key, getattr(self, key), allowed, hint)
        return self
