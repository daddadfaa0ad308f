"""Section `instrument` of an experiment file: models of all kinds of instruments.

The functions of the instruments check their arguments and the medium.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    AllowInfNan,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    model_validator,
)

from splits.core.inputs import (
    check_azimuths,
    check_incidence,
    check_polar_angles,
    check_wavelengths,
)
from splits.core.validation import check_choice, invalid
from splits.experiments.config.media import expand_spacing, make_even_spacing
from splits.experiments.config.sections import (
    NO_SWITCH,
    FiniteSection,
    Number,
    Whole,
    check_different,
)
from splits.illumination.bands import as_bands
from splits.illumination.sky import CLEAR_SKY, list_sky_names, sky
from splits.instruments.rough_surfaces import (
    DEFAULT_RAYS,
    MAX_REALIZATIONS,
    check_ring_radius,
    check_screen_depths,
)
from splits.instruments.sky_mixing import choose_wavelengths
from splits.instruments.snow_packs import SUN
from splits.instruments.solver import choose_solver
from splits.instruments.spectrophotometer import find_path_obstacle
from splits.media.medium import Medium
from splits.simulation.run_options import check_n_bins
from splits.simulation.scene import ALLOWED_STOKES
from splits.tables.axes import VIEW_AXES, ParameterGrid, ViewGrid, check_quantities
from splits.tables.plan import choose_table_solver

USE_GRID_HINT = "several values belong under grid"
MAX_STDERR = 0.5
"""Largest target error of a simulation."""
SKIES = (CLEAR_SKY, *list_sky_names())


class WavelengthGrid(FiniteSection):
    """Equidistant wavelengths in nm, both ends included, and additional single ones."""

    start: Number
    """first wavelength (nm)"""
    stop: Number
    """last wavelength (nm)"""
    step: Number = Field(gt=0)
    """distance between wavelengths (nm)"""
    also: tuple[Number, ...] = ()
    """additional wavelengths (nm)"""

    def to_array(self) -> np.ndarray:
        """Return the wavelengths (nm), increasing."""
        steps = make_even_spacing("wavelength_nm", self.start, self.stop, self.step)
        return np.unique(np.concatenate([steps, self.also]))


class PulseSection(FiniteSection):
    """Power of a pulse over time."""

    delay_s: tuple[Number, ...]
    """delays (s), increasing"""
    power: tuple[Number, ...]
    """power at each delay, in any unit"""


def dump_pulse(pulse: float | PulseSection | None) -> Any:
    """Return the argument `pulse` of `splits.time_of_flight`."""
    return pulse.model_dump() if isinstance(pulse, PulseSection) else pulse


def _check_incidence(value: Any) -> float | str:
    if isinstance(value, list | tuple):
        raise invalid("", value, "one angle or diffuse", USE_GRID_HINT)
    return value if value == SUN else check_incidence("incidence_deg", value)


def _check_stokes(value: Any) -> Any:
    """Return a setting of `stokes` if it has the type of one."""
    is_number = isinstance(value, list | tuple) and all(
        isinstance(one, int | float) and not isinstance(one, bool) for one in value
    )
    if not isinstance(value, bool) and not (is_number and len(value) == 4):
        raise invalid("", value, ALLOWED_STOKES)
    return value


def _check_bands(bands: Any) -> Any:
    as_bands(bands)
    return bands


def _expand_delays(value: Any) -> Any:
    return expand_spacing("delay_s", value) if isinstance(value, Mapping) else value


BeamAngle = Annotated[Number, Field(ge=0.0, le=89.9999)]
ErrorScale = Annotated[Number, Field(ge=0.01, le=100.0)]
Rays = Annotated[
    Annotated[int, Field(ge=1, lt=2**63), NO_SWITCH] | None,
    Field(description="number of rays, instead of a target error"),
]
Seed = Annotated[
    Annotated[int, Field(ge=0, lt=2**63), NO_SWITCH] | None,
    Field(description="seed of this experiment; by default that of the main file"),
]
PolarAngles = Annotated[
    tuple[Number, ...],
    AfterValidator(lambda x: tuple(check_polar_angles("", x).tolist())),
]
Azimuths = Annotated[
    tuple[Number, ...],
    AfterValidator(lambda x: tuple(check_azimuths("", x).tolist())),
]
Delays = Annotated[
    tuple[Number, ...],
    BeforeValidator(_expand_delays, json_schema_input_type=tuple[float, ...] | dict[str, Any]),
]
"""Delays (s) as a list, or as `{start, stop, step}`."""
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
IncidentStokes = Annotated[
    bool | tuple[Number, Number, Number, Number],
    BeforeValidator(_check_stokes),
    Field(
        description="whether polarization is traced (directions: with `bins` or `next_event`), or "
        "the Stokes vector (I, Q, U, V) of the incident light; layers of particles need "
        "`polarized: true`"
    ),
]


class Instrument(FiniteSection):
    """A virtual instrument."""

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

    def get_views(self) -> dict[str, tuple[float, ...]]:
        """Return the axes of directions that a table has besides those of the grid."""
        return {}

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

    def list_arguments(self) -> dict[str, Any]:
        """Return the keyword arguments of the instrument's function that no other one has."""
        shared = {"kind", "wavelength_nm", "incidence_deg", "seed"}
        errors = {"stderr_scale", "point_stderr_scale"}
        return self.model_dump(exclude=shared | errors, exclude_none=True)

    def check_grid(self, grid: Mapping[str, Mapping[str, Any]], *, is_single: bool) -> None:
        """Reject a grid that the instrument does not allow.

        `is_single` is whether each point is simulated alone.
        """
        if "incidence_deg" in grid and "incidence_deg" not in type(self).model_fields:
            given, allowed = [*grid["incidence_deg"].values()], f"left out for {self.kind}"
            raise invalid("grid.incidence_deg", given, allowed)
        beam = self.get_incidence()
        if "incidence_deg" in grid and beam != 0.0:
            allowed = "left out, because grid.incidence_deg sets it"
            raise invalid("instrument.incidence_deg", beam, allowed)
        scales, n_points = (
            getattr(self, "point_stderr_scale", None),
            math.prod(map(len, grid.values())),
        )
        if scales is not None and (len(scales) != n_points or not is_single):
            allowed = f"{n_points} numbers, one for each point of the grid"
            allowed = allowed if is_single else "left out for tables, fits and snowpacks"
            raise invalid("instrument.point_stderr_scale", list(scales), allowed)


class SpectralInstrument(Instrument):
    """An instrument with wavelengths."""

    wavelength_nm: WavelengthGrid | tuple[Number, ...] = WavelengthGrid(
        start=400, stop=2500, step=10
    )
    """vacuum wavelengths (nm), increasing, by default 400 to 2500 in steps of 10"""

    @model_validator(mode="after")
    def _check_wavelengths(self) -> SpectralInstrument:
        self.get_wavelengths()
        return self

    def get_wavelengths(self) -> np.ndarray:
        """Return the wavelengths (nm)."""
        grid = self.wavelength_nm
        return check_wavelengths(
            "wavelength_nm", grid.to_array() if isinstance(grid, WavelengthGrid) else grid
        )


class OpticalInstrument(SpectralInstrument):
    """An instrument that traces light to a target error."""

    incidence_deg: Annotated[
        Number | str,
        BeforeValidator(
            _check_incidence, json_schema_input_type=BeamAngle | Literal["diffuse", "sun"]
        ),
    ] = 0.0
    """incidence angle of the beam (°), from 0 to 89.9999, or `diffuse`; for snowpacks of a file
    also `sun`, the zenith angle of each"""
    stderr_scale: ErrorScale = 1.0
    """factor of the target error of the accuracy; not with `rays` or bins"""
    point_stderr_scale: tuple[ErrorScale, ...] | None = None
    """further factors of the target error, one for each point of the grid, of which the last
    parameter varies fastest; not for tables"""
    seed: Seed = None

    @model_validator(mode="after")
    def _check_stderr_scale(self) -> OpticalInstrument:
        has_rays = getattr(self, "rays", None) is not None
        for key, default in (("stderr_scale", 1.0), ("point_stderr_scale", None)):
            fixed = has_rays or getattr(self, "estimator", None) == "bins"
            if fixed and getattr(self, key) != default:
                allowed = f"left out with {'rays' if has_rays else 'bins'}"
                hint = "the number of rays is fixed there, not the error"
                raise invalid(key, getattr(self, key), allowed, hint)
        return self


class Refractometer(SpectralInstrument):
    """Refractive indices of the materials of a medium."""

    kind: Literal["refractive_index"]

    def check_grid(self, grid: Mapping[str, Mapping[str, Any]], *, is_single: bool) -> None:
        """Reject a grid of several points."""
        if varied := {key: list(given) for key, given in grid.items() if len(given) > 1}:
            raise invalid("grid", varied, "of one value for refractive_index")


class Spectrophotometer(OpticalInstrument):
    """Hemispherical reflectance and transmittance."""

    kind: Literal["spectrophotometer"] = "spectrophotometer"
    solver: Solver = "auto"
    estimator: Literal["spectral", "analog"] = "spectral"
    """how exiting rays become results"""
    stokes: IncidentStokes = False

    def choose_solver(self, medium: Medium, max_stderr: float = math.inf) -> str:
        """Return the solver for a medium, see `splits.instruments.solver.choose_solver`."""
        obstacle = find_path_obstacle(self.estimator, self.stokes)
        wavelengths = self.get_wavelengths()
        return choose_solver(self.solver, [medium], wavelengths, obstacle, max_stderr=max_stderr)


class Albedo(SpectralInstrument):
    """Albedo of the snowpacks of a file under skies, for their zenith angles of the sun."""

    kind: Literal["albedo"]
    wavelength_nm: WavelengthGrid | tuple[Number, ...] = WavelengthGrid(
        start=300, stop=2490, step=10
    )
    """vacuum wavelengths (nm), increasing, by default those of `splits.albedo`: from the first of
    the sky, 300 or 305, in steps of 10 to at most 2495"""
    sky: Annotated[str, AfterValidator(lambda x: check_choice("", x, SKIES))] = CLEAR_SKY
    """sky, see `splits.sky`: `clear`, or one of the skies of SNICAR"""
    bands: Annotated[
        dict[str, tuple[Number, Number]] | str | None, AfterValidator(_check_bands)
    ] = None
    """limits of bands (nm) by name, or the name of a sensor; the broadband albedo is always
    computed"""

    @model_validator(mode="after")
    def _choose_wavelengths(self) -> Albedo:
        if "wavelength_nm" not in self.model_fields_set and self.sky != CLEAR_SKY:
            wavelengths = choose_wavelengths(None, sky(self.sky), 2)
            self.__dict__["wavelength_nm"] = tuple(wavelengths.tolist())
        return self


class Goniophotometer(OpticalInstrument):
    """BRDF and BTDF by direction."""

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
    n_bins: Annotated[tuple[Whole, Whole], AfterValidator(check_n_bins)] | None = None
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


class BeamSpread(OpticalInstrument):
    """Map of the light around a narrow beam."""

    kind: Literal["beam_spread"]
    rays: Rays = None
    half_width_m: Number | None = None
    """half the side length of the map (m), by default from the spread; required with a grid"""

    def check_grid(self, grid: Mapping[str, Mapping[str, Any]], *, is_single: bool) -> None:
        """Reject a grid of maps whose axes would differ."""
        super().check_grid(grid, is_single=is_single)
        if grid and self.half_width_m is None:
            allowed, hint = "given where there is a grid", "all maps have the same axes"
            raise invalid("instrument.half_width_m", None, allowed, hint)


class DelayInstrument(OpticalInstrument):
    """An instrument that records delays of light."""

    rays: Rays = None
    delay_s: Delays | None = None
    """edges of the bins of delay (s), increasing, also as `{start, stop, step}`; by default 0 and
    ten per decade from 1e-12 to 1e-7"""
    acceptance_deg: Number | None = None
    """largest angle between received light and the direction to the source (°), by default all
    light is received at the surface"""
    footprint_radius_m: Number | None = None
    """radius of the field of view on the surface (m)"""


class TimeOfFlight(DelayInstrument):
    """Return of a pulse over time."""

    kind: Literal["time_of_flight"]
    end_s: Annotated[Number, AllowInfNan(True)] | None = None
    """delay until which light counts in moments (s), by default the last of `delay_s`"""
    pulse: Number | PulseSection | None = None
    """full width at half maximum of a Gaussian pulse (s), or its power over time; by default, the
    pulse is instantaneous"""
    depths_m: tuple[Number, ...] | None = None
    """depths that divide the light by the largest depth reached (m), increasing"""


class ReturnTable(DelayInstrument):
    """Table of returns of an instantaneous pulse over a grid, for retrieval."""

    kind: Literal["return_table"]


class SurfaceMap(Instrument):
    """Heights of a rough surface."""

    kind: Literal["surface_map"]
    seed: Seed = None
    half_width_m: Number
    """half the side length of the map (m)"""
    realizations: Whole = Field(100, ge=2, le=MAX_REALIZATIONS)
    """number of realizations of the surface"""


class Lens(Instrument):
    """Images of a ring of rays through a rough surface."""

    kind: Literal["lens"]
    seed: Seed = None
    radius_m: Annotated[Number, AfterValidator(check_ring_radius)]
    """radius of the ring of rays (m)"""
    screen_depth_m: Annotated[
        tuple[Number, ...], AfterValidator(lambda x: tuple(check_screen_depths("", x).tolist()))
    ]
    """depths of the screens (m), increasing"""
    centre_on: Literal["crest", "trough", "origin"] = "crest"
    """point of the surface above which the ring is centred"""
    half_width_m: Number | None = None
    """half the side length of the square in which the crest is searched (m); required, except over
    the origin"""
    rays: Whole = Field(DEFAULT_RAYS, ge=1)
    """number of rays in the ring"""
    realizations: Whole = Field(1, ge=1)
    """number of realizations of the surface"""


class TableInstrument(OpticalInstrument):
    """Table of spectra over a grid, for interpolation and retrieval."""

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
    parts: Whole = Field(8, ge=1, le=10_000)
    """number of parts of the table, each simulated by one job"""

    @model_validator(mode="after")
    def _check_views(self) -> TableInstrument:
        axes = self.get_views()
        views = ViewGrid.from_grid(ParameterGrid(tuple(axes), tuple(axes.values())), "")
        quantities = check_quantities(self.quantities, views, self.covariance == "keep")
        self.__dict__["quantities"] = quantities
        return self

    def get_views(self) -> dict[str, tuple[float, ...]]:
        """Return the axes of the directions of observation, empty without them."""
        axes = {name: getattr(self, name) for name in VIEW_AXES}
        return {name: angles for name, angles in axes.items() if angles is not None}

    def choose_solver(self, media: Iterable[Medium], max_stderr: float = math.inf) -> str:
        """Return the solver for all media, see `splits.tables.plan.choose_table_solver`."""
        has_covariance = self.covariance == "keep"
        return choose_table_solver(
            self.solver, media, self.get_wavelengths(), has_covariance, max_stderr,
            has_views=self.polar_deg is not None,
        )  # fmt: skip


def _get_kind(content: Any) -> Any:
    """Return the kind of an instrument, by default a spectrophotometer."""
    if isinstance(content, dict):
        return content.get("kind", "spectrophotometer")
    # A kind in place of the section is reported as such.
    return content if isinstance(content, str) else getattr(content, "kind", None)


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
    Discriminator(_get_kind),
]
"""An instrument of any kind, which the key `kind` determines."""
INSTRUMENT_KINDS: dict[str, type[Instrument]] = {
    get_args(part)[1].tag: get_args(part)[0] for part in get_args(get_args(AnyInstrument)[0])
}
"""Model of each kind of instrument."""
