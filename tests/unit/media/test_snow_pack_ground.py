"""Ground below snowpacks: one for all, an albedo for each, flags, files."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import splits
from splits.media.ground import Ground, load_soils

TIMES = pd.date_range("2024-02-01", periods=3, freq="D")
WAVELENGTHS = np.array([500.0, 800.0])


def make_packs(ground=None, **variables):
    dims = ("time", "layer")
    values = {"thickness_m": 0.1, "density_kg_m3": 200.0, "specific_surface_area_m2_kg": 20.0}
    columns = {name: (dims, np.full((3, 2), value)) for name, value in values.items()}
    return splits.SnowPacks(xr.Dataset({**columns, **variables}, {"time": TIMES}), ground=ground)


def list_flags(packs):
    return [name for name, number in packs.count_flags().items() for _ in range(number)]


@pytest.mark.parametrize("ground", [None, "open", "black", 0.3, next(iter(load_soils()))])
def test_common_ground_is_kept_in_files(ground, tmp_path):
    packs = make_packs(ground)
    path = tmp_path / "packs.nc"
    splits.save(packs.dataset, path)
    read = splits.SnowPacks(splits.load(path))
    assert repr(read) == repr(packs)
    assert read.make_stack(TIMES[0]) == packs.make_stack(TIMES[0])
    assert packs.make_stack(TIMES[0]) == packs.make_stack(TIMES[0], ground=ground)


def test_table_of_a_ground_is_kept_in_files(tmp_path):
    table = {"wavelength_nm": [400, 900], "albedo": [0.1, 0.5]}
    packs = make_packs(table)
    splits.save(packs.dataset, tmp_path / "packs.nc")
    read = splits.SnowPacks(splits.load(tmp_path / "packs.nc"))
    np.testing.assert_allclose(read.compute_ground_albedo(WAVELENGTHS), [[0.18, 0.42]] * 3)


def test_ground_appears_in_the_text():
    assert "ground: albedo 0.3" in repr(make_packs(0.3))
    assert "ground" not in repr(make_packs())


def test_albedo_of_each_snowpack_by_label():
    by_time = pd.Series([0.3, 0.1, 0.2], TIMES[[2, 0, 1]])
    for packs in (
        make_packs(by_time),
        make_packs(xr.DataArray.from_series(by_time.rename_axis("time"))),
        make_packs([0.1, 0.2, 0.3]),
        make_packs(ground_albedo=("time", [0.1, 0.2, 0.3])),
    ):
        expected = [[0.1, 0.1], [0.2, 0.2], [0.3, 0.3]]
        np.testing.assert_allclose(packs.compute_ground_albedo(WAVELENGTHS), expected)
        assert packs.make_stack(TIMES[1]).ground.albedo_values.tolist() == [0.2]
        assert list_flags(packs) == ["good"] * 3


def test_albedo_over_time_and_wavelength_is_kept_in_files(tmp_path):
    albedo = xr.DataArray(
        [[0.0, 0.1, 0.2], [0.6, 0.7, 0.8]],
        {"wavelength": [400.0, 1000.0], "time": TIMES},
        ("wavelength", "time"),
    )
    packs = make_packs(albedo)
    splits.save(packs.dataset, tmp_path / "packs.nc")
    for one in (packs, splits.SnowPacks(splits.load(tmp_path / "packs.nc"))):
        computed = one.compute_ground_albedo(WAVELENGTHS)
        np.testing.assert_allclose(computed, [[0.1, 0.4], [0.2, 0.5], [0.3, 0.6]])
        np.testing.assert_allclose(one.make_stack(TIMES[2]).ground.albedo(WAVELENGTHS), computed[2])


def test_albedo_over_wavelength_only():
    albedo = xr.DataArray([0.2, 0.4], {"wavelength": [400.0, 900.0]}, ("wavelength",))
    for ground in (albedo, albedo.to_series()):
        computed = make_packs(ground).compute_ground_albedo(WAVELENGTHS)
        np.testing.assert_allclose(computed, [[0.24, 0.36]] * 3)
        stack = splits.Stack([splits.Snow(), splits.Snow()], ground=ground)
        assert stack.ground.albedo(WAVELENGTHS).tolist() == computed[0].tolist()
    with pytest.raises(ValueError, match=r'a spectrum is \{"wavelength_nm"'):
        splits.Snow(ground=pd.Series([0.2, 0.4], [400.0, 900.0]))


def test_invalid_albedos_become_flags():
    assert list_flags(make_packs([0.1, np.nan, 1.2])) == ["good", "missing_value", "out_of_range"]


def test_another_ground_replaces_the_first():
    packs = make_packs([0.1, np.nan, 1.2]).with_ground(0.4)
    assert "ground_albedo" not in packs.dataset and list_flags(packs) == ["good"] * 3
    assert packs.with_ground("open").make_stack(TIMES[0]).ground is None
    assert packs.with_sun_zenith(30).make_stack(TIMES[0]).ground.name == "albedo 0.4"


def test_table_of_layers_with_a_column():
    frame = pd.DataFrame(
        {
            "time": [0, 0, 1], "layer": [0, 1, 0], "thickness_m": 0.1, "density_kg_m3": 200,
            "specific_surface_area_m2_kg": 20, "ground_albedo": [0.1, 0.1, 0.3],
        }
    )  # fmt: skip
    computed = splits.SnowPacks(frame).compute_ground_albedo(WAVELENGTHS)
    np.testing.assert_allclose(computed, [[0.1, 0.1], [0.3, 0.3]])


@pytest.mark.parametrize(
    ("ground", "message"),
    [
        ([0.1, 0.2], r"ground_albedo = .*shape \(2,\)': must be one ground, or 3 albedos"),
        (xr.DataArray([0.1, 0.2], dims="time"), "ground_albedo = '2 albedos': must be 3"),
        (xr.DataArray([0.1, 0.2], dims="site"), "ground_albedo dimensions"),
        (xr.DataArray([0.1, 0.2], dims="wavelength"), "ground_albedo dimensions.*coordinates"),
        (xr.DataArray([[0.1, 0.2]] * 3, {"time": TIMES}, ("time", "wavelength")),
         "ground_albedo.wavelength"),
        (1.5, r"ground = 1.5: must be in \[0, 1\]"),
    ],
)  # fmt: skip
def test_invalid_structure(ground, message):
    with pytest.raises(ValueError, match=message):
        make_packs(ground)


@pytest.mark.parametrize(
    ("column", "values"), [("ground", ["black", None]), ("ground_albedo", [0.3, np.nan])]
)
@pytest.mark.parametrize("order", [1, -1])
def test_one_row_of_a_table_gives_the_ground_of_a_snowpack(column, values, order):
    frame = pd.DataFrame({"time": "a", "layer": [0, 1], "thickness_m": 0.1, "density_kg_m3": 200.0})
    frame = frame.assign(specific_surface_area_m2_kg=20.0, **{column: values[::order]})
    assert splits.SnowPacks(frame).make_stack("a").ground == Ground.from_input(values[0])
    with pytest.raises(ValueError, match=rf"^{column} = .*: must be the same for all layers"):
        splits.SnowPacks(frame.assign(**{column: [values[0], type(values[0])(0.5)]}))
