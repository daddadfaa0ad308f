"""A layer of small particles as a part of a stack."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splits.core.validation import invalid
from splits.kernels.grains.scene import DRY_PORE, WET_PORE
from splits.kernels.rough_surface.realization import HeightFields
from splits.media.medium import Interface
from splits.media.particle_layer import ParticleLayer

UNSUPPORTED_IN_STACK = {
    "bottom_albedo": (None, "the stack's ground is below all layers: bottom_albedo=None"),
    "surface": (None, "only the top of a stack is rough"),
    "polarized": (False, "stacks know no polarization"),
    "opaque": (False, "light comes back from all layers of a stack"),
}
"""Settings that a layer of a stack has not, what they must be, and why."""


@dataclass(frozen=True)
class StackedParticleLayer:
    """What a `splits.ParticleLayer` hands to a scene of several layers.

    Its matrix takes the place of pores that are all wet, with air outside: so it meets its
    neighbours at Fresnel faces where their indices differ.

    Parameters
    ----------
    layer : ParticleLayer
    is_top : bool
        Whether it is the first of the stack, and may have a rough surface.

    Raises
    ------
    ValueError
        If it has a bottom, a rough surface where it is not the top, polarization or no end.
    """

    layer: ParticleLayer
    is_top: bool = False
    wet_fraction = 1.0
    largest_grain_m = 0.0

    def __post_init__(self) -> None:
        for name, (allowed, why) in UNSUPPORTED_IN_STACK.items():
            given = getattr(self.layer, name)
            if given != allowed and not (name == "surface" and self.is_top):
                raise invalid(name, given, "left out" if allowed is None else "false", why)
        if self.layer.optical_thickness == math.inf:
            raise invalid("optical_thickness", math.inf, "finite", "other layers lie below")

    @property
    def depth_m(self) -> float:
        """Thickness (m)."""
        return float(self.layer.depth_m)

    def make_height_fields(self) -> HeightFields | None:
        """Return its rough surface as kernels take it, None where it is smooth."""
        return self.layer.make_height_fields()

    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials in the rows of index arrays."""
        return ("air", "matrix")

    def list_interfaces(self) -> Sequence[Interface]:
        """Return none: the index is the same at all wavelengths."""
        return ()

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, 2)."""
        index = np.ones((np.size(wavelength_nm), 2), dtype=complex)
        index[:, WET_PORE] = self.layer.refractive_index
        index[:, DRY_PORE] = 1.0
        return index

    def describe(self) -> dict[str, Any]:
        """Return all inputs under names fit for dataset attributes."""
        return self.layer.describe()


@dataclass(frozen=True)
class AbsorbingMatrixLayer(StackedParticleLayer):
    """A layer of particles that scatter, in a matrix that absorbs in their place.

    Absorption along the path and at particles is the same to light.  Lengths of paths then tell
    what is absorbed between any two depths.

    Parameters
    ----------
    absorption_per_m : float
        Absorption coefficient of the matrix (1/m).
    outer_index : float
        Refractive index outside the layer.
    """

    absorption_per_m: float = 0.0
    outer_index: float = 1.0

    @classmethod
    def from_particle_layer(cls, stacked_layer: StackedParticleLayer) -> AbsorbingMatrixLayer:
        """Return the layer that is the same to light as one of absorbing particles."""
        layer = stacked_layer.layer
        albedo = layer.single_scattering_albedo
        thickness = albedo * layer.optical_thickness
        scattering = replace(layer, optical_thickness=thickness, single_scattering_albedo=1.0)
        return cls(scattering, stacked_layer.is_top, (1.0 - albedo) * layer.extinction_per_m)

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, 2)."""
        index = super().compute_refractive_indices(wavelength_nm)
        index[:, DRY_PORE] = self.outer_index
        return index

    def compute_added_absorption(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return what the matrix absorbs (1/m), shape (wavelengths, 2)."""
        added = np.zeros((np.size(wavelength_nm), 2))
        added[:, WET_PORE] = self.absorption_per_m
        return added
