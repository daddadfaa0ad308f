"""What every granular medium hands to an instrument."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from splits.media.readings import TransportReadings
from splits.transport.scene import Grains


class Interface(NamedTuple):
    """Two materials that meet, and the share of all meetings of light with grains that is theirs.

    Dry against wet pores is the slab's own face: its share is that of the light that meets it.

    Attributes
    ----------
    share : float
    near, far : int
        Materials on the outer and on the inner side.
    """

    share: float
    near: int
    far: int


class GranularMedium(Protocol):
    """A slab of grains, as instruments see it: particle table, boundaries, optical constants."""

    @property
    def kind(self) -> str:
        """What sort of medium this is, as configuration files name it."""
        ...

    @property
    def depth_m(self) -> float:
        """Thickness (m)."""
        ...

    @property
    def saturation(self) -> float:
        """Share of the pore space that is wet."""
        ...

    @property
    def readings(self) -> TransportReadings:
        """Named readings of the papers."""
        ...

    def grains(self) -> Grains:
        """Return the table of particle types."""
        ...

    def materials(self) -> tuple[str, ...]:
        """Return the names of the materials: dry pores, wet pores, then those of grains."""
        ...

    def interfaces(self) -> Sequence[Interface]:
        """Return the pairs of materials that meet at the surfaces of grains."""
        ...

    def indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, materials)."""
        ...

    def describe(self) -> dict[str, Any]:
        """Return all inputs and derived quantities, for a dataset's attributes."""
        ...
