"""Composition of sand: SPLITS Tables 3-4 and Eqs 5-18, computed by hand."""

import math
import re

import numpy as np
import pytest

from splits import Sand
from splits.media.sand_composition import (
    compute_coated_concentrations,
    compute_coating_fraction,
    make_composition,
)

# Table 2, written out again: kg/m³ of quartz, hematite, goethite, magnetite and kaolinite.
Q, H, G, M, K = 2650.0, 5250.0, 4300.0, 5200.0, 2590.0
DENSITY = {"quartz": Q, "hematite": H, "goethite": G, "magnetite": M, "kaolinite": K}
COATING = 0.03373714131006917  # Eqs 13-14 at Ψ = 0.798, h' = 5/1200
LIMIT = {"hematite": 0.06469624868642761, "goethite": 0.05361699945633398}

# Name: mass fraction (Table 3), particle density (Eq 15), volume fraction (Eq 18), volume of the
# oxide per volume of its mixture (4.2.5).  The kaolinite of the coated ones follows below.
TEC_10039240 = {
    "pure quartz": (0.475, Q, 0.48525840222675, 0.0),
    "pure hematite": (0.008975, H, 0.004628075999583, 0.0),
    "pure goethite": (0.016025, G, 0.010089157710434, 0.0),
    "quartz coated by hematite": (0.1795, 2716.80140716970, 0.178867685607716, 0.766938101782187),
    "quartz coated by goethite": (0.3205, 2701.69553150836, 0.321156678455516, 0.931171495270958),
}
TEC_13J9823 = {
    "pure magnetite": (0.17, M, 0.094891215154932, 0.0),
    "quartz mixed with hematite": (0.41334, 2663.18912710567, 0.450490727692912, 0.005072741194487),
    "quartz mixed with goethite": (0.41666, 2660.20777401658, 0.454618057152156, 0.006186529707015),
}
SAMPLES = {
    "10039240": ((0.05, 0.359, 0.0, (0.5, 0.0, 0.5)), TEC_10039240, 2707.2310861071),
    "13j9823": ((0.01, 0.498, 0.17, (0.0, 1.0, 0.0)), TEC_13J9823, 2902.5548165038),
}
OTHER_SAMPLES = {
    "all eight types": (0.03, 0.3, 0.05, (0.4, 0.35, 0.25)),
    "no goethite": (0.03, 1.0, 0.05, (0.4, 0.35, 0.25)),
    "no hematite": (0.03, 0.0, 0.05, (0.4, 0.35, 0.25)),
    "no iron oxide": (0.0, 0.3, 0.05, (0.4, 0.35, 0.25)),
}
CASES = {**{name: case[0] for name, case in SAMPLES.items()}, **OTHER_SAMPLES}


def compute_mineral_masses(composition):
    """Return the mass of every mineral per mass of sand."""
    return {
        m: math.fsum(
            t.mass_fraction * t.mineral_mass_fractions.get(m, 0.0)
            for t in composition.particle_types
        )
        for m in DENSITY
    }


def test_coating_fraction_matches_the_spheroid_area():
    e = math.sqrt(1.0 - 0.798**4)
    per_volume = 3.0 * (1.0 + math.asin(e) / (0.798**2 * e))
    assert per_volume == pytest.approx(8.37961828046923, rel=1e-14)
    layer = per_volume * 5.0 / 1200.0
    assert compute_coating_fraction(0.798, 5.0 / 1200.0) == pytest.approx(
        layer / (1.0 + layer), rel=1e-14
    )
    assert compute_coating_fraction(0.798, 5.0 / 1200.0) == pytest.approx(COATING, rel=1e-14)
    # A sphere has a surface area of 6 per volume and diameter.
    assert compute_coating_fraction(1.0, 0.01) == pytest.approx(0.06 / 1.06, rel=1e-14)


@pytest.mark.parametrize("sample", SAMPLES)
def test_table_5_samples_match_hand_calculations(sample):
    arguments, expected, density = SAMPLES[sample]
    composition = make_composition(*arguments, COATING)
    assert {t.name for t in composition.particle_types} == set(expected)
    assert composition.density_kg_m3 == pytest.approx(density, rel=1e-12)
    for particle, volume in zip(
        composition.particle_types, composition.volume_fractions, strict=True
    ):
        mass, gamma, volume_fraction, inclusions = expected[particle.name]
        assert particle.mass_fraction == pytest.approx(mass, rel=1e-12)
        assert particle.density_kg_m3 == pytest.approx(gamma, rel=1e-12)
        assert volume == pytest.approx(volume_fraction, rel=1e-12)
        assert particle.inclusion_fraction == pytest.approx(inclusions, rel=1e-12)


@pytest.mark.parametrize("case", CASES)
def test_fractions_add_up_and_densities_are_bounded(case):
    composition = make_composition(*CASES[case], COATING)
    assert math.fsum(t.mass_fraction for t in composition.particle_types) == pytest.approx(
        1.0, abs=1e-14
    )
    assert math.fsum(composition.volume_fractions) == pytest.approx(1.0, abs=1e-14)
    for particle in composition.particle_types:
        assert particle.mass_fraction > 0.0
        assert sum(particle.mineral_mass_fractions.values()) == pytest.approx(1.0, abs=1e-14)
        assert sum(particle.mineral_volume_fractions.values()) == pytest.approx(1.0, abs=1e-14)
        mineral_densities = [DENSITY[m] for m in particle.mineral_mass_fractions]
        assert (
            min(mineral_densities) * (1 - 1e-14)
            <= particle.density_kg_m3
            <= max(mineral_densities) * (1 + 1e-14)
        )
    densities = [t.density_kg_m3 for t in composition.particle_types]
    assert min(densities) < composition.density_kg_m3 < max(densities)


@pytest.mark.parametrize("case", [name for name in CASES if name != "13j9823"])
def test_every_mineral_has_the_given_mass(case):
    """Eqs 8-9 have a solution if magnetite does not exceed the pure fraction."""
    iron, ratio, magnetite, _ = CASES[case]
    masses = compute_mineral_masses(make_composition(*CASES[case], COATING))
    assert masses["hematite"] == pytest.approx(ratio * iron, abs=1e-15)
    assert masses["goethite"] == pytest.approx((1.0 - ratio) * iron, abs=1e-15)
    assert masses["magnetite"] == pytest.approx(magnetite, abs=1e-15)


@pytest.mark.parametrize("oxide", LIMIT)
@pytest.mark.parametrize("iron", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("coating", [COATING, 0.2])
def test_kaolinite_fills_the_coating(oxide, iron, coating):
    """Eqs 10-11 as a balance of volumes: the coating has its fraction of the particle."""
    concentrations = compute_coated_concentrations(oxide, iron, coating)
    clay = (coating * (1 - iron) / Q - iron * (1 - coating) / DENSITY[oxide]) / (
        (1 - coating) / K + coating / Q
    )
    assert concentrations["kaolinite"] == pytest.approx(clay, rel=1e-12)
    assert concentrations.get(oxide, 0.0) == iron and (oxide in concentrations) == (iron > 0.0)
    volume = {m: c / DENSITY[m] for m, c in concentrations.items()}
    layer = volume["kaolinite"] + volume.get(oxide, 0.0)
    assert layer / sum(volume.values()) == pytest.approx(coating, rel=1e-12)


@pytest.mark.parametrize(("oxide", "printed"), [("hematite", "0.0647"), ("goethite", "0.0536")])
def test_iron_oxide_above_the_coating_capacity_is_rejected(oxide, printed):
    assert (
        compute_coated_concentrations(oxide, LIMIT[oxide] * (1 - 1e-12), COATING)["kaolinite"]
        >= 0.0
    )
    excessive = LIMIT[oxide] * 1.001
    ratio = 1.0 if oxide == "hematite" else 0.0
    with pytest.raises(ValueError, match=r"^iron_oxide = ") as error:
        make_composition(excessive, ratio, 0.0, (0.5, 0.0, 0.5), COATING)
    for text in (repr(excessive), printed, oxide, "relative_coating_thickness", "partition"):
        assert text in str(error.value)
    # Without coated particles, or without that oxide, there is no limit.
    make_composition(excessive, ratio, 0.0, (0.5, 0.5, 0.0), COATING)
    if oxide == "goethite":
        make_composition(excessive, 1.0, 0.0, (0.5, 0.0, 0.5), COATING)


@pytest.mark.parametrize("oxide", LIMIT)
def test_the_limit_named_in_the_error_is_accepted(oxide):
    with pytest.raises(ValueError) as error:
        compute_coated_concentrations(oxide, 0.5, COATING)
    limit = float(re.search(r"at most ([\d.]+)", str(error.value))[1])
    assert compute_coated_concentrations(oxide, limit, COATING)["kaolinite"] >= 0.0


@pytest.mark.parametrize("oxide", LIMIT)
def test_a_full_coating_has_no_kaolinite(oxide):
    core, iron = Q * (1.0 - COATING), DENSITY[oxide] * COATING
    concentrations = compute_coated_concentrations(oxide, iron / (iron + core), COATING)
    assert concentrations["kaolinite"] == pytest.approx(0.0, abs=1e-15)
    ratio = 1.0 if oxide == "hematite" else 0.0
    composition = make_composition(iron / (iron + core), ratio, 0.0, (0.0, 0.0, 1.0), COATING)
    (particle,) = composition.particle_types
    assert particle.is_coated and particle.iron_oxide == oxide
    assert particle.inclusion_fraction == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"partition": (0.5, 0.2, 0.2)}, r"^partition = \(0.5, 0.2, 0.2\): .*add up to 1"),
        ({"partition": (0.5, 0.6, -0.1)}, r"^partition = \(0.5, 0.6, -0.1\): .*at least 0"),
        ({"partition": (0.5, 0.5)}, r"^partition = .*3 numbers \(pure, mixed, coated\)"),
        ({"magnetite": 0.98}, r"^magnetite = 0.98: must be in \[0, 0.97\]"),
        ({"magnetite": -0.1}, r"^magnetite = -0.1: must be in \[0, 0.97\]"),
        ({"iron_oxide": 1.1}, r"^iron_oxide = 1.1: must be in \[0, 1\]"),
        ({"hematite_ratio": -0.1}, r"^hematite_ratio = -0.1: must be in \[0, 1\]"),
    ],
)
def test_impossible_sands_are_rejected(change, message):
    valid = {"iron_oxide": 0.03, "hematite_ratio": 0.3, "magnetite": 0.0, "partition": (1, 0, 0)}
    with pytest.raises(ValueError, match=message):
        Sand(**{**valid, **change})


def test_types_without_mass_are_absent():
    names = {
        case: {t.name for t in make_composition(*CASES[case], COATING).particle_types}
        for case in CASES
    }
    everything = names["all eight types"]
    assert len(everything) == 8
    assert names["no goethite"] == {n for n in everything if "goethite" not in n}
    assert names["no hematite"] == {n for n in everything if "hematite" not in n}
    assert names["no iron oxide"] == everything - {"pure hematite", "pure goethite"}
    bare = make_composition(*CASES["no iron oxide"], COATING)
    assert all(t.iron_oxide is None and t.inclusion_fraction == 0.0 for t in bare.particle_types)
    assert [t.is_coated for t in bare.particle_types].count(True) == 2
    (only,) = make_composition(0.0, 0.5, 1.0, (0.0, 0.5, 0.5), COATING).particle_types
    assert (only.name, only.mass_fraction, only.density_kg_m3) == ("pure magnetite", 1.0, M)
    assert {t.name for t in make_composition(1.0, 0.5, 0.0, (1, 0, 0), COATING).particle_types} == {
        "pure hematite",
        "pure goethite",
    }


@pytest.mark.parametrize("excess", ["first", "clipped"])
def test_magnetite_may_exceed_the_pure_fraction(excess):
    """Eq 9 reaches zero at ϑ_m = μ'_p − β_hg, where all masses are continuous."""
    partition, iron, ratio = (0.4, 0.35, 0.25), 0.03, 0.3
    limit = 0.4 - 0.4 * iron

    def compute_masses(magnetite):
        composition = make_composition(iron, ratio, magnetite, partition, COATING, excess)
        return {t.name: t.mass_fraction for t in composition.particle_types}

    below, equal, above = (compute_masses(limit + step) for step in (-1e-9, 0.0, 1e-9))
    assert below["pure quartz"] == pytest.approx(1e-9, rel=1e-6)
    for name in set(below) - {"pure quartz"}:
        assert equal[name] == pytest.approx(below[name], abs=2e-9)
        assert equal[name] == pytest.approx(above[name], abs=2e-9)
    assert equal.get("pure quartz", 0.0) < 1e-15 and "pure quartz" not in above


def test_magnetite_and_pure_oxides_have_priority():
    iron, ratio, magnetite, pure, mixed, coated = 0.03, 0.3, 0.6, 0.4, 0.35, 0.25
    composition = make_composition(iron, ratio, magnetite, (pure, mixed, coated), COATING)
    mass = {t.name: t.mass_fraction for t in composition.particle_types}
    remainder = 1.0 - magnetite - iron * pure
    assert mass["pure magnetite"] == pytest.approx(magnetite, rel=1e-14)
    assert mass["pure hematite"] == pytest.approx(ratio * iron * pure, rel=1e-14)
    assert mass["quartz mixed with goethite"] == pytest.approx(
        0.7 * remainder * mixed / 0.6, rel=1e-14
    )
    assert mass["quartz coated by hematite"] == pytest.approx(
        0.3 * remainder * coated / 0.6, rel=1e-14
    )
    clipped = make_composition(iron, ratio, magnetite, (pure, mixed, coated), COATING, "clipped")
    total = magnetite + iron * pure + mixed + coated
    mass = {t.name: t.mass_fraction for t in clipped.particle_types}
    assert mass["pure magnetite"] == pytest.approx(magnetite / total, rel=1e-14)
    assert mass["quartz mixed with goethite"] == pytest.approx(0.7 * mixed / total, rel=1e-14)


@pytest.mark.parametrize("case", CASES)
def test_the_table_of_intermediates_is_complete(case):
    composition = make_composition(*CASES[case], COATING)
    rows = composition.to_rows()
    columns = {"particle_type", "mass_fraction", "density_kg_m3", "volume_fraction"}
    columns |= {f"{kind}_{m}" for kind in ("mass", "volume") for m in DENSITY}
    columns |= {"inclusion_fraction", "coating_fraction"}
    assert [row["particle_type"] for row in rows] == [t.name for t in composition.particle_types]
    for row in rows:
        assert set(row) == columns
        mass = np.array([row[f"mass_{m}"] for m in DENSITY])
        volume = np.array([row[f"volume_{m}"] for m in DENSITY])
        assert mass.sum() == pytest.approx(1.0) and volume.sum() == pytest.approx(1.0)
        np.testing.assert_allclose(volume * list(DENSITY.values()), mass * row["density_kg_m3"])
        assert row["coating_fraction"] == (COATING if row["mass_kaolinite"] > 0.0 else 0.0)
