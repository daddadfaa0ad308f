"""Media whose particles are conservative, in a matrix that absorbs instead."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from splits.kernels.scene import MATRIX
from splits.media.ground import Ground
from splits.media.medium import Layer, Medium
from splits.media.particle_layer import ParticleLayer
from splits.media.stack import Stack


@dataclass(frozen=True, eq=False, repr=False)
class AbsorbingMatrixLayer(ParticleLayer):
    """Layer of conservative particles in an absorbing matrix.

    Absorption at particles is equivalent to absorption along the path.  With the latter, path
    lengths give the absorption between any two depths.

    Parameters
    ----------
    absorption_per_m : float
        Absorption coefficient of the matrix (1/m).
    """

    absorption_per_m: float = 0.0

    @classmethod
    def from_particle_layer(cls, layer: ParticleLayer) -> AbsorbingMatrixLayer:
        """Return the layer that is equivalent to one of absorbing particles."""
        albedo = layer.single_scattering_albedo
        inputs: dict[str, Any] = {f.name: getattr(layer, f.name) for f in fields(layer)}
        inputs |= {
            "optical_thickness": albedo * layer.optical_thickness,
            "single_scattering_albedo": 1.0,
        }
        return cls(**inputs, absorption_per_m=(1.0 - albedo) * layer.extinction_per_m)

    @property
    def ground(self) -> Ground | None:
        """The bottom, whose hits are counted along the paths."""
        return Ground.from_input(self.bottom_albedo)

    def compute_added_absorption(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the absorption coefficient of the matrix (1/m), shape (wavelengths, 2)."""
        added = np.zeros((np.size(wavelength_nm), 2))
        added[:, MATRIX] = self.absorption_per_m
        return added


@dataclass(frozen=True)
class AbsorbingStack(Stack):
    """Stack whose particles absorb along the path."""

    @cached_property
    def scene_layers(self) -> tuple[Layer, ...]:
        """Layers, top first."""
        return tuple(
            layer if layer.has_grains else AbsorbingMatrixLayer.from_particle_layer(layer)
            for layer in self.layers
        )


def absorb_along_path(medium: Medium) -> Medium:
    """Return a medium that is equivalent, but whose particles absorb along the path."""
    if isinstance(medium, ParticleLayer):
        return AbsorbingMatrixLayer.from_particle_layer(medium)
    if isinstance(medium, Stack) and not all(layer.has_grains for layer in medium.layers):
        return AbsorbingStack(medium.layers, medium.ground)
    return medium
