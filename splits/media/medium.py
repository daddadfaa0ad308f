"""Protocols of the media that instruments measure, and quantities derived from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from splits.core.validation import invalid
from splits.kernels.grains.scene import GrainPopulation
from splits.kernels.optics.phase_function import PhaseFunction
from splits.kernels.rough_surface.realization import HeightFields
from splits.materials.lookup import absorption_coefficient
from splits.media.ground import Ground
from splits.media.interpretations import TransportInterpretation

N_PORE_MATERIALS = 2
"""Number of materials for dry and wet pores; they precede those of other pore fluids."""


class Interface(NamedTuple):
    """Interface between two materials, with the probability that light interacts with it.

    Attributes
    ----------
    fraction : float
        Fraction of the collisions with grains; for a boundary, fraction of the light that hits it.
    outer_material, inner_material : int
        Materials on the outer and on the inner side.
    location : {"outer", "inner", "boundary"}
        Between pores and grains ("outer"), within grains ("inner"), or at a horizontal boundary of
        the sample ("boundary"), between wet pores and dry pores or the matrix of a particle layer.
    layer : int
        Number of the layer in the sample.
    """

    fraction: float
    outer_material: int
    inner_material: int
    location: str = "outer"
    layer: int = 0


class OpticalMedium(Protocol):
    """Protocol of all media: materials, refractive indices and inputs."""

    @property
    def kind(self) -> str:
        """Type of the medium, as in configuration files."""
        ...

    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials; those of dry and wet pores precede those of grains."""
        ...

    def list_interfaces(self) -> Sequence[Interface]:
        """Return the interfaces whose relative index depends on wavelength."""
        ...

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, materials)."""
        ...

    def describe(self) -> dict[str, Any]:
        """Return all inputs and derived quantities as dataset attributes."""
        ...


@runtime_checkable
class ImpureMedium(Protocol):
    """Protocol of media with absorbing impurities."""

    def compute_added_absorption(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the absorption coefficient of impurities (1/m), shape (wavelengths, materials)."""
        ...


def compute_absorption(
    medium: OpticalMedium, index: np.ndarray, wavelength_nm: np.ndarray
) -> np.ndarray:
    """Return the absorption coefficients (1/m) of the materials of a medium, with impurities.

    They apply to path lengths as recorded by the kernels (see `compute_path_fractions`).

    Parameters
    ----------
    medium : OpticalMedium
    index : complex, shape (wavelengths, materials)
        Refractive indices.
    wavelength_nm : float, shape (wavelengths,)
    """
    absorption = absorption_coefficient(index, wavelength_nm[:, np.newaxis])
    absorption *= compute_path_fractions(medium)
    first = 0
    for layer in _get_scene_layers(medium):
        n_materials = len(layer.list_materials())
        if isinstance(layer, ImpureMedium):
            absorption[:, first : first + n_materials] += layer.compute_added_absorption(
                wavelength_nm
            )
        first += n_materials
    return absorption


def compute_path_fractions(medium: OpticalMedium) -> np.ndarray:
    """Return the fraction of the recorded path length that lies in each material.

    Kernels record whole segments between grains.  Between point grains only a fraction of a segment
    is pore space (see `compute_pore_fraction`).
    """
    fractions = []
    for layer in _get_scene_layers(medium):
        layer_fractions = np.ones(len(layer.list_materials()))
        if isinstance(layer, GranularMedium):
            layer_fractions[: N_PORE_MATERIALS + len(layer.pores)] = compute_pore_fraction(layer)
        fractions.append(layer_fractions)
    return np.concatenate(fractions)


def _get_scene_layers(medium: OpticalMedium) -> Sequence[Any]:
    return medium.scene_layers if isinstance(medium, LayeredMedium) else (medium,)


@runtime_checkable
class LayeredMedium(OpticalMedium, Protocol):
    """Protocol of layered media, top layer first."""

    @property
    def depth_m(self) -> float:
        """Thickness (m)."""
        ...

    @property
    def largest_grain_m(self) -> float:
        """Diameter of the largest grain (m)."""
        ...

    @property
    def scene_layers(self) -> Sequence[Any]:
        """Layers in the form scenes take: granular media and stacked particle layers."""
        ...

    @property
    def ground(self) -> Ground | None:
        """Ground below, or None for an open lower boundary."""
        ...


@runtime_checkable
class GranularMedium(OpticalMedium, Protocol):
    """Protocol of granular slabs: grain population, boundaries, optical constants."""

    @property
    def depth_m(self) -> float:
        """Thickness (m)."""
        ...

    @property
    def saturation(self) -> float:
        """Fraction of the pore space filled with water."""
        ...

    @property
    def wet_fraction(self) -> float:
        """Probability that a path segment through the pore space lies in water."""
        ...

    @property
    def pores(self) -> Mapping[str, float]:
        """Fractions of the pore space filled with other fluids, by name."""
        ...

    @property
    def largest_grain_m(self) -> float:
        """Diameter of the largest grain (m)."""
        ...

    @property
    def porosity(self) -> float:
        """Volume fraction of the pore space."""
        ...

    @property
    def mean_grain_distance_m(self) -> float:
        """Mean distance between grains along a ray (m), as defined in the papers."""
        ...

    @property
    def interpretation(self) -> TransportInterpretation:
        """Interpretation of the papers."""
        ...

    @property
    def ground(self) -> Ground | None:
        """Ground below, or None for an open lower boundary."""
        ...

    def make_grain_population(self) -> GrainPopulation:
        """Return the grain population."""
        ...


def compute_mean_free_path_m(medium: GranularMedium) -> float:
    """Return the mean free path (m) from one grain to the next.

    The mean distance 1/(𝓔 K) of the papers separates entries into grains (SPLITSnow Eq A.3); the
    mean chord of a grain is 1/K.  If the distance includes the grain, a fraction 1 − 𝓔 of it is
    free path.  Between point grains the free path is the whole distance
    (see `compute_pore_fraction`).
    """
    interpretation = medium.interpretation
    whole_distance = (
        interpretation.mean_free_path == "pore_only" or interpretation.grain_extent == "point"
    )
    return medium.mean_grain_distance_m * (1.0 if whole_distance else medium.porosity)


def compute_pore_fraction(medium: GranularMedium) -> float:
    """Return the fraction of a path segment that absorbs as pore space.

    The fraction is 1, except for point grains with a mean free path that includes the grain.  It is
    then 1 − 𝓔, and the absorption coefficient per metre of path is that of radiative transfer,
    (1 − 𝓔) times that of the material.
    """
    interpretation = medium.interpretation
    includes_grain = (
        interpretation.mean_free_path == "including_grain"
        and interpretation.grain_extent == "point"
    )
    return medium.porosity if includes_grain else 1.0


def check_thickness(medium: GranularMedium | LayeredMedium) -> None:
    """Check that the sample is thicker than its largest grain."""
    largest = medium.largest_grain_m
    if medium.depth_m <= largest:
        hint = "such a grain must fit between the boundaries"
        raise invalid(
            "depth_m", medium.depth_m, f"more than the largest grain, {largest:g} m", hint
        )


class LayerBottom(NamedTuple):
    """Lower end of a layer in a scene.

    Attributes
    ----------
    depth_m : float
        Depth (m); may be infinite.
    albedo : float or None
        Albedo of the Lambertian bottom, None for an open lower boundary.
    """

    depth_m: float
    albedo: float | None


@runtime_checkable
class ParticleMedium(OpticalMedium, Protocol):
    """Protocol of layers of particles much smaller than their separation."""

    @property
    def extinction_per_m(self) -> float:
        """Extinction coefficient (1/m)."""
        ...

    @property
    def single_scattering_albedo(self) -> float:
        """Single-scattering albedo."""
        ...

    @property
    def refractive_index(self) -> float:
        """Refractive index of the matrix, relative to the medium above."""
        ...

    @property
    def opaque(self) -> bool:
        """Whether all light that enters is absorbed."""
        ...

    @property
    def scene_bottom(self) -> LayerBottom:
        """Lower end of the layer in a scene."""
        ...

    @property
    def kernel_phase_function(self) -> PhaseFunction:
        """Phase function."""
        ...

    @property
    def polarized(self) -> bool:
        """Whether the Stokes vector is traced."""
        ...

    def make_height_fields(self) -> HeightFields | None:
        """Return the rough surface, or None for a smooth surface."""
        ...


Medium = GranularMedium | LayeredMedium | ParticleMedium


@runtime_checkable
class SurfaceMedium(ParticleMedium, Protocol):
    """Protocol of media for instruments that measure the surface alone."""

    @property
    def surface(self) -> Any:
        """Rough surface (`splits.media.rough_surface.RoughSurface`), or None if smooth."""
        ...
