"""Impurities in snow and minerals of sand: absorption, refractive indices, densities, errors."""

import numpy as np
import pytest
from chi2 import compare_results, judge_z

import splits
from splits.core.validation import invalid
from splits.experiments.config.media import list_table_paths
from splits.materials import (
    MINERAL_DENSITY_KG_M3,
    LorentzIndex,
    LorentzOscillator,
    ice_density,
    list_datasets,
    make_refractive_index,
)
from splits.materials.impurities import list_impurities
from splits.materials.library import _drop_invalid_rows
from splits.materials.refractive_index import HC_EV_NM
from splits.simulation.scene import compute_optical_constants

W = np.array([400.0, 550.0, 700.0])
ICE, DRY, WET = 2, 0, 1


def compute_added_absorption(snow, wavelengths=W):
    clean = splits.Snow(temperature_c=snow.temperature_c)
    return (
        compute_optical_constants(snow, wavelengths).absorption
        - compute_optical_constants(clean, wavelengths).absorption
    )


def test_soot_absorption_matches_its_mass_concentration():
    """7500 m²/kg at 550 nm (Flanner et al. 2021), 100 ng in every g of ice."""
    added = compute_added_absorption(splits.Snow(impurities_ng_g={"black_carbon": 100.0}))
    assert added[1, ICE] == pytest.approx(7513.0 * 1e-7 * ice_density(-1.0), rel=1e-3)
    assert (added[:, [DRY, WET]] == 0.0).all()


def test_absorption_is_independent_of_the_location():
    """Impurities in ice and in pores add the same absorption per volume of snow."""
    amounts = {"impurities_ng_g": {"dust_sahara": 2000.0}, "algae_cells_ml": {"snow_algae": 1e4}}
    ice, pores = (splits.Snow(impurities_in=location, **amounts) for location in ("ice", "pores"))
    np.testing.assert_allclose(
        ice.ice_fraction * compute_added_absorption(ice)[:, ICE],
        compute_added_absorption(pores)[:, DRY],
        rtol=1e-12,
    )
    np.testing.assert_allclose(
        compute_added_absorption(pores)[:, DRY], compute_added_absorption(pores)[:, WET], rtol=1e-12
    )
    assert (compute_added_absorption(pores)[:, ICE] == 0.0).all()


def test_absorption_of_impurities_is_additive(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text("# mine\nwavelength_nm,absorption_m2_kg\n300,100\n800,50\n")
    lists = {"ng_g": 10.0, "wavelength_nm": [300, 800], "absorption_m2_kg": [100, 50]}
    soot = splits.Snow(impurities_ng_g={"black_carbon": 5.0})
    mixed = splits.Snow(
        impurities_ng_g={"black_carbon": 5.0, "mine": {"ng_g": 10.0, "table": str(path)}}
    )
    user = splits.Snow(impurities_ng_g={"mine": lists})
    np.testing.assert_allclose(
        compute_added_absorption(mixed),
        compute_added_absorption(soot) + compute_added_absorption(user),
        rtol=1e-9,
    )
    assert compute_added_absorption(user)[0, ICE] == pytest.approx(
        90.0 * 1e-8 * ice_density(-1.0), rel=1e-9
    )
    attributes = mixed.describe()
    assert attributes["black_carbon_ng_g"] == pytest.approx(5.0)
    assert len(attributes["mine_sha256"]) == 64
    assert attributes["impurities_in"] == "ice"


def test_impurities_apply_to_their_layer():
    clean, dirty = splits.Snow(), splits.Snow(impurities_ng_g={"black_carbon": 500.0})
    stack = splits.Stack([clean, dirty, splits.Sand(), clean], interpretation="splits_2007")
    clean_stack = splits.Stack([clean, clean, splits.Sand(), clean], interpretation="splits_2007")
    added = (
        compute_optical_constants(stack, W).absorption
        - compute_optical_constants(clean_stack, W).absorption
    )
    assert stack.list_materials()[5] == "layers.1.ice"
    assert (added[:, 5] > 0.0).all()
    assert (np.delete(added, 5, axis=1) == 0.0).all()


def test_all_impurities_absorb_over_the_solar_spectrum():
    w = np.linspace(300.0, 2500.0, 221)
    for kind in list_impurities():
        assert (
            compute_added_absorption(splits.Snow(impurities_ng_g={kind: 1.0}), w)[:, ICE] > 0.0
        ).all(), kind


def test_user_tables_are_inputs_of_an_experiment():
    """A changed table invalidates results, and the table is part of an archive."""
    user_table = {"mine": {"ng_g": 3, "table": "mine.csv"}}
    layers = [{"kind": "snow", "impurities_ng_g": user_table}]
    assert list_table_paths({"medium": {"kind": "stack", "layers": layers}}) == ["mine.csv"]
    assert list_table_paths({"grid": {"impurities_ng_g": {"dirty": user_table}}}) == ["mine.csv"]


LISTS = {"ng_g": 3, "wavelength_nm": [300, 3000], "absorption_m2_kg": [1]}


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"impurities_ng_g": {"black_carbn": 5}}, "did you mean black_carbon"),
        ({"impurities_ng_g": {"soot": 5}}, r"one of black_carbon, .*did you mean black_carbon"),
        ({"impurities_ng_g": {"dust": 5}}, "did you mean dust_sahara"),
        ({"impurities_ng_g": {"black_carbon": -5}}, r"impurities_ng_g\.black_carbon = -5"),
        ({"impurities_ng_g": {"black_carbon": float("nan")}}, "black_carbon"),
        ({"impurities_ng_g": {"snow_algae": 5}}, "belongs to algae_cells_ml"),
        ({"algae_cells_ml": {"black_carbon": 5}}, "belongs to impurities_ng_g"),
        ({"impurities_ng_g": 3}, "a mapping of amounts by kind"),
        ({"impurities_in": "air"}, "one of ice, pores"),
        ({"impurities_ng_g": {"mine": {"ng": 3}}}, "ng_g and table, or"),
        ({"impurities_ng_g": {"mine": {"ng_g": 3, "table": "no.csv"}}}, "an existing CSV file"),
        *(
            ({"impurities_ng_g": {name: {"ng_g": 3, "table": "no.csv"}}}, "a name of at most 80")
            for name in ("a/b", "a\nb", "ground", "refractive_index_ice", "", 81 * "x")
        ),
        ({"impurities_ng_g": {"snow_algae": LISTS}}, "a new name for a user table"),
        ({"impurities_ng_g": {"mine": LISTS}}, "2 wavelength_nm, 1 absorption_m2_kg"),
        ({"impurities_ng_g": {"mine": LISTS | {"absorption_m2_kg": [1, -1]}}}, "at least 0"),
    ],
)
def test_invalid_impurities_are_rejected_in_one_line(keywords, message):
    with pytest.raises(ValueError, match=message) as error:
        splits.Snow(**keywords)
    assert "\n" not in str(error.value)


def test_user_tables_are_recorded_in_the_attributes():
    table = {"ng_g": 3, "wavelength_nm": [300, 2500], "absorption_m2_kg": [20.0, 1.0]}
    attributes = splits.Snow(impurities_ng_g={"mine": table}).describe()
    assert attributes["mine_ng_g"] == pytest.approx(3.0)
    assert attributes["mine_wavelength_nm"].tolist() == [300.0, 2500.0]
    assert attributes["mine_absorption_m2_kg"].tolist() == [20.0, 1.0]


def test_wavelengths_outside_the_table_are_rejected():
    with pytest.raises(ValueError, match="range of impurity black_carbon"):
        splits.spectrophotometer(splits.Snow(impurities_ng_g={"black_carbon": 1.0}), [2600.0])


@pytest.mark.slow
def test_soot_in_ice_is_equivalent_to_larger_extinction():
    """Weak extinction does not affect reflection, so soot is equivalent to ice of larger k."""
    w, settings = np.array([500.0, 600.0, 700.0]), {"saturation": 0.0, "depth_m": 0.05}
    dirty = splits.Snow(impurities_ng_g={"black_carbon": 2000.0}, **settings)
    alpha = compute_optical_constants(dirty, w).absorption[:, ICE]
    n = dirty.refractive_index["ice"](w).real
    k = alpha * w * 1e-9 / (4.0 * np.pi)
    table = {"wavelength_nm": list(w), "n": list(n), "k": list(k)}
    absorbing = splits.Snow(refractive_index={"ice": table}, **settings)
    with_impurity, with_index = (
        splits.spectrophotometer(snow, w, max_stderr=0.004, seed=seed)
        for seed, snow in enumerate((dirty, absorbing), start=1)
    )
    z = compare_results(with_impurity, with_index, "reflectance", "transmittance")
    judge_z(z, independent=1, bound_added=True)
    clean = splits.spectrophotometer(splits.Snow(**settings), w, max_stderr=0.004)
    assert (clean.reflectance - with_impurity.reflectance > 0.02).all()


MINERALS = ("quartz", "hematite", "goethite", "magnetite", "kaolinite")
NAMED = [(mineral, name) for mineral in MINERALS for name in list_datasets(mineral)]
GOETHITE = make_refractive_index("goethite")


def average_goethite_k(low: float, high: float) -> np.ndarray:
    return GOETHITE(np.arange(low, high + 1.0)).imag


@pytest.mark.parametrize(("mineral", "name"), NAMED)
def test_datasets_cover_the_visible_and_name_a_source(mineral, name):
    index = make_refractive_index(mineral, name)
    m = index(np.linspace(400.0, 1000.0, 301).reshape(7, 43))
    assert m.shape == (7, 43) and m.dtype == complex
    assert (m.real > 1.0).all() and (m.real < 3.5).all() and (m.imag >= 0.0).all()
    assert index.name.startswith(name)
    assert "19" in index.source


@pytest.mark.parametrize("mineral", MINERALS)
def test_mineral_densities_are_plausible(mineral):
    assert 2500.0 < MINERAL_DENSITY_KG_M3[mineral] < 5300.0
    assert set(MINERAL_DENSITY_KG_M3) == set(MINERALS)


@pytest.mark.parametrize(
    ("name", "n"), [("ghosh_1999_ordinary", 1.5443), ("ghosh_1999_extraordinary", 1.5534)]
)
def test_quartz_index_at_the_sodium_line(name, n):
    """Optical mineralogy: ω = 1.544, ε = 1.553."""
    assert complex(make_refractive_index("quartz", name)(589.3)) == pytest.approx(n, abs=2e-4)


def test_quartz_index_matches_its_formula():
    """The formula and coefficients are those of Ghosh (1999) for the ordinary ray, λ in µm."""
    square = 0.5**2
    epsilon = 1.28604141 + 1.07044083 * square / (square - 0.0100585997)
    epsilon += 1.10202242 * square / (square - 100.0)
    assert complex(make_refractive_index("quartz")(500.0)) == pytest.approx(
        np.sqrt(epsilon), rel=1e-14
    )


@pytest.mark.parametrize("outside", [197.9, 2053.2, np.nan])
@pytest.mark.parametrize(
    ("inside", "example"), [([500.0], "198, 2054"), ([500, 799.5], "500, 800")]
)
def test_wavelengths_outside_the_range_of_quartz_are_rejected(outside, inside, example):
    message = str(
        invalid(
            "wavelength_nm",
            outside,
            "in [198, 2053.1] nm, the range of ghosh_1999_ordinary",
            f"give wavelengths within it, such as wavelength_nm=range({example}, 10), or choose "
            "other data",
        )
    )
    with pytest.raises(ValueError) as error:
        make_refractive_index("quartz")([*inside, outside])
    assert str(error.value) == message
    with pytest.raises(ValueError, match="the range of oscillators"):
        GOETHITE([500.0, 299.0])


def test_hematite_averages_the_permittivity():
    mean = make_refractive_index("hematite")
    o, e = (
        make_refractive_index("hematite", f"querry_1985_{ray}ordinary") for ray in ("", "extra")
    )
    expected = (2.0 * (3.318 + 0.498j) ** 2 + (2.927 + 0.46j) ** 2) / 3.0
    assert complex(mean(550.0)) ** 2 == pytest.approx(expected, rel=1e-12)
    low, high = mean.wavelength_nm[[0, -1]]
    assert low == max(o.wavelength_nm[0], e.wavelength_nm[0])
    assert high == min(o.wavelength_nm[-1], e.wavelength_nm[-1])
    assert set(mean.wavelength_nm) <= set(o.wavelength_nm) | set(e.wavelength_nm)


def test_invalid_rows_of_tables_are_dropped():
    w = np.array([1.0, 2.0, 2.0, 4.0, 3.0, 5.0, 6.0, 7.0])
    k = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, -0.1, 0.1])
    wavelengths, n, extinctions = _drop_invalid_rows(w, w + 1.0, k)
    assert wavelengths.tolist() == [1.0, 2.0, 4.0, 5.0]
    assert n.tolist() == [2.0, 3.0, 5.0, 6.0] and extinctions.tolist() == [0.1, 0.2, 0.4, 0.6]
    ordinary = make_refractive_index("hematite", "querry_1985_ordinary")
    assert ordinary.wavelength_nm.size == 619 - 1 - 11
    assert make_refractive_index("magnetite").wavelength_nm[-1] == 55555.6


def test_kaolinite_is_a_documented_constant():
    index = make_refractive_index("kaolinite")
    assert index([400.0, 2500.0]).tolist() == [1.56 + 5e-4j] * 2
    assert "constant" in index.name and "constant" in index.source
    assert make_refractive_index("kaolinite", {"k_factor": 2.0})(500.0) == 1.56 + 1e-3j


def test_goethite_index_matches_optical_mineralogy():
    assert GOETHITE(570.0).real == pytest.approx(2.36, abs=0.02)
    assert "model" in GOETHITE.source


def test_goethite_absorbs_blue_more_than_red():
    assert (average_goethite_k(400, 450) > 0.08).all() and (
        average_goethite_k(400, 450) < 0.2
    ).all()
    assert (average_goethite_k(600, 700) > 0.01).all() and (
        average_goethite_k(600, 700) < 0.05
    ).all()
    assert (average_goethite_k(1000, 2600) < 0.0125).all()
    assert (np.diff(average_goethite_k(480, 600)) < 0.0).all()
    assert average_goethite_k(420, 450).max() > average_goethite_k(450, 520).max()
    steps = average_goethite_k(420, 600)[::30]
    assert (np.diff(steps) < 2e-3).all() and steps[-1] < 0.3 * steps[0]


@pytest.mark.parametrize("centre", [650.0, 900.0])
def test_goethite_has_crystal_field_bands(centre):
    k = average_goethite_k(centre - 60.0, centre + 60.0)
    baseline = np.linspace(k[0], k[-1], k.size)
    assert abs(np.argmax(k - baseline) - 60) <= 12
    assert 0.1 < (k - baseline).max() / k[60] < 0.5


@pytest.mark.parametrize("band", GOETHITE.oscillators)
def test_absorption_bands_peak_at_their_energy(band):
    energy = np.linspace(0.3, 6.0, 5701)
    absorbed = band.permittivity(energy).imag
    assert energy[np.argmax(absorbed)] == pytest.approx(band.energy_ev, rel=0.02)
    half = energy[absorbed > 0.5 * absorbed.max()]
    assert half[-1] - half[0] == pytest.approx(band.width_ev, rel=0.05)
    assert complex(band.permittivity(0.0)) == pytest.approx(band.strength)


@pytest.mark.parametrize("wavelength", [380.0, 480.0, 570.0, 650.0, 900.0, 2000.0])
def test_goethite_fulfils_kramers_kronig(wavelength):
    """n − n∞ = (2/π) P∫ E' k(E') / (E'² − E²) dE', the pole subtracted, over all energies."""
    pole = HC_EV_NM / wavelength
    # Nodes are symmetric in log energy about the pole, which lies between two nodes, so that the
    # ends of the subtracted term, E k(E) P∫ dE'/(E'² − E²) = 0, cancel.
    step = 2e-4
    energy = pole * np.exp(step * (np.arange(-60_000, 60_000) + 0.5))
    k = np.sqrt(GOETHITE.permittivity(energy)).imag
    k_at_pole = GOETHITE(wavelength).imag
    integrand = (energy * k - pole * k_at_pole) / (energy**2 - pole**2)
    integral = np.sum(integrand * energy) * step
    expected = np.sqrt(GOETHITE.high_energy_permittivity) + 2.0 / np.pi * integral
    assert GOETHITE(wavelength).real == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("change", [{"energy_ev": 0.0}, {"strength": -1.0}, {"width_ev": np.nan}])
def test_invalid_oscillators_are_rejected(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        LorentzOscillator(**{"energy_ev": 2.0, "strength": 0.1, "width_ev": 0.2, **change})
    with pytest.raises(ValueError, match="high_energy"):
        LorentzIndex("made up", "nowhere", (300.0, 800.0), 0.5, ())
