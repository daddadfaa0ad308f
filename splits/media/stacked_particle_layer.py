"""Particle layer within a stack."""

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
    "surface": (None, "only the top layer of a stack may be rough"),
    "polarized": (False, "stacks do not support polarization"),
    "opaque": (False, "all layers of a stack scatter light"),
}
"""Settings that are not supported in a stack, with the required value and the reason."""


@dataclass(frozen=True)
class StackedParticleLayer:
    """Particle layer in the form that scenes of several layers take.

    The matrix replaces the water of a fully saturated pore space, with air outside.  Fresnel
    reflection and refraction act at its boundaries where the index of the neighbour differs.

    Parameters
    ----------
    layer : ParticleLayer
    is_top : bool
        Whether it is the top layer of the stack, which may have a rough surface.

    Raises
    ------
    ValueError
        If the layer has a bottom, polarization or infinite thickness, or is rough below the top.
    """

    layer: ParticleLayer
    is_top: bool = False
    wet_fraction = 1.0
    largest_grain_m = 0.0

    def __post_init__(self) -> None:
        for name, (allowed, reason) in UNSUPPORTED_IN_STACK.items():
            value = getattr(self.layer, name)
            if value != allowed and not (name == "surface" and self.is_top):
                raise invalid(name, value, "left out" if allowed is None else "false", reason)
        if self.layer.optical_thickness == math.inf:
            raise invalid("optical_thickness", math.inf, "finite", "other layers lie below")

    @property
    def depth_m(self) -> float:
        """Thickness (m)."""
        return float(self.layer.depth_m)

    def make_height_fields(self) -> HeightFields | None:
        """Return the rough surface in the form the kernels take, or None for a smooth surface."""
        return self.layer.make_height_fields()

    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials, in the order of the columns of index arrays."""
        return ("air", "matrix")

    def list_interfaces(self) -> Sequence[Interface]:
        """Return no interfaces: the refractive index does not depend on wavelength."""
        return ()

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, 2)."""
        index = np.ones((np.size(wavelength_nm), 2), dtype=complex)
        index[:, WET_PORE] = self.layer.refractive_index
        index[:, DRY_PORE] = 1.0
        return index

    def describe(self) -> dict[str, Any]:
        """Return all inputs as dataset attributes."""
        return self.layer.describe()


@dataclass(frozen=True)
class AbsorbingMatrixLayer(StackedParticleLayer):
    """Layer of conservative particles in an absorbing matrix.

    Absorption at particles is equivalent to absorption along the path.  With the latter, path
    lengths give the absorption between any two depths.

    Parameters
    ----------
    absorption_per_m : float
        Absorption coefficient of the matrix (1/m).
    outer_index : float
        Refractive index of the medium outside the layer.
    """

    absorption_per_m: float = 0.0
    outer_index: float = 1.0

    @classmethod
    def from_particle_layer(cls, stacked_layer: StackedParticleLayer) -> AbsorbingMatrixLayer:
        """Return the layer that is equivalent to one of absorbing particles."""
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
        """Return the absorption coefficient of the matrix (1/m), shape (wavelengths, 2)."""
        added = np.zeros((np.size(wavelength_nm), 2))
        added[:, WET_PORE] = self.absorption_per_m
        return added
