"""Composition of sand: particle types by volume from mineral concentrations by mass.

SPLITS sections 4.2.4-4.2.5, Tables 3-4 and Eqs 5-18.  Quartz, hematite, goethite and magnetite
are distributed among eight types of particle: pure minerals, quartz mixed with an iron oxide, and
quartz coated by an iron oxide in a kaolinite matrix.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from splits.core.arrays import check_named_numbers
from splits.core.equality import ContentEquality
from splits.core.validation import ROUNDING_TOLERANCE, check_range, invalid
from splits.materials import MINERAL_DENSITY_KG_M3
from splits.media.grain_statistics import surface_to_volume_ratio

IRON_OXIDES = ("hematite", "goethite")
EXCESS_MAGNETITE_RULES = ("first", "clipped")
"""Rules for more magnetite than the fraction of pure particles (Eq 9 turns negative)."""


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
    partition: tuple[float, float, float],
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
        For a value outside its range.
    """
    iron_oxide = check_range("iron_oxide", iron_oxide, 0.0, 1.0)
    ratio = check_range("hematite_ratio", hematite_ratio, 0.0, 1.0)
    magnetite = check_range(
        "magnetite", magnetite, 0.0, 1.0 - iron_oxide, hint="the sum of all mass fractions is 1"
    )
    kinds = ("pure", "mixed", "coated")
    pure, mixed, coated = check_named_numbers("partition", partition, kinds, (0.0, 1.0))
    if min(pure, mixed, coated) < 0.0 or abs(pure + mixed + coated - 1.0) > 2e-9:
        raise invalid(
            "partition", partition, "three numbers of at least 0 that add up to 1",
            f"these make {pure + mixed + coated:.10g}; YAML has no 1/3, write 0.3333333333",
        )  # fmt: skip
    oxide_fractions = {"hematite": ratio, "goethite": 1.0 - ratio}
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
