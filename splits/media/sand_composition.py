"""Composition of sand: particle types by volume from mineral concentrations by mass.

SPLITS sections 4.2.4-4.2.5, Tables 3-4 and Eqs 5-18.  Quartz, hematite, goethite and magnetite
are distributed among eight types of particle: pure minerals, quartz mixed with an iron oxide, and
quartz coated by an iron oxide in a kaolinite matrix.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from splits.core.arrays import ContentEquality
from splits.core.validation import ROUNDING_TOLERANCE, check_relations, invalid
from splits.kernels.scene import make_table_probabilities
from splits.materials import MINERAL_DENSITY_KG_M3
from splits.media.grain_statistics import (
    N_TABLE_POINTS,
    integrate_with_quantiles,
    surface_to_volume_ratio,
)

# --------------------------------------------------------------------------------------------------
# Particle size distribution of soils: a log-normal distribution per soil separate, from texture.
#
# SPLITS section 4.2.6 follows Shirazi et al. (1988, Soil Science Society of America Journal 52,
# 181-190): within clay, silt and sand the distribution of mass is log-normal.  The geometric mean
# and standard deviation of each separate follow from the cumulative mass at its two limits, taken
# as points of a normal distribution in log size.

SEPARATE_LIMITS_M = (5e-8, 2e-6, 5e-5, 2e-3)
"""Limits of clay, silt and sand (m): USDA, with 50 nm as the smallest clay particle."""
SOIL_SEPARATES = ("clay", "silt", "sand")
MAX_FINES_FRACTION = 0.15
"""Maximum of silt + 1.5 clay in a sand (USDA; SPLITS Table 2)."""


@dataclass(frozen=True)
class TruncatedLogNormal:
    """Mass distribution of a soil separate: log-normal between two sizes.

    Attributes
    ----------
    min_size_m, max_size_m : float
        Limits of the major axis (m).
    mass_fraction : float
        Mass per mass of all particles.
    log_mean, log_sd : float
        Mean and standard deviation of the natural logarithm of the size in m: a_g, b_g of Eq 19.
    """

    min_size_m: float
    max_size_m: float
    mass_fraction: float
    log_mean: float
    log_sd: float

    def _relative_density(self, x: np.ndarray, power: float = 0.0) -> np.ndarray:
        """Return s^power times the probability density of x = ln s, up to a factor."""
        score = (x - self.log_mean) / self.log_sd
        return np.exp(-0.5 * score**2 + power * (x - np.log(self.min_size_m)))

    @property
    @lru_cache(maxsize=1024)  # noqa: B019 - by value, few
    def mean_inverse_size_per_m(self) -> float:
        """Mass-weighted mean of 1/s (1/m): the quotient of integrals in Eq 23."""
        # The closed form is not used: its error functions cancel when the limits of a separate lie
        # close together in probability, while this integrand is always smooth.
        low, high = float(np.log(self.min_size_m)), float(np.log(self.max_size_m))
        weighted, _ = integrate_with_quantiles(lambda x: self._relative_density(x, -1.0), low, high)
        norm, _ = integrate_with_quantiles(self._relative_density, low, high)
        return weighted / norm / self.min_size_m

    def compute_hit_sizes(self, probability: np.ndarray) -> np.ndarray:
        """Return quantiles of the size of hit particles (m): density ∝ s⁻² f_g(s), Eq 25."""
        low, high = float(np.log(self.min_size_m)), float(np.log(self.max_size_m))
        _, log_size = integrate_with_quantiles(
            lambda x: self._relative_density(x, -1.0), low, high, probability
        )
        return np.exp(log_size)


@dataclass(frozen=True)
class SoilSizeDistribution:
    """Particle size distribution of a soil, by separate from fine to coarse."""

    separates: tuple[TruncatedLogNormal, ...]

    @property
    def largest_m(self) -> float:
        """Largest major axis (m)."""
        return max(s.max_size_m for s in self.separates)

    @property
    def size_attenuation_per_m(self) -> float:
        """Volume-weighted mean of 1/s (1/m): K1 of Eq 23 without v_j."""
        return sum(s.mass_fraction * s.mean_inverse_size_per_m for s in self.separates)

    @lru_cache(maxsize=64)  # noqa: B019 - by value, few
    def tabulate_hit_inverse_sizes(self) -> np.ndarray:
        """Return the quantile function of 1/s of hit particles, shape (N_TABLE_POINTS,).

        The table is linear between the outermost quantiles of two separates, as within one.  For
        clay and sand without silt, about 0.1 % of the particles that are hit fall in the gap.
        """
        u = make_table_probabilities(N_TABLE_POINTS)
        weights = np.array([s.mass_fraction * s.mean_inverse_size_per_m for s in self.separates])
        edges = np.concatenate([[0.0], np.cumsum(weights[::-1]) / weights[::-1].sum()])
        edges[-1] = 1.0
        inverse_size = np.empty(u.shape)
        for i, separate in enumerate(reversed(self.separates)):
            inside = (u >= edges[i]) & (u <= edges[i + 1])
            fraction = (u[inside] - edges[i]) / (edges[i + 1] - edges[i])
            inverse_size[inside] = 1.0 / separate.compute_hit_sizes(1.0 - fraction)
        return inverse_size


def make_size_distribution(
    texture: tuple[float, ...], tail_mass: float = 1e-4, size_model: str = "separates"
) -> SoilSizeDistribution:
    """Return the particle size distribution of a sand of given texture.

    Parameters
    ----------
    texture : (clay, silt, sand)
        Mass fractions ζ1, ζ2, ζ3, adding up to 1, with ζ2 + 1.5 ζ1 at most 0.15.
    tail_mass : float
        Mass fraction assumed outside the outermost limits, 1e-6 to 0.01.  It determines how far
        the distributions of the outermost separates extend towards small sizes.
    size_model : {"separates", "single"}
        A log-normal distribution per separate, or a single one with the geometric mean and
        standard deviation of the texture (Shirazi & Boersma 1984, Soil Science Society of America
        Journal 48, 142-147), between the limits of the separates present.

    Raises
    ------
    ValueError
        For a texture that is not that of a sand.
    """
    clay, silt, sand = texture
    check_relations(
        (
            min(clay, silt, sand) >= 0.0 and abs(clay + silt + sand - 1.0) <= 1e-9,
            "texture", texture, "three fractions (clay, silt, sand) that add up to 1",
        ),
        (
            silt + 1.5 * clay <= MAX_FINES_FRACTION + 1e-9, "texture", texture,
            f"silt + 1.5 clay at most {MAX_FINES_FRACTION:g}", "more is not a sand",
        ),
    )  # fmt: skip
    cumulative = np.clip(
        [tail_mass, clay, clay + silt, 1.0 - tail_mass], tail_mass, 1.0 - tail_mass
    )
    if size_model == "single":
        # The moments are those of the midpoints of the separates.
        masses = np.array([clay, silt, sand])
        log_midpoint = np.log([0.5 * (a + b) for a, b in pairwise((0.0, *SEPARATE_LIMITS_M[1:]))])
        mean = float(masses @ log_midpoint)
        sd = float(np.sqrt(max(masses @ log_midpoint**2 - mean**2, 0.0)))
        present = np.flatnonzero(masses)
        low, high = SEPARATE_LIMITS_M[present[0]], SEPARATE_LIMITS_M[present[-1] + 1]
        if present.size == 1:
            raise invalid(
                "interpretation.size_distribution", "single",
                "'separates' for a texture of one separate alone",
                "its standard deviation would be zero",
            )  # fmt: skip
        return SoilSizeDistribution((TruncatedLogNormal(low, high, 1.0, mean, sd),))
    score = [NormalDist().inv_cdf(c) for c in cumulative]
    x = np.log(SEPARATE_LIMITS_M)
    separates = []
    for i, mass in enumerate((clay, silt, sand)):
        if mass > 0.0 and score[i + 1] > score[i]:
            sd = (x[i + 1] - x[i]) / (score[i + 1] - score[i])
            mean = x[i] - sd * score[i]
            separates.append(
                TruncatedLogNormal(
                    SEPARATE_LIMITS_M[i], SEPARATE_LIMITS_M[i + 1], mass, float(mean), float(sd)
                )
            )
    total = sum(s.mass_fraction for s in separates)
    return SoilSizeDistribution(
        tuple(replace(s, mass_fraction=s.mass_fraction / total) for s in separates)
    )


# --------------------------------------------------------------------------------------------------
# Distribution of the water in wet sand: whole pores, narrow pores or films on the grains.
#
# SPLITS section 4.3.2 samples for every path segment whether it lies in water, with a probability
# equal to the wet fraction of the pore volume.  In a real sand, capillary pressure drains wide
# pores first (Haines 1930, J. Agric. Sci. 20, 97-116, doi:10.1017/S002185960008864X).  The first
# water collects at grain contacts and wets a much larger fraction of the grain surface than of the
# pore volume.

MAX_RELATIVE_FILM_THICKNESS = 0.05
"""Relative thickness up to which a film is treated as a flat slab."""
MAX_SERIES_SATURATION = 1e-6
"""Saturation up to which a series gives the wet fraction."""


class WaterDistribution(NamedTuple):
    """Distribution of the water in the pore space.

    Attributes
    ----------
    wet_fraction : float
        Probability that a path segment through the pores begins and ends in water.
    filled_fraction : float
        Mean length of water along such a segment, per mean length of all segments.
    relative_film_thickness : float
        Thickness of the film on every grain, per major axis.
    """

    wet_fraction: float
    filled_fraction: float
    relative_film_thickness: float


def distribute_water(
    saturation: float, porosity: float, sphericity: float, water_model: str
) -> WaterDistribution:
    """Return the distribution of the water in a sand.

    Parameters
    ----------
    saturation : float
        Volume of water per volume of pores, 0 to 1.
    porosity : float
    sphericity : float
        Mean sphericity of the grains.
    water_model : {"whole_pores", "narrow_pores", "film"}
        Path segments wet at random by volume; all segments shorter than a threshold wet; or films
        on the grains up to `MAX_RELATIVE_FILM_THICKNESS`, with the rest in whole pores.
    """
    if water_model == "narrow_pores" and saturation > 0.0:
        wet_fraction = narrow_pore_fraction(saturation)
        return WaterDistribution(wet_fraction, saturation / wet_fraction, 0.0)
    if water_model == "film":
        # Thin film: its volume is surface area times thickness.
        per_thickness = float(surface_to_volume_ratio(sphericity)) * (1.0 - porosity) / porosity
        film_thickness = min(saturation / per_thickness, MAX_RELATIVE_FILM_THICKNESS)
        free_fraction = max(1.0 - film_thickness * per_thickness, 0.0)
        if free_fraction == 0.0:
            return WaterDistribution(0.0, 1.0, film_thickness)
        # The remaining water fills whole pores of the space left by the films.
        return WaterDistribution(
            max(1.0 - (1.0 - saturation) / free_fraction, 0.0), free_fraction, film_thickness
        )
    return WaterDistribution(saturation, 1.0, 0.0)


def narrow_pore_fraction(saturation: float) -> float:
    """Return the fraction of path segments that are wet if water fills the shortest ones.

    Segment lengths are exponential.  Segments shorter than x mean lengths make up a fraction
    f = 1 − e⁻ˣ of all segments and a fraction S = 1 − (1 + x) e⁻ˣ of their total length, which is
    the saturation.

    Parameters
    ----------
    saturation : float
        Saturation S, 0 to 1.

    Returns
    -------
    float
        Fraction f; about √(2 S) for small S, 1 at S = 1.

    Examples
    --------
    >>> [round(narrow_pore_fraction(s), 3) for s in (0.0, 0.1, 0.5, 1.0)]
    [0.0, 0.412, 0.813, 1.0]
    """
    if saturation >= 1.0:
        return 1.0
    # For small S, x = √(2S) + 2S/3; otherwise Newton's method, from above where S is concave.
    x = math.sqrt(2.0 * saturation) + 2.0 * saturation / 3.0
    if saturation > MAX_SERIES_SATURATION:
        x = max(x, -math.log1p(-saturation))
        # About ten steps suffice close to full saturation.
        for _ in range(40):
            dry_fraction = math.exp(-x)
            x += (saturation - 1.0 + (1.0 + x) * dry_fraction) / (x * dry_fraction)
    return -math.expm1(-x)


# --------------------------------------------------------------------------------------------------
# Composition of sand: particle types by volume from mineral concentrations by mass.

IRON_OXIDES = ("hematite", "goethite")


@dataclass(frozen=True, eq=False)
class ParticleType(ContentEquality):
    """Particle type: a row of SPLITS Tables 3 and 4.

    Attributes
    ----------
    name : str
    mass_fraction : float
        μ_j, mass of these particles per mass of all particles.
    mineral_mass_fractions : mapping
        ϑ_jℓ, mass of each mineral per mass of the particle.
    """

    name: str
    mass_fraction: float
    mineral_mass_fractions: Mapping[str, float]

    @property
    def density_kg_m3(self) -> float:
        """Density of the particle, γ_j (kg/m³), Eq 15."""
        return 1.0 / sum(
            c / MINERAL_DENSITY_KG_M3[mineral] for mineral, c in self.mineral_mass_fractions.items()
        )

    @property
    def mineral_volume_fractions(self) -> dict[str, float]:
        """Volume of each mineral per volume of the particle, v_jℓ, Eq 17."""
        return {
            mineral: self.density_kg_m3 / MINERAL_DENSITY_KG_M3[mineral] * c
            for mineral, c in self.mineral_mass_fractions.items()
        }

    @property
    def iron_oxide(self) -> str | None:
        """Iron oxide mixed into the particle or into its coating, or None."""
        oxides = [m for m in IRON_OXIDES if m in self.mineral_mass_fractions]
        return oxides[0] if oxides and len(self.mineral_mass_fractions) > 1 else None

    @property
    def is_coated(self) -> bool:
        """Whether a coating of kaolinite and iron oxide surrounds a core of quartz."""
        return "kaolinite" in self.mineral_mass_fractions

    @property
    def shell_materials(self) -> tuple[str, ...]:
        """Materials of the shells, from the outside in."""
        if self.is_coated:
            coating = f"kaolinite with {self.iron_oxide}" if self.iron_oxide else "kaolinite"
            return coating, "quartz"
        if self.iron_oxide:
            return (f"quartz with {self.iron_oxide}",)
        return (next(iter(self.mineral_mass_fractions)),)

    @property
    def inclusion_fraction(self) -> float:
        """Volume of iron oxide per volume of the mixture that contains it (section 4.2.5)."""
        if self.iron_oxide is None:
            return 0.0
        matrix = "kaolinite" if self.is_coated else "quartz"
        volumes = self.mineral_volume_fractions
        return volumes[self.iron_oxide] / (volumes[self.iron_oxide] + volumes[matrix])


@dataclass(frozen=True)
class SandComposition:
    """Particle types of non-zero mass, with the properties of the mixture.

    Attributes
    ----------
    particle_types : tuple of ParticleType
    coating_fraction : float
        v_coat, volume of the coating per volume of a coated particle.
    """

    particle_types: tuple[ParticleType, ...]
    coating_fraction: float

    @property
    def density_kg_m3(self) -> float:
        """Mean density of the particles, γ (kg/m³), Eq 16."""
        return 1.0 / sum(t.mass_fraction / t.density_kg_m3 for t in self.particle_types)

    @property
    def volume_fractions(self) -> tuple[float, ...]:
        """Volume of each type per volume of all particles, v_j, Eq 18."""
        return tuple(
            self.density_kg_m3 / t.density_kg_m3 * t.mass_fraction for t in self.particle_types
        )

    def to_rows(self) -> list[dict[str, float | str]]:
        """Return a table of all intermediate quantities, one row per type."""
        return [
            {
                "particle_type": t.name,
                "mass_fraction": t.mass_fraction,
                "density_kg_m3": t.density_kg_m3,
                "volume_fraction": v,
                **{
                    f"mass_{m}": t.mineral_mass_fractions.get(m, 0.0) for m in MINERAL_DENSITY_KG_M3
                },
                **{
                    f"volume_{m}": t.mineral_volume_fractions.get(m, 0.0)
                    for m in MINERAL_DENSITY_KG_M3
                },
                "inclusion_fraction": t.inclusion_fraction,
                "coating_fraction": self.coating_fraction if t.is_coated else 0.0,
            }
            for t, v in zip(self.particle_types, self.volume_fractions, strict=True)
        ]


def compute_coating_fraction(sphericity: float, relative_thickness: float) -> float:
    """Return v_coat, volume of the coating per volume of the coated particle (Eqs 12-14).

    Parameters
    ----------
    sphericity : float
        Mean Riley sphericity, in (0, 1].
    relative_thickness : float
        h' = h/s, thickness per major axis.
    """
    volume_ratio = float(surface_to_volume_ratio(sphericity)) * relative_thickness
    return volume_ratio / (1.0 + volume_ratio)


def compute_coated_concentrations(
    oxide: str, iron_oxide: float, coating_fraction: float
) -> dict[str, float]:
    """Return the mass concentrations in quartz coated by iron oxide in kaolinite.

    The mass of kaolinite follows from the volume of the coating (Eqs 10-11).

    Parameters
    ----------
    oxide : {"hematite", "goethite"}
    iron_oxide : float
        Mass of the oxide per mass of the particle.
    coating_fraction : float
        Volume of the coating per volume of the particle.

    Raises
    ------
    ValueError
        If the coating is too thin to hold that much iron oxide.
    """
    quartz, kaolinite = MINERAL_DENSITY_KG_M3["quartz"], MINERAL_DENSITY_KG_M3["kaolinite"]
    iron = MINERAL_DENSITY_KG_M3[oxide]
    core = quartz * (1.0 - coating_fraction)
    limit = iron * coating_fraction / (iron * coating_fraction + core)
    # Rounding may make the remaining room of a full coating slightly negative.
    remaining_mass = max(iron * coating_fraction * (1.0 - iron_oxide) - core * iron_oxide, 0.0)
    if iron_oxide > limit * (1.0 + ROUNDING_TOLERANCE):
        raise invalid(
            "iron_oxide",
            iron_oxide,
            f"at most {np.floor(1e4 * limit) / 1e4:g}, what a coating of {oxide} can hold",
            "a thicker coating holds more: relative_coating_thickness; or set partition (coated) 0",
        )
    matrix = kaolinite / iron * remaining_mass / (core + kaolinite * coating_fraction)
    concentrations = {"quartz": 1.0 - iron_oxide - matrix, oxide: iron_oxide, "kaolinite": matrix}
    return {
        mineral: c for mineral, c in concentrations.items() if c > 0.0 or mineral == "kaolinite"
    }


def make_composition(
    iron_oxide: float,
    hematite_ratio: float,
    magnetite: float,
    partition: tuple[float, ...],
    coating_fraction: float,
    excess_magnetite: str = "first",
) -> SandComposition:
    """Return the particle types of a sand.

    Parameters
    ----------
    iron_oxide : float
        ϑ_hg, mass of hematite and goethite per mass of sand, 0 to 1; also their concentration
        in every mixed and coated particle.
    hematite_ratio : float
        r_hg, mass fraction of hematite in the iron oxide, 0 to 1.
    magnetite : float
        ϑ_m, mass of magnetite per mass of sand; iron_oxide + magnetite at most 1.
    partition : (pure, mixed, coated)
        Mass fractions μ'_p, μ'_m, μ'_c; they add up to 1.
    coating_fraction : float
        v_coat, see `compute_coating_fraction`.
    excess_magnetite : {"first", "clipped"}
        Rule for magnetite and pure iron oxides that exceed the fraction of pure particles.  With
        "first" they keep their mass, pure quartz is 0, and the mixed and coated particles are
        scaled to the remaining mass.  With "clipped" pure quartz is 0 and all mass fractions are
        divided by their sum.

    Raises
    ------
    ValueError
        For a partition that does not add up to 1, or too much iron oxide for coatings.
    """
    pure, mixed, coated = partition
    if min(pure, mixed, coated) < 0.0 or abs(pure + mixed + coated - 1.0) > 2e-9:
        raise invalid(
            "partition", partition, "three numbers of at least 0 that add up to 1",
            f"these make {pure + mixed + coated:.10g}; YAML has no 1/3, write 0.3333333333",
        )  # fmt: skip
    oxide_fractions = {"hematite": hematite_ratio, "goethite": 1.0 - hematite_ratio}
    iron = iron_oxide * pure  # Eq 8
    quartz = pure - magnetite - iron  # Eq 9
    scale = 1.0
    if quartz < 0.0:
        if excess_magnetite == "first":
            impure = mixed + coated
            scale = max(1.0 - magnetite - iron, 0.0) / impure if impure > 0.0 else 1.0
        quartz = 0.0
    mass = {"pure quartz": quartz, "pure magnetite": magnetite}
    concentration = {"pure quartz": {"quartz": 1.0}, "pure magnetite": {"magnetite": 1.0}}
    for oxide, fraction in oxide_fractions.items():
        mass[f"pure {oxide}"] = fraction * iron
        concentration[f"pure {oxide}"] = {oxide: 1.0}
        mass[f"quartz mixed with {oxide}"] = fraction * mixed * scale
        minerals = {"quartz": 1.0 - iron_oxide, oxide: iron_oxide}
        concentration[f"quartz mixed with {oxide}"] = {m: c for m, c in minerals.items() if c > 0.0}
        mass[f"quartz coated by {oxide}"] = fraction * coated * scale
        if fraction * coated > 0.0:
            minerals = compute_coated_concentrations(oxide, iron_oxide, coating_fraction)
            concentration[f"quartz coated by {oxide}"] = minerals
    total = sum(mass.values())
    types = (
        ParticleType(name, m / total, concentration[name]) for name, m in mass.items() if m > 0.0
    )
    return SandComposition(tuple(types), coating_fraction)
