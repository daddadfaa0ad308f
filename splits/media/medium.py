"""What all media hand to an instrument, and what granular ones do.

What a layer of small particles hands to an instrument.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from splits.core.validation import invalid
from splits.kernels.grains.scene import GrainPopulation
from splits.kernels.optics.phase_function import PhaseFunction
from splits.kernels.particle_layer.scene import ScatteringLayer
from splits.kernels.rough_surface.realization import HeightFields
from splits.materials.lookup import absorption_coefficient
from splits.media.ground import Ground
from splits.media.interpretations import TransportInterpretation

N_PORE_MATERIALS = 2
"""Materials of dry and wet pores, which come first; those of other pores follow."""


class Interface(NamedTuple):
    """Two materials that meet, and the share of all meetings of light with grains that is theirs.

    Attributes
    ----------
    fraction : float
        Of meetings with grains; of a face, that of the light that meets it.
    outer_material, inner_material : int
        Materials on the outer and on the inner side.
    location : {"outer", "inner", "face"}
        Between pores and grains; within grains; at a face of the sample, where wet pores meet dry
        ones, or what particles lie in.
    layer : int
        Of the sample.
    """

    fraction: float
    outer_material: int
    inner_material: int
    location: str = "outer"
    layer: int = 0


class OpticalMedium(Protocol):
    """What all media tell instruments: their materials and all of their inputs."""

    @property
    def kind(self) -> str:
        """What sort of medium this is, as configuration files name it."""
        ...

    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials; of grains, after those of dry and wet pores."""
        ...

    def list_interfaces(self) -> Sequence[Interface]:
        """Return the pairs of materials whose contrast depends on wavelength."""
        ...

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, materials)."""
        ...

    def describe(self) -> dict[str, Any]:
        """Return all inputs and derived quantities, for a dataset's attributes."""
        ...


@runtime_checkable
class ImpureMedium(Protocol):
    """A medium that may hold what absorbs besides its materials."""

    def compute_added_absorption(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return what impurities absorb (1/m), shape (wavelengths, materials)."""
        ...


def compute_absorption(
    medium: OpticalMedium, index: np.ndarray, wavelength_nm: np.ndarray
) -> np.ndarray:
    """Return the absorption coefficients (1/m) of a medium's materials, impurities included.

    They apply to recorded lengths (`compute_path_fractions`).

    Parameters
    ----------
    medium : OpticalMedium
    index : complex, shape (wavelengths, materials)
        Its refractive indices.
    wavelength_nm : float, shape (wavelengths,)
    """
    absorption = absorption_coefficient(index, wavelength_nm[:, np.newaxis])
    absorption *= compute_path_fractions(medium)
    first = 0
    for part in _get_scene_layers(medium):
        count = len(part.list_materials())
        if isinstance(part, ImpureMedium):
            absorption[:, first : first + count] += part.compute_added_absorption(wavelength_nm)
        first += count
    return absorption


def compute_path_fractions(medium: OpticalMedium) -> np.ndarray:
    """Return which fraction of the length recorded in each material is path in it.

    Kernels record whole segments between grains; of those between points, pores are a fraction
    (`compute_pore_fraction`).
    """
    fractions = []
    for part in _get_scene_layers(medium):
        own = np.ones(len(part.list_materials()))
        if isinstance(part, GranularMedium):
            own[: N_PORE_MATERIALS + len(part.pores)] = compute_pore_fraction(part)
        fractions.append(own)
    return np.concatenate(fractions)


def _get_scene_layers(medium: OpticalMedium) -> Sequence[Any]:
    return medium.scene_layers if isinstance(medium, LayeredMedium) else (medium,)


@runtime_checkable
class LayeredMedium(OpticalMedium, Protocol):
    """Several granular media, top first."""

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
        """Return the media as scenes take them: granular ones, and layers of particles."""
        ...

    @property
    def ground(self) -> Ground | None:
        """What lies below, None where light leaves there."""
        ...


@runtime_checkable
class GranularMedium(OpticalMedium, Protocol):
    """A slab of grains, as instruments see it: particle table, boundaries, optical constants."""

    @property
    def depth_m(self) -> float:
        """Thickness (m)."""
        ...

    @property
    def saturation(self) -> float:
        """Share of the pore space that is wet."""
        ...

    @property
    def wet_fraction(self) -> float:
        """Probability that a leg through pores runs in water."""
        ...

    @property
    def pores(self) -> Mapping[str, float]:
        """Shares of the pore space that other media fill, by name."""
        ...

    @property
    def largest_grain_m(self) -> float:
        """Diameter of the largest grain (m)."""
        ...

    @property
    def porosity(self) -> float:
        """Share of the volume that is pores."""
        ...

    @property
    def mean_grain_distance_m(self) -> float:
        """Mean distance between grains along a ray (m), as the papers have it."""
        ...

    @property
    def interpretation(self) -> TransportInterpretation:
        """Named readings of the papers."""
        ...

    @property
    def ground(self) -> Ground | None:
        """What lies below, None where light leaves there."""
        ...

    def make_grain_population(self) -> GrainPopulation:
        """Return the table of particle types."""
        ...


def compute_mean_free_path_m(medium: GranularMedium) -> float:
    """Return the mean leg (m) that a ray goes from one grain to the next.

    The papers' mean distance 1/(𝓔 K) is that between entries into grains (SPLITSnow Eq A.3), of
    mean chord 1/K.  Counted with the grain, 1 − 𝓔 of it are left for the leg, unless grains are
    points, among which the leg stands for both (`compute_pore_fraction`).
    """
    interpretation = medium.interpretation
    whole = interpretation.mean_free_path == "pore_only" or interpretation.grain_extent == "point"
    return medium.mean_grain_distance_m * (1.0 if whole else medium.porosity)


def compute_pore_fraction(medium: GranularMedium) -> float:
    """Return the fraction of a leg that counts as pore space when it absorbs.

    It is 1 unless grains are points whose distance includes them: then 1 − 𝓔, and the coefficient
    that applies per metre of leg is that of radiative transfer, (1 − 𝓔) times the material's.
    """
    interpretation = medium.interpretation
    parted = (
        interpretation.mean_free_path == "including_grain"
        and interpretation.grain_extent == "point"
    )
    return medium.porosity if parted else 1.0


def check_thickness(medium: GranularMedium | LayeredMedium) -> None:
    """Refuse a sample that is not thicker than its largest grain."""
    largest = medium.largest_grain_m
    if medium.depth_m <= largest:
        hint = "such a grain must fit between the boundaries"
        raise invalid(
            "depth_m", medium.depth_m, f"more than the largest grain, {largest:g} m", hint
        )


@runtime_checkable
class ParticleMedium(OpticalMedium, Protocol):
    """A layer of particles far smaller than their distances, as instruments see it."""

    @property
    def extinction_per_m(self) -> float:
        """Extinction coefficient (1/m)."""
        ...

    @property
    def kernel_phase_function(self) -> PhaseFunction:
        """Phase function."""
        ...

    @property
    def polarized(self) -> bool:
        """Whether the Stokes vector is followed."""
        ...

    def make_scattering_layer(self, analog: bool) -> ScatteringLayer:
        """Return the layer; with absorption by coin toss if it is `analog`."""
        ...

    def make_height_fields(self) -> HeightFields | None:
        """Return the rough surface, None where it is smooth."""
        ...


Medium = GranularMedium | LayeredMedium | ParticleMedium


@runtime_checkable
class SurfaceMedium(ParticleMedium, Protocol):
    """A layer, as instruments see it that look at its surface alone."""

    @property
    def refractive_index(self) -> float:
        """Of what is below the surface, relative to the medium above."""
        ...

    @property
    def surface(self) -> Any:
        """The `splits.media.rough_surface.RoughSurface`, None where it is smooth."""
        ...
