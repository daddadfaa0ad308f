"""Snow: one type of ice grain in pores of air and water (SPLITSnow), and natural snow.

Natural snow consists of grains with the optical shape derived from tomography.  Their facetness and
sphericity are those whose absorption enhancement B and asymmetry parameter g are closest to those
of natural snow (Robledano et al. 2023, Nature Communications 14, 3955: B 1.68 ± 0.02, g 0.65 ± 0.03
over 33 samples at 900 nm).  `benchmarks/grains.py closest_shape` found them from single scattering
alone; no albedo was fitted.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import field
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from splits.core.arrays import ContentEquality, check_named_numbers
from splits.core.declarations import (
    Quantity,
    alternative,
    declare_class,
    defer_check,
    list_inputs,
    other_constructor,
)
from splits.core.inputs import (
    Depth,
    Facetness,
    Pores,
    RefractiveIndices,
    Saturation,
    Sphericity,
    describe_numbers,
)
from splits.core.validation import check_range, invalid, suggest_unit
from splits.kernels.scene import GrainPopulation, GrainTypes
from splits.materials import ice_density
from splits.materials.impurities import (
    AlgaeCells,
    Impurities,
    Impurity,
    describe_impurities,
    make_impurities,
)
from splits.media import grain_statistics as statistics
from splits.media.formatting import count_digits, find_differences, format_call
from splits.media.ground import GroundInput
from splits.media.interpretations import Interpretation, InterpretationInput, merge_interpretations
from splits.media.medium import GranularMedium, Interface

# --------------------------------------------------------------------------------------------------
# Inputs of snow.
#
# Specific surface area and optical radius scale the range of grain sizes; liquid water content, the
# volume of water per volume of snow, determines the saturation.

SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY, LIQUID_WATER_KEY = (
    "specific_surface_area_m2_kg",
    "optical_radius_um",
    "liquid_water_content",
)
GRAIN_SIZE_RANGE_UM = (1.0, 1e5)
"""Limits of the sizes of grains (µm)."""
MIN_SURFACE_AREA_M2_KG, MAX_SURFACE_AREA_M2_KG = 0.2, 2000.0
"""Limits of specific surface area (m²/kg): grains of a few cm and of a few µm."""
MIN_DENSITY_KG_M3 = 1e-12
"""Lower limit of the density: about one grain per 1e11 m of path, well within double precision."""


def _check_grain_size(key: str, value: Any) -> tuple[float, ...]:
    low, high = GRAIN_SIZE_RANGE_UM
    smallest, largest = check_named_numbers(key, value, ("min", "max"), GRAIN_SIZE_RANGE_UM)
    if not low <= smallest <= largest <= high:
        allowed = f"{low:g} <= min <= max <= {high:g} micrometres"
        raise invalid(key, value, allowed, suggest_unit(smallest, low, high, "µm"))
    if largest > 1e3 * smallest:
        raise invalid(key, value, "max <= 1000 min")
    return smallest, largest


GrainSize = Annotated[
    tuple[float, float],
    Quantity(
        "major-axis diameter of the grains, smallest to largest", "um", label="grain size", mean=-1,
        check=_check_grain_size,
        schema=describe_numbers(
            "min", "max", minimum=GRAIN_SIZE_RANGE_UM[0], maximum=GRAIN_SIZE_RANGE_UM[1]
        ),
    ),
]  # fmt: skip
SurfaceArea = Annotated[
    float,
    Quantity(
        "specific surface area of the ice", "m2 kg-1", label="specific surface area",
        low=MIN_SURFACE_AREA_M2_KG, high=MAX_SURFACE_AREA_M2_KG,
        hint="about 60 for fresh snow, 10 for old snow, 3 for melting snow",
    ),
]  # fmt: skip
OpticalRadius = Annotated[
    float,
    Quantity(
        "radius of spheres of the same specific surface area",
        "um",
        label="optical radius",
        check=defer_check,
    ),
]
LiquidWater = Annotated[
    float,
    Quantity(
        "volume of water per volume of snow", label="liquid water content",
        scale=0.16, root_at=0.0, check=defer_check,
    ),
]  # fmt: skip
SnowDensity = Annotated[
    float,
    Quantity(
        "mass of ice per volume", "kg m-3", label="density",
        low=MIN_DENSITY_KG_M3, high=ice_density(-40.0), open_high=True,
        check=defer_check,
    ),
]  # fmt: skip
SnowTemperature = Annotated[
    float, Quantity("temperature", "degC", low=-40.0, high=0.0, label="temperature")
]
ImpurityLocation = Annotated[Literal["ice", "pores"], Quantity("location of the impurities")]


def to_shortest_keywords(snow: Any, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Return the inputs of snow with each in the equivalent keyword that needs the fewest digits.

    Sizes in the default ratio are equivalent to a surface area and to a radius.
    """
    shortest = dict(inputs)
    default_size = type(snow)().grain_size_um
    ratios = [largest / smallest for smallest, largest in (snow.grain_size_um, default_size)]
    scaled = abs(ratios[0] / ratios[1] - 1.0) < 1e-9
    alternatives = type(snow).ALTERNATIVES
    for own in dict.fromkeys(alternatives.values()):
        measured = [name for name, replaced in alternatives.items() if replaced == own]
        if own in inputs and (scaled or own != "grain_size_um"):
            best = min((*measured, own), key=lambda name: count_digits(getattr(snow, name)))
            del shortest[own]
            shortest = {best: getattr(snow, best), **shortest}
    return shortest


# --------------------------------------------------------------------------------------------------
# Natural snow: optical shape of its grains.


class NaturalGrainShape(NamedTuple):
    """Optical shape of dry grains at 900 nm; see `splits.analysis.theory.grain_shape`."""

    absorption_enhancement: float
    absorption_enhancement_stderr: float
    asymmetry_parameter: float
    asymmetry_parameter_stderr: float


NATURAL_GRAIN_SHAPE = NaturalGrainShape(1.661, 0.003, 0.678, 0.001)

MIN_NATURAL_DENSITY_KG_M3 = 10.0
"""Lower limit of the density of natural snow (kg/m³)."""

NATURAL_REFRACTIVE_INDICES = {"ice": "warren_brandt_2008_picard_2016", "water": "segelstein_1981"}

NATURAL_DEFAULTS: dict[str, Any] = {
    "grain_size_um": None,
    "facetness": (0.05, 0.05, 0.05, 0.0),
    "sphericity": (0.75, 0.75, 0.75, 0.0),
    "saturation": 0.0,
    "refractive_index": NATURAL_REFRACTIVE_INDICES,
    "interpretation": "radiative_transfer",
    "density_kg_m3": 300.0,
    "depth_m": math.inf,
}
"""Defaults of natural snow where they differ from those of `Snow`; its grains have none."""
NATURAL_INTERPRETATION = Interpretation.from_input(NATURAL_DEFAULTS["interpretation"])

# --------------------------------------------------------------------------------------------------
# Snow, after SPLITSnow and as in nature.


@declare_class
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

    grain_size_um: GrainSize = (300.0, 750.0)
    facetness: Facetness = (0.2, 0.4, 0.3, 0.072)
    sphericity: Sphericity = (0.6, 0.95, 0.798, 0.064)
    saturation: Saturation = 0.05
    density_kg_m3: SnowDensity = 275.0
    temperature_c: SnowTemperature = -1.0
    depth_m: Depth = 0.12
    refractive_index: RefractiveIndices = field(default_factory=dict)
    interpretation: InterpretationInput = field(default_factory=Interpretation)
    ground: GroundInput = None
    pores: Pores = field(default_factory=dict)
    impurities_ng_g: Impurities = field(default_factory=dict, compare=False)
    algae_cells_ml: AlgaeCells = field(default_factory=dict, compare=False)
    impurities_in: ImpurityLocation = "ice"
    specific_surface_area_m2_kg: SurfaceArea = alternative(
        replaces="grain_size_um", compute="_compute_surface_area", default=None
    )
    optical_radius_um: OpticalRadius = alternative(
        replaces="grain_size_um", compute="_compute_optical_radius", default=None
    )
    liquid_water_content: LiquidWater = alternative(
        replaces="saturation", compute="_compute_liquid_water", default=None
    )

    @other_constructor(NATURAL_DEFAULTS)
    def natural(cls, keywords: dict[str, Any]) -> dict[str, Any]:
        """Return modelled natural snow; dry, clean and semi-infinite by default.

        The grains have the absorption enhancement B and the asymmetry parameter measured for
        natural snow at 900 nm (`splits.media.snow`).  They are point scatterers (interpretation
        ``radiative_transfer``).  The reflectance of dry semi-infinite snow therefore does not
        depend on its density, the BRDF is reciprocal, and the mean path length in ice follows from
        B.  The absorption of ice below 600 nm is that of Picard et al. (2016), and the refractive
        index of water is that of Segelstein (1981).

        Parameters
        ----------
        specific_surface_area_m2_kg, optical_radius_um, grain_size_um
            Size of the grains, by one of the three; see `Snow`.
        density_kg_m3 : float
            Mass of ice per volume of snow, from 10 kg/m³ to below the density of ice.
        depth_m : float
            Thickness (m).  An infinite depth is allowed for spectra, albedos, profiles and delays,
            and for BRDFs and HDRFs by discrete ordinates.

        Raises
        ------
        ValueError
            If no size is given, or for a value outside its range.

        Notes
        -----
        The other keywords are those of `Snow`; by default the snow is dry and clean.

        Examples
        --------
        >>> from splits import Snow
        >>> snow = Snow.natural(specific_surface_area_m2_kg=20, density_kg_m3=250, depth_m=1)
        >>> round(snow.optical_radius_um, 1)
        163.6
        """
        given = {name: value for name, value in keywords.items() if value is not None}
        defaults = {name: value for name, value in NATURAL_DEFAULTS.items() if value is not None}
        if LIQUID_WATER_KEY in given:
            # It determines the saturation.
            del defaults["saturation"]
        complete = {**defaults, **given}
        if {SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY, "grain_size_um"}.isdisjoint(complete):
            raise invalid(
                SURFACE_AREA_KEY, None, "given, or optical_radius_um",
                "m2/kg: 40 and more for fresh snow, 10 for old snow, 3 for melting snow",
            )  # fmt: skip
        declared = list_inputs(cls)["temperature_c"]
        temperature = declared.check("temperature_c", given.get("temperature_c", declared.default))
        _check_density(complete["density_kg_m3"], MIN_NATURAL_DENSITY_KG_M3, temperature)
        interpretation = NATURAL_DEFAULTS["interpretation"], complete["interpretation"]
        if isinstance(interpretation[1], Mapping):
            complete["interpretation"] = merge_interpretations(interpretation)
        index = given.get("refractive_index", {})
        if isinstance(index, Mapping):
            complete["refractive_index"] = NATURAL_REFRACTIVE_INDICES | dict(index)
        return complete

    def __repr__(self) -> str:
        """Return the call that constructs the snow, on one line."""
        if is_natural(self):
            default = type(self).natural(grain_size_um=self.grain_size_um)
            inputs = {"grain_size_um": self.grain_size_um, **find_differences(self, default)}
            return format_call("Snow.natural", to_shortest_keywords(self, inputs))
        return format_call("Snow", to_shortest_keywords(self, find_differences(self, type(self)())))

    def __post_init__(  # type: ignore[override]
        self,
        area: float | None = None,
        radius: float | None = None,
        liquid_water: float | None = None,
    ) -> None:
        density = _check_density(self.density_kg_m3, MIN_DENSITY_KG_M3, self.temperature_c)
        self._put(density_kg_m3=density)
        if liquid_water is not None:
            hint = "volume of water per volume of snow, at most that of its pores"
            water = check_range(LIQUID_WATER_KEY, liquid_water, 0.0, self.porosity, hint=hint)
            self._put(saturation=water / self.porosity)
        if radius is not None:
            # Spheres of radius r have the specific surface area 3/(ρ_ice r).
            ice = ice_density(self.temperature_c)
            low, high = 3e6 / (ice * MAX_SURFACE_AREA_M2_KG), 3e6 / (ice * MIN_SURFACE_AREA_M2_KG)
            area = 3e6 / (ice * check_range(OPTICAL_RADIUS_KEY, radius, low, high, "µm"))
        if area is not None:
            # It is inversely proportional to size; sizes keep the ratio of the defaults.
            factor = self.specific_surface_area_m2_kg / area
            del self.__dict__["attenuation_per_m"], self.__dict__["_diameter_limits_m"]
            sizes = tuple(factor * size for size in self.grain_size_um)
            self._put(grain_size_um=_check_grain_size("grain_size_um", sizes))
        self._check_inputs(["ice"])
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

    def _compute_surface_area(self) -> float:
        """Specific surface area, 4K/ρ_ice for convex grains (m²/kg)."""
        return 4.0 * self.attenuation_per_m / ice_density(self.temperature_c)

    def _compute_optical_radius(self) -> float:
        """Radius of ice spheres of the same specific surface area, 3/(ρ_ice SSA) (µm)."""
        return 3e6 / (ice_density(self.temperature_c) * self.specific_surface_area_m2_kg)

    def _compute_liquid_water(self) -> float:
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
        index = super().compute_refractive_indices(wavelength_nm)
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
        attrs = super().describe() | describe_impurities(self._impurities, self.impurities_in)
        attrs |= {
            "mean_grain_distance_m": self.mean_grain_distance_m,
            "specific_surface_area_m2_kg": self.specific_surface_area_m2_kg,
            "optical_radius_um": self.optical_radius_um,
            "liquid_water_content": self.liquid_water_content,
        }
        if is_natural(self):
            shape = NATURAL_GRAIN_SHAPE
            attrs |= {
                "absorption_enhancement_900nm_dry": shape.absorption_enhancement,
                "absorption_enhancement_900nm_dry_stderr": shape.absorption_enhancement_stderr,
                "asymmetry_parameter_900nm_dry": shape.asymmetry_parameter,
                "asymmetry_parameter_900nm_dry_stderr": shape.asymmetry_parameter_stderr,
            }
        return attrs


def _check_density(density_kg_m3: Any, lowest: float, temperature_c: float) -> float:
    """Return the validated mass of ice per volume of snow, below the density of ice."""
    ice = ice_density(temperature_c)
    hint = f"ice at {temperature_c:g} °C has {ice:g}"
    return check_range(
        "density_kg_m3", density_kg_m3, lowest, ice, "kg/m3", hint=hint, open_high=True
    )


def is_natural(snow: Any) -> bool:
    """Return whether snow has the grains and the interpretation of natural snow."""
    same_grains = all(
        getattr(snow, name) == NATURAL_DEFAULTS[name] for name in ("facetness", "sphericity")
    )
    return same_grains and snow.interpretation == NATURAL_INTERPRETATION
