"""Models of all kinds of instruments."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from splits.core.validation import check_choice, invalid, key_prefix
from splits.experiments.config.albedo_instrument import Albedo
from splits.experiments.config.beam_instruments import BeamSpread, ReturnTable, TimeOfFlight
from splits.experiments.config.instrument import (
    Instrument,
    OpticalInstrument,
    Rays,
    SpectralInstrument,
)
from splits.experiments.config.sections import check_different
from splits.experiments.config.surface_instruments import Lens, SurfaceMap
from splits.instruments.angular_bins import DEFAULT_N_BINS
from splits.instruments.angular_solver import find_angular_obstacle
from splits.instruments.goniophotometer import (
    AZIMUTH_DEG,
    POLAR_DEG,
    check_polarized_estimator,
)
from splits.instruments.next_event import get_detected_layers
from splits.instruments.solver import MONTE_CARLO, choose_solver
from splits.instruments.spectrophotometer import find_path_obstacle
from splits.media.medium import Medium
from splits.plotting.panels import (
    MAX_AZIMUTH_GAP_DEG,
    MIN_AZIMUTHS,
    MIN_POLAR_ANGLES,
    can_map_hemisphere,
)
from splits.simulation.arguments import check_direction_angles, check_n_bins
from splits.simulation.incident_light import ALLOWED_STOKES, check_stokes
from splits.tables.axes import VIEW_AXES, ParameterGrid, ViewGrid, check_quantities
from splits.tables.plan import choose_table_solver

Angles = tuple[float, ...]
PolarAngles = Annotated[
    Angles, AfterValidator(lambda x: tuple(check_direction_angles("", x, 90.0).tolist()))
]
Azimuths = Annotated[
    Angles, AfterValidator(lambda x: tuple(check_direction_angles("", x, 360.0).tolist()))
]
TableQuantity = Literal[
    "reflectance", "transmittance", "reflectance_factor", "anisotropy_factor",
    "diffuse_reflectance", "diffuse_reflectance_factor", "diffuse_anisotropy_factor",
]  # fmt: skip
Solver = Annotated[
    Literal["monte_carlo", "discrete_ordinates", "auto"],
    Field(
        description="paths, or the equation of radiative transfer in plane layers of grains; "
        "`auto` solves it for natural snow where it is accurate enough, and traces paths otherwise"
    ),
]


def _check_stokes_setting(value: Any) -> Any:
    """Return a setting of `stokes` if it has the type of one."""
    is_number = isinstance(value, list | tuple) and all(
        isinstance(one, int | float) and not isinstance(one, bool) for one in value
    )
    if not isinstance(value, bool) and not (is_number and len(value) == 4):
        raise invalid("", value, ALLOWED_STOKES)
    return value


IncidentStokes = Annotated[
    bool | tuple[float, float, float, float],
    BeforeValidator(_check_stokes_setting),
    Field(
        description="whether polarization is traced (directions: with `bins` or `next_event`), or "
        "the Stokes vector (I, Q, U, V) of the incident light; layers of particles need "
        "`polarized: true`"
    ),
]


class Refractometer(SpectralInstrument):
    """Refractive indices of the materials of a medium."""

    FIGURES: ClassVar = ("refractive_index",)
    ALLOWS_SEMI_INFINITE: ClassVar = True

    kind: Literal["refractive_index"]


class Spectrophotometer(OpticalInstrument):
    """Hemispherical reflectance and transmittance."""

    FIGURES: ClassVar = ("spectra", "points", "swatches", "fit", "season")
    QUANTITIES: ClassVar = ("reflectance", "transmittance", "absorptance", "mean_grain_distance")
    ALLOWS_SEMI_INFINITE: ClassVar = True

    kind: Literal["spectrophotometer"] = "spectrophotometer"
    solver: Solver = "auto"
    estimator: Literal["spectral", "analog"] = "spectral"
    """how exiting rays become results"""
    stokes: IncidentStokes = False

    def check_medium(self, medium: Medium) -> None:
        """Reject a medium that the estimator or the solver does not allow."""
        super().check_medium(medium)
        self.choose_solver(medium)
        with key_prefix("instrument"):
            check_stokes(self.stokes, medium, self.get_incidence())

    def choose_solver(self, medium: Medium, max_stderr: float = math.inf) -> str:
        """Return the solver for a medium, see `splits.instruments.solver.choose_solver`."""
        obstacle = find_path_obstacle(self.estimator, self.stokes)
        wavelengths = self.get_wavelengths()
        with key_prefix("instrument"):
            return choose_solver(
                self.solver, [medium], wavelengths, obstacle, max_stderr=max_stderr
            )


class Goniophotometer(OpticalInstrument):
    """BRDF and BTDF by direction."""

    FIGURES: ClassVar = ("principal_plane", "hemisphere", "lobes", "bins", "polarization")
    QUANTITIES: ClassVar = ("brdf", "btdf", "reflectance_factor", "anisotropy_factor", "brdf_dolp")
    MEASURES_BEAM: ClassVar = True

    kind: Literal["goniophotometer"]
    solver: Solver = "auto"
    estimator: Literal["expansion", "bins", "next_event"] = "expansion"
    """how exiting rays become results"""
    stokes: IncidentStokes = False
    rays: Rays = None
    target: Literal["brdf", "btdf"] = "brdf"
    """quantity to which the target error applies"""
    polar_deg: PolarAngles | None = None
    """polar angles from the normal (°); by default 0 to 87.5 in steps of 2.5"""
    azimuth_deg: Azimuths | None = None
    """azimuths from the direction in which the beam travels (°), 0 is forward; by default 0 to 355
    in steps of 5"""
    n_bins: Annotated[tuple[int, int], AfterValidator(check_n_bins)] | None = None
    """numbers of angular bins from the horizon to the zenith, and in azimuth; by default `[18, 72]`
    """

    @model_validator(mode="after")
    def _check_estimator(self) -> Goniophotometer:
        uses_bins = self.estimator == "bins"
        for key in ("polar_deg", "azimuth_deg") if uses_bins else ():
            if getattr(self, key) is not None:
                raise invalid(key, getattr(self, key), "left out with bins")
        if self.n_bins is not None and not uses_bins:
            raise invalid("n_bins", self.n_bins, "left out without estimator = bins")
        return self

    def count_values(self) -> int:
        """Return the number of values of a quantity at one point of a grid."""
        n_directions = len(self.polar_deg or POLAR_DEG) * len(self.azimuth_deg or AZIMUTH_DEG)
        if self.estimator == "bins":
            n_directions = math.prod(self.n_bins or DEFAULT_N_BINS)
        return n_directions * self.get_wavelengths().size

    def check_medium(self, medium: Medium) -> None:
        """Reject a medium that the estimator, the target or the solver does not allow."""
        if self.choose_solver(medium) == MONTE_CARLO:
            super().check_medium(medium)
        if self.estimator == "next_event":
            with key_prefix("instrument"):
                get_detected_layers(medium)
        if self.target == "btdf" and medium.reflecting_ground is not None:
            raise invalid("instrument.target", "btdf", "brdf over a ground")
        with key_prefix("instrument"):
            check_polarized_estimator(self.stokes, self.estimator, medium)
            check_stokes(self.stokes, medium, self.get_incidence())

    def choose_solver(self, medium: Medium) -> str:
        """Return the solver for a medium, see `splits.instruments.solver.choose_solver`."""
        obstacle = find_angular_obstacle(medium, self.estimator, self.rays)
        with key_prefix("instrument"):
            return choose_solver(self.solver, [medium], self.get_wavelengths(), obstacle)

    def check_figure(self, kind: str, quantities: Iterable[str]) -> None:
        """Reject a figure of quantities or directions that the instrument does not measure."""
        super().check_figure(kind, quantities)
        if kind == "none":
            return
        if kind == "hemisphere":
            self._check_hemisphere()
        hint = "figures show the principal plane"
        if self.azimuth_deg is not None and not {0.0, 180.0} <= set(self.azimuth_deg):
            raise invalid("instrument.azimuth_deg", self.azimuth_deg, "with 0 and 180", hint)
        if self.n_bins is not None and self.n_bins[1] % 2:
            raise invalid("instrument.n_bins", self.n_bins, "an even number around", hint)
        if kind == "bins" and self.estimator != "bins":
            raise invalid("instrument.estimator", self.estimator, "bins for figure.kind = 'bins'")
        if (kind == "polarization" or "brdf_dolp" in quantities) and self.estimator == "expansion":
            allowed = "next_event or bins for a figure of polarization"
            raise invalid("instrument.estimator", self.estimator, allowed)

    def _check_hemisphere(self) -> None:
        """Reject a hemisphere map of directions that do not cover all azimuths."""
        polar, azimuth = self.polar_deg or POLAR_DEG, self.azimuth_deg or AZIMUTH_DEG
        key = "azimuth_deg" if self.azimuth_deg is not None else "polar_deg"
        if self.n_bins is not None:
            key, (rows, columns) = "n_bins", self.n_bins
            polar = tuple(np.linspace(0.0, 90.0, rows))
            azimuth = tuple(np.linspace(0.0, 360.0, columns, endpoint=False))
        if not can_map_hemisphere(np.asarray(polar), np.asarray(azimuth)):
            raise invalid(
                f"instrument.{key}", getattr(self, key),
                f"at least {MIN_POLAR_ANGLES} polar angles and {MIN_AZIMUTHS} azimuths at most "
                f"{MAX_AZIMUTH_GAP_DEG:g} degrees apart, all around, for figure.kind = "
                "'hemisphere'",
            )  # fmt: skip


class TableInstrument(OpticalInstrument):
    """Table of spectra over a grid, for interpolation and retrieval."""

    FIGURES: ClassVar = ("summary",)
    QUANTITIES: ClassVar = get_args(TableQuantity)
    ALLOWS_SEMI_INFINITE: ClassVar = True

    kind: Literal["table"]
    polar_deg: PolarAngles | None = None
    """directions of observation: polar angles from the normal (°)"""
    azimuth_deg: Azimuths | None = None
    """directions of observation: azimuths from the direction in which the beam travels (°), 0 to
    180"""
    quantities: Annotated[tuple[TableQuantity, ...], AfterValidator(check_different)] | None = None
    """quantities in the table: by default `reflectance`, with directions also `reflectance_factor`
    and `anisotropy_factor`"""
    covariance: Literal["keep", "leave_out"] = "leave_out"
    """whether the table contains the contributions of batches of rays to the errors"""
    solver: Solver = "auto"
    parts: int = Field(8, ge=1, le=10_000)
    """number of parts of the table, each simulated by one job"""

    @model_validator(mode="after")
    def _check_views(self) -> TableInstrument:
        covariance = self.covariance == "keep"
        axes = self.get_views()
        grid = ParameterGrid(tuple(axes), tuple(axes.values()))
        views = ViewGrid.from_grid(grid, "")
        self.__dict__["quantities"] = check_quantities(self.quantities, views, covariance)
        return self

    def get_views(self) -> dict[str, tuple[float, ...]]:
        """Return the axes of the directions of observation, empty without them."""
        axes = {name: getattr(self, name) for name in VIEW_AXES}
        return {name: angles for name, angles in axes.items() if angles is not None}

    def check_medium(self, medium: Medium) -> None:
        """Reject a medium that the solver does not allow."""
        super().check_medium(medium)
        self.choose_solver([medium])

    def choose_solver(self, media: Iterable[Medium], max_stderr: float = math.inf) -> str:
        """Return the solver for all media, see `splits.tables.plan.choose_table_solver`."""
        has_covariance = self.covariance == "keep"
        with key_prefix("instrument"):
            return choose_table_solver(
                self.solver, media, self.get_wavelengths(), has_covariance, max_stderr,
                has_views=self.polar_deg is not None,
            )  # fmt: skip

    def check_figure(self, kind: str, quantities: Iterable[str]) -> None:
        """Reject a figure of quantities that are not in the table."""
        super().check_figure(kind, quantities)
        for quantity in quantities if kind != "none" else ():
            check_choice("figure.quantity", quantity, self.quantities or ())


def get_instrument_kind(content: Any) -> Any:
    """Return the kind of an instrument, by default a spectrophotometer."""
    if isinstance(content, dict):
        return content.get("kind", "spectrophotometer")
    return getattr(content, "kind", None)


AnyInstrument = Annotated[
    Annotated[Spectrophotometer, Tag("spectrophotometer")]
    | Annotated[Albedo, Tag("albedo")]
    | Annotated[Goniophotometer, Tag("goniophotometer")]
    | Annotated[BeamSpread, Tag("beam_spread")]
    | Annotated[TimeOfFlight, Tag("time_of_flight")]
    | Annotated[Refractometer, Tag("refractive_index")]
    | Annotated[SurfaceMap, Tag("surface_map")]
    | Annotated[Lens, Tag("lens")]
    | Annotated[TableInstrument, Tag("table")]
    | Annotated[ReturnTable, Tag("return_table")],
    Discriminator(get_instrument_kind),
]
"""An instrument of any kind, which the key `kind` determines."""
INSTRUMENT_KINDS: dict[str, type[Instrument]] = {
    get_args(part)[1].tag: get_args(part)[0] for part in get_args(get_args(AnyInstrument)[0])
}
"""Model of each kind of instrument."""
