"""Sand: defaults, derived quantities, refractive indices and errors."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import splits
from splits import Sand, SandInterpretation
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.materials import make_refractive_index
from splits.media.grain_statistics import surface_to_volume_ratio
from splits.media.interpretations import INTERPRETATION_CHOICES
from splits.media.kinds import read_named_medium
from splits.simulation.spectral_nodes import select_grain_interfaces

ORDER = "min <= mean <= max <= 1"
INTERPRETATIONS = list(SandInterpretation.__dataclass_fields__)
EIGHT_TYPES = {
    "iron_oxide": 0.03,
    "hematite_ratio": 0.4,
    "magnetite": 0.05,
    "partition": (0.4, 0.35, 0.25),
}
MATERIALS = ("air", "water", "quartz", "magnetite", *(
    f"{prefix}{oxide}" for oxide in ("hematite", "goethite")
    for prefix in ("", "quartz with ", "kaolinite with ")
))  # fmt: skip
WAVELENGTHS = np.array([450.0, 600.0, 900.0])
TABLE = {"wavelength_nm": [400, 1000], "n": [2.4, 2.2], "k": [0.1, 0.01]}
INVALID_SANDS = [
    ("iron_oxide", -0.01, "[0, 1]"),
    ("iron_oxide", 0.06, "at most 0.0536, what a coating of goethite can hold"),
    ("iron_oxide", "1e-2", "[0, 1]"),
    ("hematite_ratio", 1.1, "[0, 1]"),
    ("magnetite", 0.995, "[0, 0.99]"),
    ("partition", (0.5, 0.5, 0.5), "three numbers of at least 0 that add up to 1"),
    ("partition", (1.2, -0.2, 0.0), "three numbers of at least 0 that add up to 1"),
    ("texture", (0.0, 0.3, 0.7), "silt + 1.5 clay at most 0.15"),
    ("texture", (0.0, 0.1, 0.8), "three fractions (clay, silt, sand) that add up to 1"),
    ("saturation", 1.2, "[0, 1]"),
    ("porosity", 1.0, "(0, 1)"),
    ("roundness", (0.5,), "2 numbers (mean, sd)"),
    ("sphericity", (0.05, 0.9, 0.8, 0.1), f"0.1 <= {ORDER}"),
    ("sphericity", (0.9, 0.6, 0.8, 0.1), f"0.1 <= {ORDER}"),
    ("relative_coating_thickness", 0.0, "(0, 0.05]"),
    ("relative_coating_thickness", 0.06, "(0, 0.05]"),
    ("depth_m", -1.0, "(0, 10000]"),
    ("size_tail", 0.1, "[1e-06, 0.01]"),
    ("refractive_index", 1.55, "mapping"),
    ("interpretation", "linear", "must be one of geometric"),
]


class UnusedIndex:
    """Refractive index that must not be evaluated."""

    name = "unused"
    source = "nowhere"

    def __call__(self, _wavelength_nm):
        raise AssertionError("unused index evaluated")


def test_defaults_are_the_shipped_base_case():
    shipped = read_named_medium("splits_base")
    assert shipped.pop("kind") == Sand.kind
    # The base case of Fig 8 except for its texture, with the constants of Table 2.
    assert shipped.pop("texture") == [0, 0.1, 0.9]
    assert shipped.pop("partition") == pytest.approx(Sand.partition, abs=1e-15)
    assert Sand(**shipped).describe() == Sand().describe()
    table2 = {"porosity": 0.425, "depth_m": 1.0, "saturation": 0.0, "roundness": (0.482, 0.072)}
    assert table2.items() <= Sand().describe().items()
    assert Sand().sphericity[2:] == (0.798, 0.064)
    assert Sand().relative_coating_thickness == pytest.approx(5e-6 / 1.2e-3, rel=1e-15)


@pytest.mark.parametrize("sample", ["10019201", "10039240", "13j9823", "19au9815"])
def test_samples_of_table_5_are_accepted(sample):
    sand = splits.load_medium(f"tec_{sample}")
    assert 2650.0 < sand.density_kg_m3 < 3000.0
    assert sum(sand.composition.volume_fractions) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize(("key", "value", "allowed"), INVALID_SANDS)
def test_invalid_values_are_rejected_with_key_and_range(key, value, allowed):
    with pytest.raises(ValueError, match=f"^{key}") as error:
        Sand(**{key: value})
    assert repr(value) in str(error.value)
    assert allowed in str(error.value)


@pytest.mark.parametrize(
    ("key", "value", "component"),
    [
        ("roundness", (1.1, 0.1), "mean"),
        ("roundness", (0.5, -0.1), "sd"),
        ("sphericity", (0.6, 0.9, 0.8, -0.1), "sd"),
    ],
)
def test_invalid_means_and_deviations_are_rejected(key, value, component):
    with pytest.raises(ValueError, match=rf"^{key} \({component}\) = .*: must be in \[0, 1\]"):
        Sand(**{key: value})


def test_unknown_keywords_materials_and_choices_are_rejected():
    with pytest.raises(TypeError, match="porositi"):
        Sand(porositi=0.4)
    with pytest.raises(ValueError, match=r"refractive_index = 'geothite'.*did you mean goethite"):
        Sand(refractive_index={"geothite": 2.3})
    with pytest.raises(ValueError, match=r"interpretation = 'size_definition'"):
        Sand(interpretation={"size_definition": "diameter"})


@pytest.mark.parametrize("name", INTERPRETATIONS)
def test_choices_are_checked_and_the_first_is_the_default(name):
    assert getattr(SandInterpretation(), name) == INTERPRETATION_CHOICES[name][0]
    with pytest.raises(ValueError, match=f"interpretation.{name} = 'neither'"):
        Sand(interpretation={name: "neither"})


def test_materials_are_listed_in_the_order_of_types():
    assert Sand(**EIGHT_TYPES).list_materials() == MATERIALS
    plain = Sand(iron_oxide=0.0, partition=(0.2, 0.3, 0.5))
    assert plain.list_materials() == ("air", "water", "quartz", "kaolinite")
    grains = Sand(**EIGHT_TYPES).make_grain_population()
    rows = zip(grains.types.material, grains.types.n_shells, strict=True)
    layers = [tuple(MATERIALS[m] for m in row[:n]) for row, n in rows]
    iron = [
        [(oxide,), (f"quartz with {oxide}",), (f"kaolinite with {oxide}", "quartz")]
        for oxide in ("hematite", "goethite")
    ]
    assert layers == [("quartz",), ("magnetite",), *iron[0], *iron[1]]
    coated = grains.types.n_shells == 2
    assert (grains.types.coating_thickness[coated, 0] == 5.0 / 1200.0).all()
    assert (grains.types.coating_thickness[~coated] == 0.0).all() and (
        grains.types.coating_thickness[:, 1] == 0.0
    ).all()


def test_refractive_indices_match_hand_calculations():
    """Eq 4 with volume fractions from the balance of volumes in each particle."""
    sand = Sand(**EIGHT_TYPES, saturation=0.1)
    index = dict(zip(MATERIALS, sand.compute_refractive_indices(WAVELENGTHS).T, strict=True))
    pure = {m: make_refractive_index(m)(WAVELENGTHS) for m in ("quartz", "hematite", "goethite")}
    np.testing.assert_array_equal(index["air"], 1.0)
    np.testing.assert_array_equal(index["water"], make_refractive_index("water")(WAVELENGTHS))
    np.testing.assert_array_equal(
        index["magnetite"], make_refractive_index("magnetite")(WAVELENGTHS)
    )
    for mineral, values in pure.items():
        np.testing.assert_array_equal(index[mineral], values)
    coating_fraction = 0.0337371413100692
    for oxide, density in (("hematite", 5250.0), ("goethite", 4300.0)):
        mixed = 0.03 / density / (0.03 / density + 0.97 / 2650.0)
        # In a coating of volume c per core of volume 1 − c: oxide from its mass, clay for the rest.
        clay = coating_fraction * 0.97 / 2650.0 - 0.03 * (1.0 - coating_fraction) / density
        clay /= (1.0 - coating_fraction) / 2590.0 + coating_fraction / 2650.0
        coating = 0.03 / density / (0.03 / density + clay / 2590.0)
        for matrix, em, v in (
            ("quartz", pure["quartz"] ** 2, mixed),
            ("kaolinite", (1.56 + 5e-4j) ** 2, coating),
        ):
            beta = (pure[oxide] ** 2 - em) / (pure[oxide] ** 2 + 2.0 * em)
            epsilon = em * (1.0 + 3.0 * v * beta / (1.0 - v * beta))
            actual = index[f"{matrix} with {oxide}"]
            np.testing.assert_allclose(actual**2, epsilon, rtol=1e-12)
            assert (actual.imag > 0.0).all()


def test_unused_indices_are_not_evaluated():
    dry = Sand(saturation=0.0, refractive_index={"water": UnusedIndex()})
    assert (dry.compute_refractive_indices(WAVELENGTHS)[:, 1] == 1.0).all()
    with pytest.raises(AssertionError, match="unused index evaluated"):
        Sand(saturation=0.01, refractive_index={"water": UnusedIndex()}).compute_refractive_indices(
            WAVELENGTHS
        )
    # Indices of absent minerals are not evaluated either.
    absent = dict.fromkeys(("magnetite", "hematite"), UnusedIndex())
    assert np.isfinite(Sand(refractive_index=absent).compute_refractive_indices(WAVELENGTHS)).all()


@pytest.mark.parametrize("goethite", [{"k_factor": 0.5}, 2.3 + 0.05j, TABLE], ids=str)
def test_goethite_index_affects_goethite_materials_only(goethite):
    before = Sand(**EIGHT_TYPES).compute_refractive_indices(WAVELENGTHS)
    sand = Sand(**EIGHT_TYPES, refractive_index={"goethite": goethite})
    changed = (sand.compute_refractive_indices(WAVELENGTHS) != before).all(axis=0)
    assert [m for m, c in zip(MATERIALS, changed, strict=True) if c] == [
        m for m in MATERIALS if "goethite" in m
    ]
    assert ((sand.compute_refractive_indices(WAVELENGTHS) != before).any(axis=0) == changed).all()
    actual = sand.compute_refractive_indices(WAVELENGTHS)[:, MATERIALS.index("goethite")]
    np.testing.assert_array_equal(actual, make_refractive_index("goethite", goethite)(WAVELENGTHS))


def test_description_is_saved_and_loaded(tmp_path):
    sand = Sand(**EIGHT_TYPES, refractive_index={"goethite": {"k_factor": 2}, "water": 1.33})
    attributes = sand.describe()
    inputs = set(Sand.__dataclass_fields__) - {"refractive_index", "interpretation", "pores"}
    assert inputs | {f"interpretation_{name}" for name in INTERPRETATIONS} <= set(attributes)
    assert attributes["refractive_index_goethite"] == "oscillators, k x 2"
    assert attributes["refractive_index_water"] == "1.33+0j"
    assert (
        len(attributes["particle_types"].split(", "))
        == len(attributes["particle_volume_fractions"])
        == 8
    )
    path = tmp_path / "sand.nc"
    splits.save(
        xr.Dataset({"x": 1.0}, attrs=to_netcdf_attributes({**attributes, **make_provenance()})),
        path,
    )
    loaded = splits.load(path).attrs
    for key, value in attributes.items():
        if isinstance(value, str):
            assert loaded[key] == value
        else:
            np.testing.assert_array_equal(loaded[key], value)


def test_mean_grain_distance_of_spheres():
    """The distance is 1/((1 − P) K1 K2), with K1 from the table of sizes."""
    spheres = {"texture": (0, 0, 1), "sphericity": (1, 1, 1, 0), "porosity": 0.4}
    sand = Sand(**spheres)
    k1 = sand.size_distribution.size_attenuation_per_m
    assert sand.attenuation_per_m == pytest.approx(1.5 * k1, rel=1e-12)
    assert sand.mean_grain_distance_m == pytest.approx(1.0 / (0.6 * 1.5 * k1), rel=1e-12)
    printed = Sand(**spheres, interpretation={"attenuation_factor": "as_printed"})
    assert printed.mean_grain_distance_m == pytest.approx(1.0 / (1.5 * k1), rel=1e-12)
    assert 1.0 / sand.make_grain_population().collision_coefficient == pytest.approx(
        sand.mean_grain_distance_m, rel=1e-15
    )
    # Surface per mass of spheres: 6 per diameter and volume.
    assert sand.specific_surface_area_m2_kg == pytest.approx(6.0 * k1 / sand.density_kg_m3)
    one_shape = Sand(sphericity=(0.8, 0.8, 0.8, 0.1))
    k2 = float(surface_to_volume_ratio(0.8)) / 4.0
    assert one_shape.attenuation_per_m == pytest.approx(
        k2 * one_shape.size_distribution.size_attenuation_per_m, rel=1e-12
    )


def test_interface_fractions_add_up():
    sand = Sand(**EIGHT_TYPES, saturation=0.3)
    volumes = {row["particle_type"]: row["volume_fraction"] for row in sand.composition.to_rows()}
    outer = [i for i in select_grain_interfaces(sand.list_interfaces()) if i.outer_material < 2]
    assert sum(i.fraction for i in outer if i.outer_material == 1) == pytest.approx(0.3)
    assert sum(i.fraction for i in outer) == pytest.approx(1.0)
    (boundary,) = [
        i
        for i in sand.list_interfaces()
        if i not in select_grain_interfaces(sand.list_interfaces())
    ]
    assert boundary[:3] == (pytest.approx(0.3), 0, 1)
    inner = {
        (MATERIALS[i.outer_material], MATERIALS[i.inner_material]): i.fraction
        for i in sand.list_interfaces()
        if i.outer_material > 1
    }
    assert inner == {
        (f"kaolinite with {oxide}", "quartz"): volumes[f"quartz coated by {oxide}"]
        for oxide in ("hematite", "goethite")
    }


def test_sand_is_immutable():
    sand = Sand()
    with pytest.raises(AttributeError):
        sand.porosity = 0.5
