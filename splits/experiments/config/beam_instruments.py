"""Models of the instruments of where and when light leaves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, AllowInfNan, BeforeValidator, model_validator

from splits.core.validation import key_prefix
from splits.experiments.config.grid import expand_spacing
from splits.experiments.config.instrument import OpticalInstrument, Rays
from splits.experiments.config.sections import FiniteSection
from splits.instruments.beam_spread import N_MAP_PIXELS, SIDES
from splits.instruments.delay_record import (
    Pulse,
    check_depths,
    check_granular_layers,
    check_record,
    compute_slowness,
    make_receiver,
)
from splits.instruments.delay_tally import check_tally_size
from splits.media.medium import Medium
from splits.simulation.run_options import check_half_width

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


def _expand_delays(value: Any) -> Any:
    return expand_spacing("delay_s", value) if isinstance(value, Mapping) else value


Delays = Annotated[
    tuple[float, ...],
    BeforeValidator(_expand_delays, json_schema_input_type=tuple[float, ...] | dict[str, Any]),
]
"""Delays (s) as a list, or as `{start, stop, step}`."""


def dump_pulse(pulse: float | PulseSection | None) -> Any:
    """Return the argument `pulse` of `splits.time_of_flight`."""
    return pulse.model_dump() if isinstance(pulse, PulseSection) else pulse


class DelayInstrument(OpticalInstrument):
    """An instrument that records delays of light."""

    FIGURES: ClassVar = ("return", "range_bias")
    ALLOWS_SEMI_INFINITE: ClassVar = True

    rays: Rays = None
    delay_s: Delays | None = None
    """edges of the bins of delay (s), increasing, also as `{start, stop, step}`; by default 0 and
    ten per decade from 1e-12 to 1e-7"""
    acceptance_deg: float | None = None
    """largest angle between received light and the direction to the source (°), by default all
    light is received at the surface"""
    footprint_radius_m: float | None = None
    """radius of the field of view on the surface (m)"""

    @model_validator(mode="after")
    def _check_record(self) -> DelayInstrument:
        make_receiver(self.incidence_deg, self.acceptance_deg, self.footprint_radius_m)
        check_tally_size(self.get_wavelengths().size, self.get_edges().size - 1)
        return self

    @property
    def takes_beam_only(self) -> bool:
        """Whether its light is a beam."""
        return self.acceptance_deg is not None or self.footprint_radius_m is not None

    def get_edges(self) -> np.ndarray:
        """Return the edges of the bins of delay (s)."""
        edges, _ = check_record(self.delay_s, None, Pulse.from_argument(None))
        return edges

    def count_values(self) -> int:
        """Return the number of values of a quantity at one point of a grid."""
        return (self.get_edges().size - 1) * self.get_wavelengths().size

    def check_medium(self, medium: Medium) -> None:
        """Reject a medium with other layers than of grains, or without group indices."""
        super().check_medium(medium)
        check_granular_layers(medium)
        with key_prefix("instrument"):
            compute_slowness(medium, self.get_wavelengths())


class TimeOfFlight(DelayInstrument):
    """Return of a pulse over time."""

    kind: Literal["time_of_flight"]
    end_s: Annotated[float, AllowInfNan(True)] | None = None
    """delay until which light counts in moments (s), by default the last of `delay_s`"""
    pulse: float | PulseSection | None = None
    """full width at half maximum of a Gaussian pulse (s), or its power over time; by default, the
    pulse is instantaneous"""
    depths_m: tuple[float, ...] | None = None
    """depths that divide the light by the largest depth reached (m), increasing"""

    def get_edges(self) -> np.ndarray:
        """Return the edges of the bins of delay (s)."""
        pulse = Pulse.from_argument(dump_pulse(self.pulse))
        edges, _ = check_record(self.delay_s, self.end_s, pulse)
        return edges

    def count_values(self) -> int:
        """Return the number of values of a quantity at one point of a grid."""
        return len(SIDES) * super().count_values()

    def check_medium(self, medium: Medium) -> None:
        """Reject a medium with other layers than of grains, or depths outside it."""
        super().check_medium(medium)
        with key_prefix("instrument"):
            check_depths(self.depths_m, medium)


class ReturnTable(DelayInstrument):
    """Table of returns of an instantaneous pulse over a grid, for retrieval."""

    kind: Literal["return_table"]
