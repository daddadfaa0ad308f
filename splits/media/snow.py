"""Snow: one type of ice grain in pores of air and water (SPLITSnow)."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from splits.core.arrays import check_named_numbers
from splits.core.equality import ContentEquality
from splits.core.keywords import reject_unknown_keywords
from splits.core.validation import check_choice, check_range, invalid, suggest_unit
from splits.kernels.scene import GrainPopulation, GrainTypes
from splits.materials import ice_density
from splits.materials.impurities import Impurity, describe_impurities, make_impurities
from splits.media import grain_statistics as statistics
from splits.media.formatting import find_differences, format_call
from splits.media.ground import (
    Ground,
    check_ground_reached,
    check_sample_depth,
    check_truncated_normal,
    describe_inputs,
    make_refractive_indices,
)
from splits.media.interpretations import Interpretation
from splits.media.medium import GranularMedium, Interface, PoreFluids, check_other_fluids
from splits.media.natural_snow import (
    GRAIN_SIZE_RANGE_UM,
    accepts_measured_inputs,
    describe_grain_shape,
    is_natural,
    make_natural_snow,
    to_shortest_keywords,
)

MIN_DENSITY_KG_M3 = 1e-12
"""Lower limit of the density: about one grain per 1e11 m of path, well within double precision."""


@reject_unknown_keywords
@accepts_measured_inputs
@dataclass(frozen=True, eq=False, repr=False)
class Snow(ContentEquality, GranularMedium):
    """Homogeneous layer of snow, after SPLITSnow; the defaults are those of its Table 1.

    `Snow.natural` is a model of natural snow of a given specific surface area.  With the default
    refractive indices, wavelengths from 200 nm to 100 µm are allowed.

    Parameters
    ----------
    grain_size_um : (min, max)
        Limits of the major-axis diameter s of the grains (µm), 1 to 100 000, with max at most
        1000 min.  The paper calls the size distribution P(s) uniform.  According to its attenuation
        K1 (Eq A.7), the distributions of grains by number, area and volume are ∝ s⁻⁴, s⁻² and s⁻¹
        between the limits, so none of the three is uniform.
    specific_surface_area_m2_kg, optical_radius_um : float
        Replaces `grain_size_um`: specific surface area (surface area per mass of ice), 0.2 to
        2000 m²/kg, or the radius (µm) of spheres of the same specific surface area.  The ratio of
        the largest to the smallest size is that of Table 1, 2.5.
    facetness : (min, max, mean, sd)
        Facetness of the grains, 0 (smooth) to 1; a normal distribution truncated to [min, max].
        For a single value f, write ``(f, f, f, 0.0)``.
    sphericity : (min, max, mean, sd)
        Inscribed-circle sphericity Ψ = √(minor/major), from the axes of the grains, 0.1 to 1 (a
        sphere); a normal distribution truncated to [min, max].
    saturation : float
        Fraction of the pore space filled with water, 0 to 1.  The default sample is wet.
    liquid_water_content : float
        Replaces `saturation`: volume of water per volume of snow, 0 to the porosity.
    pores : mapping, optional
        Fractions of the pore space filled with other fluids, by name: ``{"brine": 0.1}``.
        ``refractive_index`` must define each of them.
    impurities_ng_g : mapping, optional
        Mass of impurities per mass of ice (ng/g) by type: ``{"black_carbon": 50}``; see
        `splits.materials.impurities.make_impurities` for the types and for user tables.
        Impurities absorb and do not scatter.
    algae_cells_ml : mapping, optional
        Number of cells of "ice_algae" or "snow_algae" per ml of meltwater.
    impurities_in : {"ice", "pores"}
        Location of the impurities, uniformly mixed into the grains or into the pore space.
    density_kg_m3 : float
        Mass of ice per volume of snow (kg/m³), without liquid water; from 1e-12 to below the
        density of ice.
    temperature_c : float
        Temperature, −40 to 0 °C; determines the density of ice.
    depth_m : float
        Thickness of the layer (m), above 0 and up to 1e4, or infinite for spectra, albedos,
        profiles and delays, and for BRDFs and HDRFs by discrete ordinates.  The sample, of one
        layer or several, must be thicker than its largest grain.
    refractive_index : mapping, optional
        Refractive index by material ("ice", "water", "air"): the name of a dataset, a complex
        constant n + kj or a table; see `splits.materials.refractive_index`.  Air, with an index of
        1 by default, is also the medium above the sample.
    interpretation : Interpretation, str or mapping, optional
        Interpretation of the papers, or the name of a set: "splitsnow_2021" (default),
        "splits_2007", "geometric" or "radiative_transfer".
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
    >>> from splits import Snow
    >>> round(Snow(density_kg_m3=450).mean_grain_distance_m, 6)
    0.000437
    """

    kind = "snow"

    grain_size_um: tuple[float, float] = (300.0, 750.0)
    facetness: tuple[float, float, float, float] = (0.2, 0.4, 0.3, 0.072)
    sphericity: tuple[float, float, float, float] = (0.6, 0.95, 0.798, 0.064)
    saturation: float = 0.05
    density_kg_m3: float = 275.0
    temperature_c: float = -1.0
    depth_m: float = 0.12
    refractive_index: Mapping[str, Any] = field(default_factory=dict)
    interpretation: Interpretation = field(default_factory=Interpretation)
    ground: Any = None
    pores: Mapping[str, float] = field(default_factory=dict)
    impurities_ng_g: Mapping[str, Any] = field(default_factory=dict, compare=False)
    algae_cells_ml: Mapping[str, float] = field(default_factory=dict, compare=False)
    impurities_in: str = "ice"

    if TYPE_CHECKING:

        def __init__(
            self,
            grain_size_um: tuple[float, float] = ...,
            facetness: tuple[float, float, float, float] = ...,
            sphericity: tuple[float, float, float, float] = ...,
            saturation: float = ...,
            density_kg_m3: float = ...,
            temperature_c: float = ...,
            depth_m: float = ...,
            refractive_index: Mapping[str, Any] = ...,
            interpretation: Interpretation | str | Mapping[str, Any] = ...,
            ground: Any = ...,
            pores: Mapping[str, float] = ...,
            impurities_ng_g: Mapping[str, Any] = ...,
            algae_cells_ml: Mapping[str, float] = ...,
            impurities_in: str = ...,
            *,
            specific_surface_area_m2_kg: float | None = ...,
            optical_radius_um: float | None = ...,
            liquid_water_content: float | None = ...,
        ) -> None: ...

    natural = classmethod(make_natural_snow)

    def __repr__(self) -> str:
        """Return the call that constructs the snow, on one line."""
        if is_natural(self):
            default = type(self).natural(grain_size_um=self.grain_size_um)
            inputs = {"grain_size_um": self.grain_size_um, **find_differences(self, default)}
            return format_call("Snow.natural", to_shortest_keywords(self, inputs))
        return format_call("Snow", to_shortest_keywords(self, find_differences(self, type(self)())))

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        sizes = check_named_numbers(
            "grain_size_um", self.grain_size_um, ("min", "max"), GRAIN_SIZE_RANGE_UM
        )
        smallest, largest = sizes
        low, high = GRAIN_SIZE_RANGE_UM
        if not low <= smallest <= largest <= high:
            allowed = f"{low:g} <= min <= max <= {high:g} micrometres"
            hint = suggest_unit(smallest, low, high, "µm")
            raise invalid("grain_size_um", self.grain_size_um, allowed, hint)
        if largest > 1e3 * smallest:
            raise invalid("grain_size_um", self.grain_size_um, "max <= 1000 min")
        put("grain_size_um", (smallest, largest))
        put("facetness", check_truncated_normal("facetness", self.facetness, 0.0))
        put("sphericity", check_truncated_normal("sphericity", self.sphericity, 0.1))
        put("saturation", check_range("saturation", self.saturation, 0.0, 1.0))
        put("temperature_c", check_range("temperature_c", self.temperature_c, -40.0, 0.0, "°C"))
        ice = ice_density(self.temperature_c)
        hint = f"ice at {self.temperature_c:g} °C has {ice:g}"
        key, density = "density_kg_m3", self.density_kg_m3
        put(
            key,
            check_range(key, density, MIN_DENSITY_KG_M3, ice, "kg/m3", hint=hint, open_high=True),
        )
        put("ground", Ground.from_input(self.ground))
        put("depth_m", check_sample_depth(self.depth_m))
        check_ground_reached(self.ground, self.is_semi_infinite)
        put("interpretation", Interpretation.from_input(self.interpretation))
        indices = self.refractive_index
        put("pores", check_other_fluids(self.pores, self.saturation, indices, ("ice",)))
        put("refractive_index", make_refractive_indices(("ice", "water"), indices, self.pores))
        check_choice("impurities_in", self.impurities_in, ("ice", "pores"))
        # Validates the impurities.
        _ = self._impurities

    @cached_property
    def _diameter_limits_m(self) -> tuple[float, float]:
        scale = 1e-6 if self.interpretation.size_definition == "diameter" else 2e-6
        return self.grain_size_um[0] * scale, self.grain_size_um[1] * scale

    @cached_property
    def _impurities(self) -> tuple[Impurity, ...]:
        return make_impurities(self.impurities_ng_g, self.algae_cells_ml)

    def _comparison_key(self) -> tuple[Hashable, ...]:
        # Tables compare by their content, not by the path of the file.
        return (*super()._comparison_key(), frozenset(self._impurities))

    @property
    def largest_grain_m(self) -> float:
        """Diameter of the largest grain (m)."""
        return self._diameter_limits_m[1]

    @property
    def porosity(self) -> float:
        """Volume fraction not filled by ice (SPLITSnow Eq A.1)."""
        ice = ice_density(self.temperature_c)
        return (ice - self.density_kg_m3) / ice

    @property
    def ice_fraction(self) -> float:
        """Volume fraction of ice, 𝓔 (SPLITSnow Eq A.2)."""
        return self.density_kg_m3 / ice_density(self.temperature_c)

    @cached_property
    def attenuation_per_m(self) -> float:
        """K = K1 K2, cross-section per volume of ice (1/m), SPLITSnow Eq A.5."""
        return statistics.compute_size_attenuation(
            *self._diameter_limits_m
        ) * statistics.compute_shape_attenuation(*self.sphericity)

    @property
    def mean_grain_distance_m(self) -> float:
        """Mean distance between the grains that a ray hits (m), SPLITSnow Eq A.3."""
        return 1.0 / (self.ice_fraction * self.attenuation_per_m)

    @property
    def specific_surface_area_m2_kg(self) -> float:
        """Specific surface area, 4K/ρ_ice for convex grains (m²/kg)."""
        return 4.0 * self.attenuation_per_m / ice_density(self.temperature_c)

    @property
    def optical_radius_um(self) -> float:
        """Radius of ice spheres of the same specific surface area, 3/(ρ_ice SSA) (µm)."""
        return 3e6 / (ice_density(self.temperature_c) * self.specific_surface_area_m2_kg)

    @property
    def liquid_water_content(self) -> float:
        """Volume of water per volume of snow."""
        return self.saturation * self.porosity

    @property
    def wet_fraction(self) -> float:
        """Probability that a path segment through the pore space lies in water."""
        return self.saturation

    def make_grain_population(self) -> GrainPopulation:
        """Return the grain population: a single type, of ice."""
        sizes = statistics.tabulate_hit_inverse_sizes(
            *self._diameter_limits_m, self.interpretation.size_sampling
        )
        return GrainPopulation(
            collision_coefficient=1.0 / self.mean_free_path_m,
            type_cdf=np.ones(1),
            types=GrainTypes(
                n_shells=np.ones(1, dtype=np.int64),
                material=np.array([[self._ice_column]], dtype=np.int64),
                coating_thickness=np.zeros((1, 1)),
                inverse_semi_major=2.0 * sizes[np.newaxis],
                sphericity=statistics.tabulate_hit_sphericities(*self.sphericity)[np.newaxis],
                facetness=statistics.tabulate_truncated_normal(*self.facetness)[np.newaxis],
            ),
        )

    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials, in the order of the columns of index arrays."""
        return (*self.pore_fluids.names, "ice")

    @cached_property
    def pore_fluids(self) -> PoreFluids:
        """Fluids in the pore space."""
        return PoreFluids.from_saturation(self.saturation, self.pores)

    @property
    def _ice_column(self) -> int:
        """Column of ice in index arrays."""
        return len(self.pore_fluids.names)

    def list_interfaces(self) -> list[Interface]:
        """Return the optical interfaces at grain surfaces and at the slab boundaries."""
        fresnel = self.interpretation.to_sampling_rules().boundary_fresnel
        return self.pore_fluids.list_grain_interfaces(
            self._ice_column
        ) + self.pore_fluids.list_boundary_interfaces(fresnel)

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, materials); 1 where not given."""
        wavelength_nm = np.asarray(wavelength_nm, dtype=float)
        index = np.ones((wavelength_nm.size, self._ice_column + 1), dtype=complex)
        self.pore_fluids.fill_refractive_indices(index, self.refractive_index, wavelength_nm)
        index[:, self._ice_column] = self.refractive_index["ice"](wavelength_nm)
        return index

    def compute_added_absorption(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the absorption coefficient of impurities (1/m), shape (wavelengths, materials)."""
        wavelength_nm = np.asarray(wavelength_nm, dtype=float)
        added = np.zeros((wavelength_nm.size, self._ice_column + 1))
        per_ice = sum(
            impurity.compute_absorption_per_kg_ice(wavelength_nm) for impurity in self._impurities
        )
        if self.impurities_in == "ice":
            added[:, self._ice_column] = ice_density(self.temperature_c) * per_ice
        else:
            # Per length of path segment in the pores: a ray crosses a length 1/K of ice (Eq A.5)
            # for every segment, so the impurity per mass of ice is preserved along the ray.
            ice_per_segment = 1.0 / (self.attenuation_per_m * self.mean_free_path_m)
            density = ice_density(self.temperature_c) * ice_per_segment
            added[:, : self._ice_column] = np.reshape(density * per_ice, (-1, 1))
        return added

    def describe(self) -> dict[str, Any]:
        """Return the inputs and derived quantities as dataset attributes."""
        return (
            describe_inputs(self)
            | describe_impurities(self._impurities, self.impurities_in)
            | {
                "mean_grain_distance_m": self.mean_grain_distance_m,
                "specific_surface_area_m2_kg": self.specific_surface_area_m2_kg,
                "optical_radius_um": self.optical_radius_um,
                "liquid_water_content": self.liquid_water_content,
            }
            | describe_grain_shape(self)
        )
