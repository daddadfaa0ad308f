"""Sand: up to eight types of mineral particles in pores of air and water (SPLITS)."""

from __future__ import annotations

from dataclasses import field
from functools import cache, cached_property
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from splits.core.arrays import ContentEquality, check_named_numbers
from splits.core.declarations import Quantity, declare_class, defer_check
from splits.core.inputs import (
    Depth,
    Pores,
    RefractiveIndices,
    Saturation,
    Sphericity,
    describe_numbers,
)
from splits.core.validation import check_range, invalid
from splits.kernels.scene import WET_PORE, GrainPopulation, GrainTypes
from splits.materials import MINERAL_DENSITY_KG_M3, MIXING_RULES
from splits.media import grain_statistics as statistics
from splits.media.formatting import find_differences, format_call
from splits.media.ground import GroundInput
from splits.media.interpretations import SandInterpretation, SandInterpretationInput
from splits.media.medium import WATER, GranularMedium, Interface
from splits.media.sand_composition import (
    SOIL_SEPARATES,
    SandComposition,
    SoilSizeDistribution,
    WaterDistribution,
    compute_coating_fraction,
    distribute_water,
    make_composition,
    make_size_distribution,
)

WATER_FILM = "water film"
"""Name of the water film on grains in the list of materials."""


def _check_roundness(key: str, value: Any) -> tuple[float, float]:
    mean, sd = check_named_numbers(key, value, ("mean", "sd"))
    mean = check_range(f"{key} (mean)", mean, 0.0, 1.0)
    return mean, check_range(f"{key} (sd)", sd, 0.0, 1.0)


def _declare_fractions(long_name: str, parts: tuple[str, ...], label: str = "") -> Quantity:
    """Return the quantity of fractions that add up to 1."""
    return Quantity(
        long_name, parts=parts, label=label,
        schema=describe_numbers(*parts, minimum=0.0, maximum=1.0),
        check=lambda key, value: check_named_numbers(key, value, parts, (0.0, 1.0)),
    )  # fmt: skip


IronOxide = Annotated[
    float,
    Quantity(
        "mass of hematite and goethite per mass of sand", low=0.0, high=1.0,
        label="hematite and goethite by mass",
    ),
]  # fmt: skip
HematiteRatio = Annotated[
    float,
    Quantity(
        "mass of hematite per mass of iron oxide", low=0.0, high=1.0,
        label="hematite / iron oxide", scale=0.16,
    ),
]  # fmt: skip
Magnetite = Annotated[
    float,
    Quantity(
        "mass of magnetite per mass of sand", low=0.0, high=1.0, label="magnetite by mass",
        check=defer_check,
    ),
]  # fmt: skip
Partition = Annotated[
    tuple[float, float, float],
    _declare_fractions(
        "mass fractions of pure, mixed and coated particles",
        ("pure", "mixed", "coated"),
        "pure / mixed / coated",
    ),
]
Texture = Annotated[
    tuple[float, float, float],
    _declare_fractions("mass fractions of clay, silt and sand", SOIL_SEPARATES),
]
Porosity = Annotated[
    float,
    Quantity("volume of pores per volume", low=0.0, high=1.0, open_low=True, open_high=True),
]
Roundness = Annotated[
    tuple[float, float],
    Quantity(
        "roundness of the particles, mean and standard deviation", mean=0, scale=0.16,
        label="roundness (mean, sd)",
        check=_check_roundness,
        schema=describe_numbers("mean", "sd", minimum=0.0, maximum=1.0),
    ),
]  # fmt: skip
CoatingThickness = Annotated[
    float,
    Quantity(
        "thickness of coatings per major axis of the particle", low=0.0, high=0.05, open_low=True,
        hint="coatings are treated as flat slabs, so they must be thin",
    ),
]  # fmt: skip
SizeTail = Annotated[
    float,
    Quantity(
        "mass fraction outside the outermost size limits",
        low=1e-6,
        high=0.01,
        label="tail by mass",
    ),
]


@declare_class
class Sand(ContentEquality, GranularMedium):
    """Homogeneous sand layer, after SPLITS.

    The default constants are those of SPLITS Table 2, the default composition is that of the base
    case of Fig 8, and the default texture is that of most samples of Table 5.  With the default
    refractive indices, wavelengths from 300 to 2053 nm are allowed.

    Parameters
    ----------
    iron_oxide : float
        ϑ_hg, mass of hematite and goethite per mass of sand.  With coated grains it is at most the
        capacity of the coatings, by default 0.065 for hematite and 0.054 for goethite.
    hematite_ratio : float
        r_hg, mass fraction of hematite in the iron oxide, 0 to 1.
    magnetite : float
        ϑ_m, mass of magnetite per mass of sand, 0 to 1 − iron_oxide.
    partition : (pure, mixed, coated)
        Mass fractions of pure, mixed and coated grains (particles in the paper); they add up to 1.
    texture : (clay, silt, sand)
        Mass fractions of the soil separates, adding up to 1; silt + 1.5 clay at most 0.15.
    saturation : float
        Fraction of the pore space filled with water, 0 to 1; ``interpretation.water`` selects the
        distribution of the water.
    pores : mapping, optional
        Fractions of the pore space filled with other fluids, by name: ``{"oil": 0.1}``.
        ``refractive_index`` must define each of them.
    porosity : float
        Volume fraction of the pore space, above 0 and below 1.
    roundness : (mean, sd)
        Krumbein roundness, 0 to 1 (smooth); normal distribution.  Facetness is 1 − roundness.
    sphericity : (min, max, mean, sd)
        Riley sphericity Ψ = √(minor/major), 0.1 to 1 (a sphere); a normal distribution truncated
        to [min, max].
    relative_coating_thickness : float
        Thickness of coatings per major axis, above 0 and at most 0.05.
    depth_m : float
        Thickness of the layer (m), from more than the largest grain to 1e4, or infinite for
        spectra, albedos and profiles.
    size_tail : float
        Mass fraction of grains outside the outermost size limits; see
        `splits.media.sand_composition.make_size_distribution`.
    refractive_index : mapping, optional
        Refractive index by material ("quartz", "hematite", "goethite", "magnetite", "kaolinite",
        "water", "air"): the name of a dataset, a constant or a table; see
        `splits.materials.refractive_index`.  Air, with an index of 1 by default, is also the
        medium above the sample.
    interpretation : SandInterpretation, str or mapping, optional
        Interpretation of the paper, or the name of a set.
    ground : number, str, mapping or path, optional
        Lambertian ground below the sample: an albedo, "black", the name of a soil or a table; see
        `splits.media.ground.Ground.from_input`.  By default light leaves through the lower
        boundary ("open").

    Raises
    ------
    ValueError
        For a value outside its range; the message names key, value and range.
    TypeError
        For an unknown keyword.

    Examples
    --------
    >>> from splits import Sand
    >>> round(Sand(iron_oxide=0.01, hematite_ratio=0.738, partition=(0, 1, 0)).density_kg_m3)
    2662
    """

    kind = "sand"

    iron_oxide: IronOxide = 0.01
    hematite_ratio: HematiteRatio = 0.0
    magnetite: Magnetite = 0.0
    partition: Partition = (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)
    texture: Texture = (0.0, 0.15, 0.85)
    saturation: Saturation = 0.0
    porosity: Porosity = 0.425
    roundness: Roundness = (0.482, 0.072)
    sphericity: Sphericity = (0.6, 0.95, 0.798, 0.064)
    relative_coating_thickness: CoatingThickness = 5.0 / 1200.0
    depth_m: Depth = 1.0
    size_tail: SizeTail = 1e-4
    refractive_index: RefractiveIndices = field(default_factory=dict)
    interpretation: SandInterpretationInput = field(default_factory=SandInterpretation)
    ground: GroundInput = None
    pores: Pores = field(default_factory=dict)

    def __post_init__(self) -> None:
        hint = "the sum of all mass fractions is 1"
        largest = 1.0 - self.iron_oxide
        self._put(magnetite=check_range("magnetite", self.magnetite, 0.0, largest, hint=hint))
        self._check_inputs(MINERAL_DENSITY_KG_M3)
        if self.pores and self.interpretation.water != "whole_pores":
            hint = "which pores these fluids fill is not known: leave interpretation.water out"
            allowed = f"empty with interpretation.water {self.interpretation.water}"
            raise invalid("pores", dict(self.pores), allowed, hint)
        # Validates the size distribution and the composition.
        _ = self.size_distribution, self.composition

    def __repr__(self) -> str:
        """Return the call that constructs the sand, on one line."""
        return format_call("Sand", find_differences(self, type(self)()))

    @cached_property
    def size_distribution(self) -> SoilSizeDistribution:
        """Size distribution of the particles, the same for all types."""
        return make_size_distribution(
            self.texture, self.size_tail, self.interpretation.size_distribution
        )

    @cached_property
    def composition(self) -> SandComposition:
        """Particle types with their mass fractions, volume fractions and densities."""
        return make_composition(
            self.iron_oxide,
            self.hematite_ratio,
            self.magnetite,
            self.partition,
            compute_coating_fraction(self.sphericity[2], self.relative_coating_thickness),
            self.interpretation.excess_magnetite,
        )

    @property
    def density_kg_m3(self) -> float:
        """Mean density of the particles (kg/m³), SPLITS Eq 16."""
        return self.composition.density_kg_m3

    @property
    def largest_grain_m(self) -> float:
        """Diameter of the largest grain (m)."""
        return float(self.size_distribution.largest_m)

    @cached_property
    def attenuation_per_m(self) -> float:
        """K = K1 K2, cross-section per volume of particles (1/m), SPLITS Eqs 22-24."""
        return self.size_distribution.size_attenuation_per_m * statistics.compute_shape_attenuation(
            *self.sphericity
        )

    @property
    def mean_grain_distance_m(self) -> float:
        """Mean distance between the grains that a ray hits (m), SPLITS Eq 21."""
        as_printed = self.interpretation.attenuation_factor == "as_printed"
        return 1.0 / ((1.0 if as_printed else 1.0 - self.porosity) * self.attenuation_per_m)

    @property
    def specific_surface_area_m2_kg(self) -> float:
        """Specific surface area, 4K/γ for convex particles (m²/kg)."""
        return 4.0 * self.attenuation_per_m / self.density_kg_m3

    @cached_property
    def _water(self) -> WaterDistribution:
        """Distribution of the water in the pore space."""
        sphericity, water_model = self.sphericity[2], self.interpretation.water
        return distribute_water(self.saturation, self.porosity, sphericity, water_model)

    @property
    def wet_fraction(self) -> float:
        """Probability that a path segment through the pore space lies in water."""
        return self._water.wet_fraction

    @cached_property
    def _shell_materials(self) -> list[tuple[str, ...]]:
        """Materials of the shells of each particle type, from the outside in."""
        film = (WATER_FILM,) if self._water.relative_film_thickness else ()
        return [(*film, *t.shell_materials) for t in self.composition.particle_types]

    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials, in the order of the columns of index arrays."""
        minerals = dict.fromkeys(m for layers in self._shell_materials for m in layers)
        return (*self.pore_fluids.names, *minerals)

    def make_grain_population(self) -> GrainPopulation:
        """Return the grain population; all types have the same sizes and shapes."""
        names = self.list_materials()
        max_shells = max(len(layers) for layers in self._shell_materials)
        material = np.zeros((len(self._shell_materials), max_shells), dtype=np.int64)
        thickness = np.zeros(material.shape)
        for i, layers in enumerate(self._shell_materials):
            material[i, : len(layers)] = [names.index(m) for m in layers]
            thickness[i, : len(layers) - 1] = self.relative_coating_thickness
            if self._water.relative_film_thickness:
                thickness[i, 0] = self._water.relative_film_thickness
        facetness = statistics.tabulate_truncated_normal(
            0.0, 1.0, 1.0 - self.roundness[0], self.roundness[1]
        )
        return GrainPopulation(
            collision_coefficient=1.0 / self.mean_free_path_m,
            type_cdf=np.cumsum(self.composition.volume_fractions),
            types=GrainTypes(
                n_shells=np.array(
                    [len(layers) for layers in self._shell_materials], dtype=np.int64
                ),
                material=material,
                coating_thickness=thickness,
                inverse_semi_major=2.0
                * self.size_distribution.tabulate_hit_inverse_sizes()[np.newaxis],
                sphericity=statistics.tabulate_hit_sphericities(*self.sphericity)[np.newaxis],
                facetness=facetness[np.newaxis],
            ),
        )

    def list_interfaces(self) -> list[Interface]:
        """Return the optical interfaces at particle surfaces and at the slab boundaries."""
        names = self.list_materials()
        interfaces: list[Interface] = []
        for layers, fraction in zip(
            self._shell_materials, self.composition.volume_fractions, strict=True
        ):
            rows = [names.index(m) for m in layers]
            interfaces += self.pore_fluids.list_grain_interfaces(rows[0], fraction)
            interfaces += [Interface(fraction, *pair, "inner") for pair in pairwise(rows)]
        return interfaces + self.pore_fluids.list_boundary_interfaces(
            self.interpretation.to_sampling_rules().boundary_fresnel
        )

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, materials)."""
        mix = MIXING_RULES[self.interpretation.mixing]
        index = super().compute_refractive_indices(wavelength_nm)
        # Only the filled fraction of a wet path segment absorbs.
        index[:, WET_PORE].imag *= self._water.filled_fraction

        @cache
        def pure(mineral: str) -> np.ndarray:
            return np.asarray(self.refractive_index[mineral](wavelength_nm))

        if self._water.relative_film_thickness:
            index[:, self.list_materials().index(WATER_FILM)] = pure(WATER)
        for particle in self.composition.particle_types:
            for name in particle.shell_materials:
                row = self.list_materials().index(name)
                matrix, _, oxide = name.partition(" with ")
                index[:, row] = pure(matrix)
                if oxide:
                    index[:, row] = mix(pure(matrix), pure(oxide), particle.inclusion_fraction)
        return index

    def describe(self) -> dict[str, Any]:
        """Return the inputs and derived quantities as dataset attributes."""
        return super().describe() | {
            "particle_types": ", ".join(t.name for t in self.composition.particle_types),
            "particle_volume_fractions": self.composition.volume_fractions,
            "particle_density_kg_m3": self.density_kg_m3,
            "coating_volume_fraction": self.composition.coating_fraction,
            "mean_grain_distance_m": self.mean_grain_distance_m,
            "wet_fraction": self.wet_fraction,
            "film_thickness_per_major_axis": self._water.relative_film_thickness,
            "specific_surface_area_m2_kg": self.specific_surface_area_m2_kg,
        }
