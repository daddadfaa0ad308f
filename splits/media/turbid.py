"""What a layer of small particles hands to an instrument."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from splits.media.granular import Described, GranularMedium, LayeredMedium
from splits.transport.optics.phase import Phase
from splits.transport.particles.turbid import Turbid
from splits.transport.rough.waves import Fields


@runtime_checkable
class TurbidMedium(Described, Protocol):
    """A layer of particles far smaller than their distances, as instruments see it."""

    @property
    def extinction_per_m(self) -> float:
        """Extinction coefficient (1/m)."""
        ...

    @property
    def kernel_phase_function(self) -> Phase:
        """Phase function."""
        ...

    @property
    def polarized(self) -> bool:
        """Whether the Stokes vector is followed."""
        ...

    def make_scattering_layer(self, analog: bool) -> Turbid:
        """Return the layer; with absorption by coin toss if it is `analog`."""
        ...

    def make_height_fields(self) -> Fields | None:
        """Return the rough surface, None where it is smooth."""
        ...


Medium = GranularMedium | LayeredMedium | TurbidMedium


@runtime_checkable
class SurfaceMedium(TurbidMedium, Protocol):
    """A layer, as instruments see it that look at its surface alone."""

    @property
    def refractive_index(self) -> float:
        """Of what is below the surface, relative to the medium above."""
        ...

    @property
    def surface(self) -> Any:
        """The `splits.media.rough_surface.RoughSurface`, None where it is smooth."""
        ...
