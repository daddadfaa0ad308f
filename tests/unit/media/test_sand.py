"""Sand: derived quantities, sizes by soil separate (SPLITS section 4.2.6), and water."""

from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from scipy import integrate

import splits
from splits import Sand, SandInterpretation
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.materials import make_refractive_index
from splits.media.grain_statistics import N_TABLE_POINTS, surface_to_volume_ratio
from splits.media.interpretations import INTERPRETATION_CHOICES
from splits.media.kinds import read_named_medium
from splits.media.sand_composition import (
    MAX_RELATIVE_FILM_THICKNESS,
    MAX_SERIES_SATURATION,
    TruncatedLogNormal,
    distribute_water,
    make_size_distribution,
    narrow_pore_fraction,
)
from splits.simulation.spectral_nodes import select_grain_interfaces

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


def test_unknown_materials_and_choices_are_rejected():
    with pytest.raises(ValueError, match=r"refractive_index = 'geothite'.*did you mean goethite"):
        Sand(refractive_index={"geothite": 2.3})
    with pytest.raises(ValueError, match=r"interpretation\.size_definition: unknown key"):
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


LIMITS = {"clay": (5e-8, 2e-6), "silt": (2e-6, 5e-5), "sand": (5e-5, 2e-3)}
TAIL = 1e-4
TEXTURES = {
    "Table 5": (0.0, 0.15, 0.85),
    "sand alone": (0.0, 0.0, 1.0),
    "all three": (0.01, 0.135, 0.855),
    "no silt": (0.1, 0.0, 0.9),
}
# Clay slightly above the tail: the log-normal is so wide that only its slope remains.
SMALL_CLAY_TEXTURES = {
    gap: (TAIL * (1.0 + gap), 0.0, 1.0 - TAIL * (1.0 + gap)) for gap in (1e-14, 1e-9, 1e-3)
}
ALL_TEXTURES = {**TEXTURES, **SMALL_CLAY_TEXTURES}


def evaluate_density(piece: TruncatedLogNormal, s):
    """Return f_g(s) of Eq 19."""
    score = (np.log(s) - piece.log_mean) / piece.log_sd
    return np.exp(-0.5 * score**2) / (piece.log_sd * np.sqrt(2.0 * np.pi))


def integrate_power(piece: TruncatedLogNormal, power: float):
    """Return ∫ s^power f_g(s) ds over the piece, by adaptive quadrature in sections."""
    edges = np.geomspace(piece.min_size_m, piece.max_size_m, 9)
    return sum(
        integrate.quad(
            lambda s: s**power * evaluate_density(piece, s), a, b, epsabs=0.0, epsrel=1e-11
        )[0]
        for a, b in pairwise(edges)
    )


@pytest.mark.parametrize("name", TEXTURES)
def test_separates_have_their_limits_and_masses(name):
    texture = TEXTURES[name]
    pieces = make_size_distribution(texture).separates
    present = [i for i, mass in enumerate(texture) if mass > 0.0]
    assert [(p.min_size_m, p.max_size_m) for p in pieces] == [
        list(LIMITS.values())[i] for i in present
    ]
    for piece, i in zip(pieces, present, strict=True):
        assert piece.mass_fraction == pytest.approx(texture[i], rel=1e-12)
    assert sum(p.mass_fraction for p in pieces) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("name", TEXTURES)
def test_mean_inverse_size_matches_eq_23(name):
    sizes = make_size_distribution(TEXTURES[name])
    expected = sum(
        p.mass_fraction * integrate_power(p, -2.0) / integrate_power(p, -1.0)
        for p in sizes.separates
    )
    assert sizes.size_attenuation_per_m == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", TEXTURES)
def test_masses_of_eq_20_match_the_texture(name):
    """Each separate has its mass between its limits; the outermost ones lack the tail."""
    texture = TEXTURES[name]
    for piece in make_size_distribution(texture).separates:
        assert integrate_power(piece, -1.0) == pytest.approx(piece.mass_fraction, abs=2.0001 * TAIL)
    total = sum(integrate_power(p, -1.0) for p in make_size_distribution(texture).separates)
    assert total == pytest.approx(1.0 - 2.0 * TAIL, rel=1e-9)


@pytest.mark.parametrize("name", ALL_TEXTURES)
@pytest.mark.parametrize("pieces", ["separates", "single"])
def test_hit_sizes_decrease_monotonically(name, pieces):
    if (name, pieces) == ("sand alone", "single"):
        with pytest.raises(
            ValueError, match=r"interpretation\.size_distribution = 'single'.*one separate alone"
        ):
            make_size_distribution(ALL_TEXTURES[name], TAIL, pieces)
        return
    sizes = make_size_distribution(ALL_TEXTURES[name], TAIL, pieces)
    table = sizes.tabulate_hit_inverse_sizes()
    assert table.shape == (N_TABLE_POINTS,)
    assert np.isfinite(table).all() and (np.diff(table) > 0.0).all()
    largest, smallest = 1.0 / table[[0, -1]]
    assert largest == pytest.approx(sizes.largest_m) == pytest.approx(2e-3)
    assert smallest >= sizes.separates[0].min_size_m * (1.0 - 1e-12)


@pytest.mark.parametrize("gap", SMALL_CLAY_TEXTURES)
def test_clay_slightly_above_the_tail(gap):
    """A very wide log-normal is uniform in log size: ∫ s⁻² ds over ∫ s⁻¹ ds, up to a slope.

    The score changes by gap·tail/φ(score) over the separate, and f_g by score times that.
    """
    sizes = make_size_distribution(SMALL_CLAY_TEXTURES[gap])
    clay, sand = sizes.separates
    low, high = LIMITS["clay"]
    expected = (1.0 / low - 1.0 / high) / np.log(high / low)
    assert np.isfinite([clay.log_mean, clay.log_sd, clay.mean_inverse_size_per_m]).all()
    assert clay.mean_inverse_size_per_m == pytest.approx(expected, rel=gap + 1e-9)
    assert clay.mass_fraction == pytest.approx(
        TAIL, rel=2e-3
    ) and sand.mass_fraction == pytest.approx(1.0 - TAIL)
    median = float(clay.compute_hit_sizes(np.array([0.5]))[0])
    assert median == pytest.approx(2.0 / (1.0 / low + 1.0 / high), rel=1e-3)


def test_clay_below_the_tail_is_omitted():
    for clay in (0.0, 0.5 * TAIL, TAIL):
        sizes = make_size_distribution((clay, 0.0, 1.0 - clay))
        (sand,) = sizes.separates
        assert (sand.min_size_m, sand.max_size_m) == LIMITS["sand"] and sand.mass_fraction == 1.0
        assert sizes.size_attenuation_per_m == pytest.approx(
            make_size_distribution((0.0, 0.0, 1.0)).size_attenuation_per_m, rel=1e-4
        )
    assert len(make_size_distribution((TAIL, 0.0, 1.0 - TAIL), tail_mass=1e-5).separates) == 2


@pytest.mark.parametrize("texture", [(0.0, 0.15, 0.85), (0.01, 0.135, 0.855), (0.1, 0.0, 0.9)])
def test_one_log_normal_over_all_separates(texture):
    """Shirazi & Boersma 1984: mass-weighted mean and deviation of ln of the separate centres."""
    middle = np.log([1e-6, 26e-6, 1.025e-3])
    mean = np.dot(texture, middle)
    (piece,) = make_size_distribution(texture, size_model="single").separates
    assert piece.log_mean == pytest.approx(mean, rel=1e-12)
    assert piece.log_sd == pytest.approx(np.sqrt(np.dot(texture, (middle - mean) ** 2)), rel=1e-9)
    assert (piece.min_size_m, piece.max_size_m) == (5e-8 if texture[0] else 2e-6, 2e-3)
    assert piece.mass_fraction == 1.0
    exact = integrate_power(piece, -2.0) / integrate_power(piece, -1.0)
    assert piece.mean_inverse_size_per_m == pytest.approx(exact, rel=1e-9)


def test_finer_soils_attenuate_more():
    by_texture = [(0.0, 0.0, 1.0), (0.0, 0.05, 0.95), (0.0, 0.15, 0.85), (0.01, 0.135, 0.855)]
    attenuation = [make_size_distribution(texture).size_attenuation_per_m for texture in by_texture]
    assert (np.diff(attenuation) > 0.0).all()


@pytest.mark.parametrize(
    ("texture", "message"),
    [
        ((0.0, 0.2, 0.8), r"silt \+ 1.5 clay at most 0.15"),
        ((0.11, 0.0, 0.89), r"silt \+ 1.5 clay at most 0.15"),
        ((0.0, 0.1, 0.8), "add up to 1"),
        ((-0.1, 0.2, 0.9), "add up to 1"),
        ((0.1, 0.9), r"3 numbers \(clay, silt, sand\)"),
    ],
)
def test_textures_other_than_sand_are_rejected(texture, message):
    with pytest.raises(ValueError, match=rf"^texture.*{message}") as error:
        Sand(texture=texture)
    assert repr(texture) in str(error.value)


def test_other_invalid_textures_are_rejected():
    with pytest.raises(
        ValueError, match=r"^interpretation.size_distribution = 'single': .*'separates'"
    ):
        make_size_distribution((0.0, 0.0, 1.0), size_model="single")
    make_size_distribution((0.1, 0.0, 0.9))
    make_size_distribution((0.0, 0.15 + 1e-10, 0.85 - 1e-10))


W = np.array([700.0, 1450.0])


@pytest.mark.parametrize("saturation", [0.01, 0.1, 0.4, 0.9])
def test_the_shortest_segments_fill_first(saturation):
    """Sorted exponential segments: the shortest ones with a length fraction of the saturation."""
    n_segments = 1_000_000
    segments = np.sort(-np.log((np.arange(n_segments) + 0.5) / n_segments))
    fraction = np.searchsorted(segments.cumsum() / segments.sum(), saturation) / n_segments
    assert narrow_pore_fraction(saturation) == pytest.approx(fraction, abs=2e-5)


def test_narrow_pore_fraction_increases_from_0_to_1():
    assert (narrow_pore_fraction(0.0), narrow_pore_fraction(1.0)) == (0.0, 1.0)
    assert narrow_pore_fraction(MAX_SERIES_SATURATION * 0.999999) == pytest.approx(
        narrow_pore_fraction(MAX_SERIES_SATURATION), rel=1e-5
    )
    assert narrow_pore_fraction(1e-18) == pytest.approx(np.sqrt(2e-18), rel=1e-8)
    fractions = [narrow_pore_fraction(s) for s in np.linspace(0.0, 1.0, 201)]
    assert (np.diff(fractions) > 0.0).all()


@pytest.mark.parametrize("saturation", [0.05, 0.3, 0.8])
def test_all_water_models_contain_the_same_water(saturation):
    porosity, sphericity = 0.4, 0.8
    surface = float(surface_to_volume_ratio(sphericity))
    for water_model in ("whole_pores", "narrow_pores", "film"):
        water = distribute_water(saturation, porosity, sphericity, water_model)
        on_grains = water.relative_film_thickness * surface * (1.0 - porosity) / porosity
        assert water.wet_fraction * water.filled_fraction + on_grains == pytest.approx(
            saturation, rel=1e-9
        )
        assert (
            water.relative_film_thickness <= MAX_RELATIVE_FILM_THICKNESS
            and 0.0 <= water.wet_fraction <= 1.0
        )


def test_films_are_the_outermost_coating():
    sand = Sand(saturation=0.1, partition=(0.0, 0.5, 0.5), interpretation={"water": "film"})
    grains, names = sand.make_grain_population(), sand.list_materials()
    assert names[:3] == ("air", "water", "water film")
    rows = zip(grains.types.material, grains.types.n_shells, strict=True)
    layers = [tuple(names[m] for m in row[:n]) for row, n in rows]
    assert layers == [
        ("water film", "quartz with goethite"),
        ("water film", "kaolinite with goethite", "quartz"),
    ]
    thickness = grains.types.coating_thickness
    assert (thickness[:, 0] == sand._water.relative_film_thickness).all()
    assert thickness[1, 1] == sand.relative_coating_thickness
    water = Sand(saturation=1.0).compute_refractive_indices(W)[:, 1]
    np.testing.assert_array_equal(sand.compute_refractive_indices(W)[:, 2], water)
    assert sand.wet_fraction == 0.0
    assert sand.describe()["film_thickness_per_major_axis"] == sand._water.relative_film_thickness


def test_water_above_the_film_capacity_fills_pores():
    sand = Sand(saturation=0.9, interpretation={"water": "film"})
    assert (
        sand._water.relative_film_thickness == MAX_RELATIVE_FILM_THICKNESS
        and 0.7 < sand.wet_fraction < 0.9
    )
    assert Sand(saturation=1.0, interpretation={"water": "film"}).wet_fraction == 1.0


def test_absorption_is_proportional_to_the_water_content():
    whole, narrow = (
        Sand(saturation=0.1, interpretation={"water": water_model})
        for water_model in ("whole_pores", "narrow_pores")
    )
    ratio = (
        narrow.compute_refractive_indices(W)[:, 1].imag
        / whole.compute_refractive_indices(W)[:, 1].imag
    )
    np.testing.assert_allclose(ratio * narrow.wet_fraction, whole.wet_fraction, rtol=1e-12)
    np.testing.assert_array_equal(
        narrow.compute_refractive_indices(W).real, whole.compute_refractive_indices(W).real
    )


def test_dry_and_saturated_sands_are_independent_of_the_model():
    for saturation in (0.0, 1.0):
        sands = [
            Sand(saturation=saturation, interpretation={"water": water_model})
            for water_model in ("whole_pores", "narrow_pores")
        ]
        np.testing.assert_array_equal(
            sands[0].compute_refractive_indices(W), sands[1].compute_refractive_indices(W)
        )
        assert sands[0].wet_fraction == sands[1].wet_fraction == saturation


@pytest.mark.parametrize("water_model", ["narrow_pores", "film"])
def test_other_liquids_in_partially_wet_pores_are_rejected(water_model):
    settings = {"pores": {"oil": 0.1}, "refractive_index": {"oil": 1.47}}
    with pytest.raises(
        ValueError, match=rf"pores = .*empty with interpretation\.water {water_model}"
    ):
        Sand(saturation=0.1, interpretation={"water": water_model}, **settings)
