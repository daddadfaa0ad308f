"""Models of the instruments of rough surfaces alone."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, model_validator

from splits.core.validation import invalid
from splits.experiments.config.instrument import Instrument, Seed
from splits.instruments.rough_surfaces import (
    DEFAULT_POINTS,
    DEFAULT_RAYS,
    MAX_REALIZATIONS,
    check_ring_radius,
    check_ring_size,
    check_screen_depths,
)
from splits.simulation.run_options import check_half_width

MapHalfWidth = Annotated[float, AfterValidator(lambda x: check_half_width("surface_map", x))]
LensHalfWidth = Annotated[float, AfterValidator(lambda x: check_half_width("lens", x))]
Depths = Annotated[
    tuple[float, ...], AfterValidator(lambda x: tuple(check_screen_depths("", x).tolist()))
]


class SurfaceMap(Instrument):
    """Heights of a rough surface."""

    FIGURES: ClassVar = ("surface",)
    N_POSITIONS: ClassVar = DEFAULT_POINTS**2
    MEASURES_SURFACE: ClassVar = True

    kind: Literal["surface_map"]
    seed: Seed = None
    half_width_m: MapHalfWidth
    """half the side length of the map (m)"""
    realizations: int = Field(100, ge=2, le=MAX_REALIZATIONS)
    """number of realizations of the surface"""


class Lens(Instrument):
    """Images of a ring of rays through a rough surface."""

    FIGURES: ClassVar = ("lens",)
    MEASURES_SURFACE: ClassVar = True

    kind: Literal["lens"]
    seed: Seed = None
    radius_m: Annotated[float, AfterValidator(check_ring_radius)]
    """radius of the ring of rays (m)"""
    screen_depth_m: Depths
    """depths of the screens (m), increasing"""
    centre_on: Literal["crest", "trough", "origin"] = "crest"
    """point of the surface above which the ring is centred"""
    half_width_m: LensHalfWidth | None = None
    """half the side length of the square in which the crest is searched (m); required, except over
    the origin"""
    rays: int = Field(DEFAULT_RAYS, ge=1)
    """number of rays in the ring"""
    realizations: int = Field(1, ge=1)
    """number of realizations of the surface"""

    @model_validator(mode="after")
    def _check_extent(self) -> Lens:
        if self.half_width_m is None and self.centre_on != "origin":
            hint = "range of the search for the crest; or centre_on: origin"
            raise invalid("half_width_m", None, "given for lens", hint)
        if self.half_width_m is not None and self.centre_on == "origin":
            hint = "there is no search for a crest"
            raise invalid("half_width_m", self.half_width_m, "left out over the origin", hint)
        check_ring_size(self.rays, self.realizations, len(self.screen_depth_m))
        return self

    def count_values(self) -> int:
        """Return the number of values of a quantity at one point of a grid."""
        return len(self.screen_depth_m) * self.rays
