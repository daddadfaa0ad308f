"""Models of the instruments of where and when light leaves."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, AllowInfNan, model_validator

from splits.core.validation import key_prefix
from splits.experiments.config.instrument import OpticalInstrument, Rays
from splits.experiments.config.sections import FiniteSection
from splits.instruments.beam_spread_tally import N_MAP_PIXELS, SIDES
from splits.instruments.delay_record import (
    Pulse,
    check_depths,
    check_granular_layers,
    check_record,
    make_receiver,
)
from splits.instruments.delay_tally import check_tally_size
from splits.instruments.slowness import compute_slowness
from splits.media.medium import Medium
from splits.simulation.arguments import check_half_width

BeamHalfWidth = Annotated[float, AfterValidator(lambda x: check_half_width("beam_spread", x))]


class BeamSpread(OpticalInstrument):
    """Map of the light around a narrow beam."""

    FIGURES: ClassVar = ("spread",)
    N_POSITIONS: ClassVar = len(SIDES) * N_MAP_PIXELS**2
    MEASURES_BEAM: ClassVar = True

    kind: Literal["beam_spread"]
    rays: Rays = None
    half_width_m: BeamHalfWidth | None = None
    """half the side length of the map (m), by default from the spread; required with a grid"""


class PulseSection(FiniteSection):
    """Power of a pulse over time."""

    delay_s: tuple[float, ...]
    """delays (s), increasing"""
    power: tuple[float, ...]
    """power at each delay, in any unit"""


class TimeOfFlight(OpticalInstrument):
    """Return of a pulse over time."""

    FIGURES: ClassVar = ("return", "range_bias")
    ALLOWS_SEMI_INFINITE: ClassVar = True

    kind: Literal["time_of_flight"]
    rays: Rays = None
    delay_s: tuple[float, ...] | None = None
    """edges of the bins of delay (s), increasing; by default 0 and ten per decade from 1e-12 to
    1e-7"""
    end_s: Annotated[float, AllowInfNan(True)] | None = None
    """delay until which light counts in moments (s), by default the last of `delay_s`"""
    pulse: float | PulseSection | None = None
    """full width at half maximum of a Gaussian pulse (s), or its power over time; by default, the
    pulse is instantaneous"""
    acceptance_deg: float | None = None
    """largest angle between received light and the direction to the source (°), by default all
    light is received at the surface"""
    footprint_radius_m: float | None = None
    """radius of the field of view on the surface (m)"""
    depths_m: tuple[float, ...] | None = None
    """depths that divide the light by the largest depth reached (m), increasing"""

    @model_validator(mode="after")
    def _check_record(self) -> TimeOfFlight:
        self._get_edges()
        make_receiver(self.incidence_deg, self.acceptance_deg, self.footprint_radius_m)
        check_tally_size(self.get_wavelengths().size, self._get_edges().size - 1)
        return self

    @property
    def takes_beam_only(self) -> bool:
        """Whether its light is a beam."""
        return self.acceptance_deg is not None or self.footprint_radius_m is not None

    def _get_edges(self) -> np.ndarray:
        """Return the edges of the bins of delay (s)."""
        pulse = self.pulse.model_dump() if isinstance(self.pulse, PulseSection) else self.pulse
        edges, _ = check_record(self.delay_s, self.end_s, Pulse.from_argument(pulse))
        return edges

    def count_values(self) -> int:
        """Return the number of values of a quantity at one point of a grid."""
        return len(SIDES) * (self._get_edges().size - 1) * self.get_wavelengths().size

    def check_medium(self, medium: Medium) -> None:
        """Reject a medium with other layers than of grains, or depths outside it."""
        super().check_medium(medium)
        check_granular_layers(medium)
        with key_prefix("instrument"):
            check_depths(self.depths_m, medium)
            compute_slowness(medium, self.get_wavelengths())
