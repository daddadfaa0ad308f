"""Impurities in snow: absorption and errors."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import judge_z

import splits
from splits.experiments.config.media import list_table_paths
from splits.materials import ice_density
from splits.materials.impurities import list_impurities
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
    z = [
        (with_impurity[name] - with_index[name])
        / np.hypot(with_impurity[f"{name}_stderr"], with_index[f"{name}_stderr"])
        for name in ("reflectance", "transmittance")
    ]
    judge_z(np.array(z), independent=1, bound_added=True)
    clean = splits.spectrophotometer(splits.Snow(**settings), w, max_stderr=0.004)
    assert (clean.reflectance - with_impurity.reflectance > 0.02).all()
