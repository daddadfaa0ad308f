"""Section `instrument` of an experiment file: the keywords of a function, as it declares them.

The kind of the section is the name of an instrument of the package, or of a function of this
module.  Functions check the medium, and what several inputs have to do with each other, when they
are called.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from inspect import Parameter
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from pydantic import TypeAdapter

from splits.core.declarations import Input, Quantity, find_quantity, list_inputs
from splits.core.discovery import load_instruments
from splits.core.inputs import (
    MAX_STDERR,
    Azimuths,
    Incidence,
    PolarAngles,
    RayCount,
    Rays,
    Seed,
    Solver,
    Threads,
    Wavelengths,
    check_wavelengths,
)
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.validation import (
    MAX_INT64,
    InvalidValue,
    check_choice,
    check_relations,
    invalid,
    key_prefix,
    unknown_key,
)
from splits.illumination.sky import ASTM_G173, CLEAR_SKY, list_sky_names, sky
from splits.instruments.delay_record import (
    DEFAULT_EDGES_S,
    AcceptanceAngle,
    DelayEdges,
    FootprintRadius,
)
from splits.instruments.goniophotometer import check_bins
from splits.instruments.sky_mixing import choose_wavelengths
from splits.instruments.solver import choose_solver
from splits.instruments.spectrophotometer import find_path_obstacle
from splits.media.medium import Medium
from splits.simulation.run_options import make_wavelength_coordinate
from splits.tables.axes import (
    ALL_QUANTITIES,
    VIEW_AXES,
    ParameterGrid,
    check_quantities,
    read_views,
)
from splits.tables.blocks import choose_table_solver
from splits.tables.build import build_table

USE_GRID_HINT = "several values belong under grid"
DEFAULT_KIND = "spectrophotometer"
DEFAULT_WAVELENGTHS = {"start": 400, "stop": 2500, "step": 10}
"""Wavelengths (nm) of instruments that have none by default."""
SKIES = (*list_sky_names(), CLEAR_SKY, ASTM_G173)
"""Names of the skies of experiments."""
RUN_INPUTS = (
    "max_stderr", "relative_stderr", "max_rays", "threads", "kernel", "progress", "jacobian",
)  # fmt: skip
"""Inputs of instruments that the accuracy and the workflow give."""


# --------------------------------------------------------------------------------------------------
# Instruments of experiment files only.


@declare_function
def refractive_index(medium: Medium, wavelength_nm: Wavelengths) -> xr.Dataset:
    """Return the complex refractive indices of the materials of a medium."""
    wavelengths = np.asarray(wavelength_nm)
    index = medium.compute_refractive_indices(wavelengths)
    dims, units = ("wavelength", "material"), {"units": "1"}
    return xr.Dataset(
        {
            "n": (dims, index.real, {"long_name": "refractive index", **units}),
            "k": (dims, index.imag, {"long_name": "extinction coefficient", **units}),
        },
        {
            "wavelength": make_wavelength_coordinate(wavelengths),
            "material": ("material", list(medium.list_materials()), {"long_name": "material"}),
        },
        {f"{medium.kind}_{key}": value for key, value in medium.describe().items()},
    )


@declare_function
def return_table(
    medium: Medium,
    wavelength_nm: Wavelengths,
    incidence_deg: Incidence = 0.0,
    *,
    rays: RayCount = 100_000,
    delay_s: DelayEdges = DEFAULT_EDGES_S,
    acceptance_deg: AcceptanceAngle = None,
    footprint_radius_m: FootprintRadius = None,
    seed: Seed = 1,
    threads: Threads = None,
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Return the table of returns of an instantaneous pulse from one medium, for retrieval."""
    table = build_table(
        lambda point: medium, {"point": [0.0]}, wavelength_nm, incidence_deg, rays=rays, seed=seed,
        delay_s=delay_s, acceptance_deg=acceptance_deg, footprint_radius_m=footprint_radius_m,
        threads=threads, progress=progress,
    )  # fmt: skip
    return table.dataset.isel(point=0, drop=True)


TABLE = "table"
"""Kind of a table over the grid (`splits.build_table`), with these inputs."""
ErrorScale = Annotated[
    float, Quantity("factor of the target error of the accuracy", low=0.01, high=100.0)
]


PointErrorScales = Annotated[
    tuple[ErrorScale, ...] | None,
    Quantity(
        "further factors of the target error, one for each point of the grid, of which the last "
        "parameter varies fastest"
    ),
]
TableQuantities = Annotated[
    tuple[str, ...] | None,
    Quantity(
        "quantities in the table, by default reflectance, with directions also reflectance_factor "
        "and anisotropy_factor",
        check=lambda _, value: value,
        schema={"type": "array", "items": {"enum": list(ALL_QUANTITIES)}},
    ),
]
Covariance = Annotated[
    Literal["keep", "leave_out"],
    Quantity("whether the table contains the contributions of batches of rays to the errors"),
]
Parts = Annotated[
    int, Quantity("number of parts of the table, each simulated by one job", low=1, high=10_000)
]
SectionSeed = Annotated[
    int | None,
    Quantity("seed of the random numbers, by default that of the main file", low=0),
]
SectionSky = Annotated[
    str,
    Quantity(
        "sky, see `splits.sky`: clear, for snowpacks with the zenith angle of the sun, or another",
        check=lambda key, name: check_choice(key, name, SKIES),
        schema={"type": "string", "enum": [*SKIES]},
    ),
]  # fmt: skip
SECTION_TYPES = {"seed": (SectionSeed, None), "sky": (SectionSky, CLEAR_SKY)}
"""Types and defaults of inputs that differ from those of the functions."""
TABLE_TYPES: dict[str, tuple[Any, Any]] = {
    "wavelength_nm": (Wavelengths, Parameter.empty),
    "incidence_deg": (Incidence, 0.0),
    "polar_deg": (PolarAngles | None, None),
    "azimuth_deg": (Azimuths | None, None),
    "quantities": (TableQuantities, None),
    "covariance": (Covariance, "leave_out"),
    "solver": (Solver, "auto"),
    "seed": (SectionSeed, None),
    "parts": (Parts, 8),
}
"""Types and defaults of the inputs of a table."""
ERROR_TYPES: dict[str, tuple[Any, Any]] = {
    "stderr_scale": (ErrorScale, 1.0),
    "point_stderr_scale": (PointErrorScales, None),
}
"""Types and defaults of the inputs of instruments with a target error."""

FUNCTIONS: dict[str, Callable[..., xr.Dataset]] = {
    **load_instruments(), "return_table": return_table, "refractive_index": refractive_index,
}  # fmt: skip
"""Functions of the kinds that measure one medium after the other."""
KINDS = (*FUNCTIONS, TABLE)


@cache
def list_section_inputs(kind: str) -> dict[str, Input]:
    """Return the inputs of a section of a kind by key, apart from `kind`."""
    more = {**TABLE_TYPES, **ERROR_TYPES} if kind == TABLE else {}
    inputs = {} if kind == TABLE else dict(list_inputs(FUNCTIONS[kind]))
    if {"max_stderr", "relative_stderr", "rays"} & inputs.keys() and "incidence_deg" in inputs:
        more = ERROR_TYPES | ({"rays": (Rays, None)} if "rays" in inputs else {})
    more = more | {name: pair for name, pair in SECTION_TYPES.items() if name in inputs}
    for name, (hint, default) in more.items():
        quantity = find_quantity(hint)
        assert quantity is not None
        inputs[name] = Input(quantity, TypeAdapter(hint), default)
    wavelengths = inputs.get("wavelength_nm")
    if wavelengths and wavelengths.default is Parameter.empty:
        inputs["wavelength_nm"] = wavelengths._replace(default=DEFAULT_WAVELENGTHS)
    return {name: one for name, one in inputs.items() if name not in RUN_INPUTS}


@dataclass(frozen=True)
class Instrument:
    """Section `instrument`: the kind, and the settings of the file.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    settings : dict
        Settings as in the file, which are valid.
    """

    kind: str = DEFAULT_KIND
    settings: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_content(cls, content: Any) -> Instrument:
        """Return the section for its content, after checking each setting by its declaration."""
        if isinstance(content, cls):
            return content
        if not isinstance(content, Mapping):
            hint = f"write instrument: {{kind: {content}, …}}" if content in KINDS else ""
            raise invalid("instrument", content, "a mapping of keys to values", hint)
        kind = check_choice("instrument.kind", content.get("kind", DEFAULT_KIND), KINDS)
        settings = {str(key): value for key, value in content.items() if key != "kind"}
        inputs = list_section_inputs(kind)
        for key, value in [*settings.items()]:
            if key not in inputs:
                owners = [one for one in KINDS if key in list_section_inputs(one)]
                if not owners:
                    raise unknown_key(f"instrument.{key}", ["kind", *inputs])
                hint = f"it belongs to {', '.join(owners)}"
                raise invalid(f"instrument.{key}", value, f"left out for {kind}", hint)
            if key == "incidence_deg" and isinstance(value, list | tuple):
                raise invalid(f"instrument.{key}", value, "one angle or diffuse", USE_GRID_HINT)
            value = settings[key] = _read_whole_number(value)
            if value is not None or inputs[key].default is not None:
                _check_setting(inputs[key], f"instrument.{key}", value)
        for key, one in inputs.items():
            if one.default is Parameter.empty and settings.get(key) is None:
                raise invalid(f"instrument.{key}", None, "given", str(one.quantity))
        instrument = cls(kind, {key: one for key, one in settings.items() if one is not None})
        instrument._check_combinations()
        return instrument

    def _check_combinations(self) -> None:
        """Reject settings that exclude each other."""
        has_rays, is_binned = "rays" in self.settings, self.get("estimator") == "bins"
        for key in ERROR_TYPES:
            if key in self.settings and (has_rays or is_binned) and self.get(key) != 1.0:
                allowed = f"left out with {'rays' if has_rays else 'bins'}"
                hint = "the number of rays is fixed there, not the error"
                raise invalid(f"instrument.{key}", self.get(key), allowed, hint)
        with key_prefix("instrument"):
            if self.kind == TABLE:
                self.list_quantities()
            if self.kind == "goniophotometer":
                check_bins(*map(self.get, ("estimator", "polar_deg", "azimuth_deg", "n_bins")))

    def list_quantities(self) -> tuple[str, ...]:
        """Return the quantities of a table."""
        views = read_views(ParameterGrid(self.get_views()), "")
        return check_quantities(self.get("quantities"), views, self.get("covariance") == "keep")

    def to_content(self) -> dict[str, Any]:
        """Return the content of the section, for `from_content`."""
        return {"kind": self.kind, **self.settings}

    def get(self, name: str) -> Any:
        """Return a setting, by default that of its function, None if there is neither."""
        inputs = list_section_inputs(self.kind)
        default = inputs[name].default if name in inputs and inputs[name].has_default else None
        return self.settings.get(name, default)

    def get_wavelengths(self) -> np.ndarray:
        """Return the wavelengths (nm); an arbitrary one if they have no effect."""
        if "wavelength_nm" not in list_section_inputs(self.kind):
            return np.array([550.0])
        given = self.get("wavelength_nm")
        if given is None:
            name = self.get("sky")
            # The wavelengths of a clear sky are the same for any position of the sun.
            return choose_wavelengths(None, sky(name, 0.0 if name == CLEAR_SKY else None), 2)
        return check_wavelengths("instrument.wavelength_nm", given)

    def get_incidence(self) -> float | str:
        """Return the incidence angle (°) or "diffuse"."""
        return self.get("incidence_deg") or 0.0

    def get_seed(self, default: int) -> int:
        """Return the seed of the experiment, by default that of the main file."""
        return int(self.settings.get("seed", default))

    def get_views(self) -> dict[str, tuple[float, ...]]:
        """Return the axes of directions that a table has besides those of the grid."""
        inputs = list_section_inputs(self.kind)
        return {
            name: tuple(inputs[name].check(f"instrument.{name}", self.settings[name]).tolist())
            for name in VIEW_AXES
            if self.kind == TABLE and name in self.settings
        }

    def select_point(self, position: int) -> Instrument:
        """Return the instrument at a point of a grid, with the target error of this point."""
        scales = self.get("point_stderr_scale")
        if scales is None:
            return self
        others = {k: v for k, v in self.settings.items() if k != "point_stderr_scale"}
        scale = scales[position] * self.get("stderr_scale")
        return replace(self, settings={**others, "stderr_scale": scale})

    def scale_stderr(self, stderr: float) -> float:
        """Return the target error of the experiment for that of the accuracy."""
        return min((self.get("stderr_scale") or 1.0) * stderr, MAX_STDERR)

    def list_arguments(self) -> dict[str, Any]:
        """Return the keyword arguments of the instrument's function."""
        own = {k: v for k, v in self.settings.items() if k not in ("seed", *ERROR_TYPES)}
        if self.get("wavelength_nm") is not None:
            own["wavelength_nm"] = self.get_wavelengths()
        return own | ({"sky": self.get("sky")} if self.get("sky") else {})

    def choose_solver(self, media: Iterable[Medium], max_stderr: float = math.inf) -> str:
        """Return the solver for all media of a spectrophotometer or of a table."""
        wavelengths, solver = self.get_wavelengths(), self.get("solver")
        if self.kind == TABLE:
            return choose_table_solver(
                solver, media, wavelengths, self.get("covariance") == "keep", max_stderr,
                has_views="polar_deg" in self.settings,
            )  # fmt: skip
        obstacle = find_path_obstacle(self.get("estimator"), self.get("stokes"))
        return choose_solver(
            solver, media, wavelengths, obstacle=obstacle, max_stderr=max_stderr
        ).solver

    def check_simulation(
        self, grid: Mapping[str, Mapping[str, Any]], *, is_single: bool, has_packs: bool
    ) -> None:
        """Reject a grid or a medium that the instrument does not allow.

        `is_single` is whether each point is simulated alone.  The sun of a sky must be where
        snowpacks, or any other medium, need it.
        """
        inputs, incidence = list_section_inputs(self.kind), self.get_incidence()
        sky_key, sky_name = "instrument.sky", self.get("sky")
        angles = [*grid.get("incidence_deg", {}).values()]
        scales, n_points = self.get("point_stderr_scale"), math.prod(map(len, grid.values()))
        numbers = f"{n_points} numbers, one for each point of the grid"
        varied = {key: list(given) for key, given in grid.items() if len(given) > 1}
        check_relations(
            (
                not angles or "incidence_deg" in inputs, "grid.incidence_deg", angles,
                f"left out for {self.kind}",
            ),
            (
                not angles or incidence == 0.0, "instrument.incidence_deg", incidence,
                "left out, because grid.incidence_deg sets it",
            ),
            (
                scales is None or (is_single and len(scales) == n_points),
                "instrument.point_stderr_scale", scales,
                numbers if is_single else "left out for tables and snowpacks",
            ),
            (
                self.kind != "beam_spread" or not grid or "half_width_m" in self.settings,
                "instrument.half_width_m", None, "given where there is a grid",
                "all maps have the same axes",
            ),
            (
                self.kind != "refractive_index" or not varied, "grid", varied,
                f"of one value for {self.kind}",
            ),
            (
                not (has_packs and sky_name == ASTM_G173), sky_key, sky_name,
                f"{CLEAR_SKY} or a sky of SNICAR", f"the sun of {ASTM_G173} does not move",
            ),
            (
                has_packs or sky_name != CLEAR_SKY, sky_key, sky_name,
                f"{ASTM_G173} or a sky of SNICAR, such as midlatitude_winter",
                "only snowpacks of a file have the zenith angle of the sun that it needs",
            ),
        )  # fmt: skip


def _check_setting(declared: Input, key: str, value: Any) -> None:
    """Check a setting; a text of several numbers is a list without brackets."""
    try:
        declared.check(key, value)
    except InvalidValue as error:
        if isinstance(value, str) and "," in value and error.allowed.startswith("numbers"):
            error.hint = f"write [{value}]"
        raise


def _read_whole_number(value: Any) -> Any:
    """Return a whole number for one that YAML reads as another type; others unchanged."""
    is_float = isinstance(value, float) and value.is_integer() and abs(value) < MAX_INT64
    is_text = isinstance(value, str) and re.fullmatch(r"\d{1,3}(_\d{3})+", value)
    return int(value) if is_float or is_text else value


def make_instrument_schemas() -> dict[str, dict[str, Any]]:
    """Return the JSON schemas of the sections by kind."""
    schemas = {}
    for kind in KINDS:
        inputs = list_section_inputs(kind)
        required = [name for name, one in inputs.items() if one.default is Parameter.empty]
        schemas[kind] = {
            "type": "object",
            "properties": {
                "kind": {"const": kind},
                **{name: one.make_schema() for name, one in inputs.items()},
            },
            "required": required,
            "additionalProperties": False,
        }
    return schemas
