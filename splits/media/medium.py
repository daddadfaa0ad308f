"""Base classes of the media that instruments measure.

A medium consists of layers, top first, over a ground; a layer is also a medium of its own.  It
consists of grains or of particles, see `Layer`.  Scenes and simulations use only what these classes
declare.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cached_property
from numbers import Real
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from splits.core.validation import (
    ROUNDING_TOLERANCE,
    check_range,
    invalid,
    suggest_name,
)
from splits.kernels.scattering_matrix import PhaseFunction
from splits.kernels.scene import DRY_PORE, GrainPopulation, HeightFields
from splits.materials import make_refractive_index, parse_refractive_index
from splits.media.ground import Ground, check_ground_reached, describe_ground
from splits.media.interpretations import TransportInterpretation


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


class LayerBottom(NamedTuple):
    """Lower end of a layer in a scene: its depth (m), and the ground in contact with it or None.

    Between a layer and a ground in contact there is no interface.
    """

    depth_m: float
    ground: Ground | None


PROTOCOL = frozenset((
    "ALTERNATIVES", "compute_added_absorption", "compute_truncation_depth", "has_grains",
    "kernel_phase_function", "list_interfaces", "lowest_layer", "make_grain_population",
    "make_height_fields", "material_columns", "opaque", "polarized", "pore_fluids",
    "pore_fraction", "pores", "reflecting_ground", "scene_bottom", "scene_layers",
    "single_scattering_albedo", "truncate", "wet_fraction",
))  # fmt: skip
"""Attributes of media that simulations need; `dir` lists them only where they are inputs."""


class Medium(ABC):
    """Layers, top first, over a ground; the base of all media.

    Attributes
    ----------
    kind : str
        Type of the medium, as in configuration files.
    ground : Ground or None
        Ground below, or None for an open lower boundary.
    polarized : bool
        Whether the Stokes vector is traced.
    opaque : bool
        Whether all light that enters is absorbed.
    """

    kind: str
    ground: Ground | None = None
    polarized: bool = False
    opaque: bool = False

    def __dir__(self) -> list[str]:
        """Return the names of inputs and derived quantities, without `PROTOCOL`."""
        inputs = {one.name for one in fields(self)} if is_dataclass(self) else set[str]()
        return [name for name in super().__dir__() if name in inputs or name not in PROTOCOL]

    @property
    @abstractmethod
    def depth_m(self) -> float:
        """Thickness (m)."""

    @property
    @abstractmethod
    def scene_layers(self) -> tuple[Layer, ...]:
        """Layers, top first."""

    @property
    def lowest_layer(self) -> Layer:
        """Lowest layer."""
        return self.scene_layers[-1]

    @property
    def reflecting_ground(self) -> Ground | None:
        """Ground that light reaches, None where it does not reflect."""
        is_reached = not (self.is_semi_infinite or self.opaque)
        ground = self.lowest_layer.scene_bottom.ground or (self.ground if is_reached else None)
        return ground if ground is not None and ground.is_reflecting else None

    @property
    def is_semi_infinite(self) -> bool:
        """Whether the lowest layer is infinite."""
        return self.lowest_layer.is_semi_infinite

    @property
    @abstractmethod
    def largest_grain_m(self) -> float:
        """Diameter of the largest grain (m), 0 without grains."""

    @property
    def material_columns(self) -> dict[str, int]:
        """Columns of the materials that may absorb, by name."""
        return {name: column for column, name in enumerate(self.list_materials())}

    @abstractmethod
    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials; those of dry and wet pores precede those of grains."""

    @abstractmethod
    def list_interfaces(self) -> Sequence[Interface]:
        """Return the interfaces whose relative index depends on wavelength."""

    @abstractmethod
    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, materials)."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return all inputs and derived quantities as dataset attributes."""

    @abstractmethod
    def truncate(self, depth_m: float, ground: Ground | None) -> Medium:
        """Return the medium with a lowest layer of another depth (m), over a ground."""


class HomogeneousLayer(Medium):
    """Layer of grains, or of particles much smaller than their separation.

    Attributes
    ----------
    pores : mapping
        Fractions of the pore space filled with other fluids, by name.
    single_scattering_albedo : float
        Fraction of the light that collisions do not absorb; paths through grains do.
    """

    pores: Mapping[str, float] = MappingProxyType({})
    single_scattering_albedo: float = 1.0

    @property
    def scene_layers(self) -> tuple[Any]:
        """The layer itself."""
        return (self,)

    @property
    def is_semi_infinite(self) -> bool:
        """Whether the layer is infinite."""
        return math.isinf(self.depth_m)

    @property
    @abstractmethod
    def extinction_per_m(self) -> float:
        """Expected number of collisions with grains or particles per metre of path between them.

        It is infinite for an opaque layer.
        """

    @property
    @abstractmethod
    def wet_fraction(self) -> float:
        """Probability that a path segment between grains is in water, or in the matrix."""

    @property
    def pore_fraction(self) -> float:
        """Fraction of a path segment that absorbs as pore space."""
        return 1.0

    @property
    def scene_bottom(self) -> LayerBottom:
        """Lower end of the layer in a scene."""
        return LayerBottom(float(self.depth_m), None)

    def make_grain_population(self) -> GrainPopulation | None:
        """Return the grains, None for a layer of particles."""
        return None

    def make_height_fields(self) -> HeightFields | None:
        """Return the rough surface on top, None for a smooth one."""
        return None

    def compute_added_absorption(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the absorption coefficient of impurities (1/m), shape (wavelengths, materials)."""
        return np.zeros((np.size(wavelength_nm), len(self.list_materials())))


AIR, WATER = "air", "water"


class GranularMedium(HomogeneousLayer):
    """Layer of grains: its population, boundaries, optical constants.

    Attributes
    ----------
    saturation : float
        Fraction of the pore space filled with water.
    sphericity : (min, max, mean, sd)
        Sphericity of the grains, a truncated normal distribution.
    refractive_index : mapping
        Refractive indices of grains and pores, by material.
    interpretation : TransportInterpretation
        Interpretation of the papers.
    has_grains : bool
        Whether the layer consists of grains.
    """

    has_grains: Literal[True] = True
    saturation: float
    sphericity: tuple[float, float, float, float]
    refractive_index: Mapping[str, Any]
    interpretation: TransportInterpretation

    def _check_inputs(self, grain_materials: Iterable[str]) -> None:
        """Check the inputs of all media of grains, and set them in their final form.

        Air has a refractive index of 1 unless it is given; each other pore fluid must be given.

        Parameters
        ----------
        grain_materials : iterable of str
            Names of the materials of grains, which pore fluids cannot have.
        """
        check_ground_reached(self.ground, self.is_semi_infinite)
        pores, given = self.pores, self.refractive_index
        reserved = (AIR, WATER, *grain_materials)
        fractions = {}
        for name, fraction in pores.items():
            if not isinstance(name, str) or not name.isidentifier() or name in reserved:
                hint = "saturation is the fraction of water, and air fills the rest"
                raise invalid("pores", name, f"names other than {', '.join(reserved)}", hint)
            fractions[name] = check_range(f"pores.{name}", fraction, 0.0, 1.0, open_low=True)
            if name not in given:
                hint = f"give refractive_index of {name}: n + kj or a table"
                raise invalid("pores", name, "media of known refractive index", hint)
        if self.saturation + sum(fractions.values()) > 1.0 + ROUNDING_TOLERANCE:
            raise invalid("pores", dict(pores), "fractions that add up to at most 1 - saturation")
        materials = [*grain_materials, WATER]
        fluids = [*fractions, *([AIR] if AIR in given else [])]
        for name in given:
            if name not in (*materials, *fluids):
                allowed = "a mapping with keys " + ", ".join([*materials, *fluids])
                hint = suggest_name(name, [*materials, *fluids])
                raise invalid("refractive_index", name, allowed, hint)
        indices = {name: make_refractive_index(name, given.get(name)) for name in materials}
        indices |= {name: parse_refractive_index(name, given[name]) for name in fluids}
        self._put(pores=fractions, refractive_index=indices)

    def _put(self, **values: Any) -> None:
        """Set inputs in their final form."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def extinction_per_m(self) -> float:
        """Expected number of collisions with grains per metre of path between them."""
        return self.make_grain_population().collision_coefficient

    @property
    @abstractmethod
    def porosity(self) -> float:
        """Volume fraction of the pore space."""

    @property
    @abstractmethod
    def mean_grain_distance_m(self) -> float:
        """Mean distance between grains along a ray (m), as defined in the papers."""

    @property
    @abstractmethod
    def attenuation_per_m(self) -> float:
        """Cross-section per volume of the grains (1/m)."""

    @property
    def mean_chord_m(self) -> float:
        """Mean chord of the convex grains (m), their volume over their projected area."""
        return 1.0 / self.attenuation_per_m

    @property
    def mean_free_path_m(self) -> float:
        """Mean free path (m) from one grain to the next.

        The mean distance 1/(𝓔 K) of the papers separates entries into grains (SPLITSnow Eq A.3);
        the mean chord of a grain is 1/K.  If the distance includes the grain, a fraction 1 − 𝓔 of
        it is free path.  Between point grains the free path is the whole distance
        (see `pore_fraction`).
        """
        rules = self.interpretation
        is_whole = rules.mean_free_path == "pore_only" or rules.grain_extent == "point"
        return self.mean_grain_distance_m * (1.0 if is_whole else self.porosity)

    @property
    def pore_fraction(self) -> float:
        """Fraction of a path segment that absorbs as pore space.

        It is 1, except for point grains with a mean free path that includes the grain.  It is then
        1 − 𝓔, and the absorption coefficient per metre of path is that of radiative transfer,
        (1 − 𝓔) times that of the material.
        """
        rules = self.interpretation
        is_part = rules.mean_free_path == "including_grain" and rules.grain_extent == "point"
        return self.porosity if is_part else 1.0

    @cached_property
    def pore_fluids(self) -> PoreFluids:
        """Fluids in the pore space, weighted by the probability of path segments in each.

        Air fills what the others leave.
        """
        wet, others = self.wet_fraction, self.pores.values()
        dry = max(1.0 - wet - sum(others), 0.0)
        return PoreFluids((AIR, WATER, *self.pores), (dry, wet, *others))

    @abstractmethod
    def make_grain_population(self) -> GrainPopulation:
        """Return the grains."""

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, materials); 1 where not given.

        Those of grains are 1.
        """
        index = np.ones((np.size(wavelength_nm), len(self.list_materials())), dtype=complex)
        fluids = zip(self.pore_fluids.names, self.pore_fluids.fractions, strict=True)
        for column, (name, fraction) in enumerate(fluids):
            if name in self.refractive_index and (fraction > 0.0 or column == DRY_PORE):
                index[:, column] = self.refractive_index[name](wavelength_nm)
        return index

    def describe(self) -> dict[str, Any]:
        """Return the inputs of all media of grains as dataset attributes."""
        layer: Any = self
        values = {field.name: getattr(self, field.name) for field in fields(layer)}
        # Others expand to several attributes.
        inputs: dict[str, Any] = {n: v for n, v in values.items() if isinstance(v, Real | tuple)}
        inputs |= {f"pores_{name}": fraction for name, fraction in self.pores.items()}
        for material, index in self.refractive_index.items():
            inputs[f"refractive_index_{material}"] = index.name
            if digest := getattr(index, "sha256", ""):
                inputs[f"refractive_index_{material}_sha256"] = digest
        inputs |= {f"interpretation_{k}": v for k, v in self.interpretation.as_dict().items()}
        return inputs | describe_ground(self.ground)

    def truncate(self, depth_m: float, ground: Ground | None) -> GranularMedium:
        """Return a layer of another depth (m), over a ground."""
        layer: Any = self
        return replace(layer, depth_m=depth_m, ground=ground)


class ParticleMedium(HomogeneousLayer):
    """Layer of particles in a matrix that is the same at all wavelengths.

    Attributes
    ----------
    refractive_index : float
        Refractive index of the matrix.
    kernel_phase_function : PhaseFunction
        Phase function in the form the kernels take.
    has_grains : bool
        Whether the layer consists of grains.
    """

    has_grains: Literal[False] = False
    refractive_index: float
    kernel_phase_function: PhaseFunction

    @abstractmethod
    def compute_truncation_depth(self, undisturbed_depth_m: float) -> float:
        """Return a depth (m), instead of an infinite one, over a white ground.

        The light above the undisturbed depth (m) is that in the infinite layer.
        """


Layer = GranularMedium | ParticleMedium
"""A layer; its `has_grains` distinguishes the two classes."""


# --------------------------------------------------------------------------------------------------
# Fluids in the pore space between grains: air, water and others.


class PoreFluids(NamedTuple):
    """Pore fluids, in the order of their columns in index arrays.

    A path segment through the pore space lies in one fluid, sampled by these fractions (SPLITSnow
    section 3.4).

    Attributes
    ----------
    names : tuple of str
        Names of the fluids: air in dry pores, then water, then others.
    fractions : tuple of float
        Fractions of the pore space, with a sum of 1.
    """

    names: tuple[str, ...]
    fractions: tuple[float, ...]

    def list_grain_interfaces(
        self, grain_material: int, probability: float = 1.0
    ) -> list[Interface]:
        """Return the interfaces of the pores with grains that are hit with a given probability."""
        return [
            Interface(probability * fraction, column, grain_material)
            for column, fraction in enumerate(self.fractions)
        ]

    def list_boundary_interfaces(self, with_fresnel: bool) -> list[Interface]:
        """Return the interfaces of filled pores with dry pores at the boundaries."""
        return [
            Interface(fraction, DRY_PORE, column, "boundary")
            for column, fraction in enumerate(self.fractions)
            if with_fresnel and column != DRY_PORE and fraction > 0.0
        ]
