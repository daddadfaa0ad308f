"""Snowpacks over time: input, units, flags, arrays, stacks, files, and the ground below them."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from compliance import collect_remarks

import splits
from splits.core.validation import InvalidValue
from splits.materials import ice_density
from splits.media.ground import Ground, load_soils
from splits.media.snow_packs import FLAGS

SOOT = "impurities_ng_g.black_carbon"
TIMES = pd.date_range("2024-02-01", periods=3, freq="D")
NAN = np.nan


def make_dataset(**changes):
    """Return two layers at three times; changes are arrays over time and layer, or None."""
    arrays = {
        "thickness_m": [[0.1, 0.4], [0.2, 0.3], [0.05, 0.5]],
        "density_kg_m3": [[120.0, 300.0], [150.0, 310.0], [200.0, 320.0]],
        "specific_surface_area_m2_kg": [[40.0, 15.0], [30.0, 14.0], [25.0, 12.0]],
        **changes,
    }
    variables = {
        name: values if isinstance(values, tuple) else (("time", "layer"), np.array(values))
        for name, values in arrays.items()
        if values is not None
    }
    return xr.Dataset(variables, {"time": TIMES})


def list_flags(**changes):
    """Return the names of the flags at the three times."""
    names = {value: name for name, value in FLAGS.items()}
    flags = splits.SnowPacks(make_dataset(**changes)).dataset.quality_flag.values
    return [names[int(flag)] for flag in flags]


def replace(name, position, value):
    """Return the changed values of a variable."""
    values = make_dataset()[name].values.copy()
    values[position] = value
    return {name: values}


# --- input ----------------------------------------------------------------------------------------


def test_defaults_units_and_flags_are_complete():
    dataset = splits.SnowPacks(make_dataset()).dataset
    assert (dataset.temperature_c == -1.0).all() and (dataset.liquid_water_content == 0.0).all()
    assert dataset.thickness_m.attrs["units"] == "m"
    flag = dataset.quality_flag
    assert flag.attrs["flag_meanings"] == "good no_snow missing_value out_of_range night"
    assert flag.attrs["flag_values"].tolist() == [0, 1, 2, 3, 4]
    assert flag.attrs["flag_values"].dtype == flag.dtype == np.int8
    assert (flag == 0).all() and (dataset.layer_flag == 0).all()


def test_a_long_table_gives_the_same_snowpacks_in_any_order_of_rows():
    dataset = make_dataset(sun_zenith_deg=("time", [50.0, 60.0, 95.0]))
    frame = dataset.to_dataframe().reset_index()
    expected = splits.SnowPacks(dataset).dataset
    for table in (frame, frame.set_index(["time", "layer"]), frame.astype(object)):
        xr.testing.assert_identical(splits.SnowPacks(table).dataset, expected)
    shuffled = splits.SnowPacks(frame.sample(frac=1.0, random_state=0)).dataset
    xr.testing.assert_allclose(shuffled.sortby("time"), expected)


def test_rows_that_do_not_exist_are_absent_layers():
    frame = make_dataset().to_dataframe().reset_index()
    packs = splits.SnowPacks(frame.drop(index=1))
    assert packs.dataset.layer_flag.values.tolist() == [[0, 1], [0, 0], [0, 0]]
    assert packs.count_flags()["good"] == 3


def test_another_label_and_times_with_a_zone_are_accepted():
    frame = make_dataset().to_dataframe().reset_index()
    named = splits.SnowPacks(frame.assign(site=frame.time.dt.day.astype(str)).drop(columns="time"),
                             label="site")  # fmt: skip
    assert named.label == "site" and named.dataset.site.values.tolist() == ["1", "2", "3"]
    zoned = splits.SnowPacks(frame.assign(time=frame.time.dt.tz_localize("Europe/Paris")))
    assert zoned.dataset.time.values[0] == np.datetime64("2024-01-31T23:00")


@pytest.mark.parametrize(
    ("name", "unit", "factor", "offset"),
    [
        ("thickness_m", "cm", 100.0, 0.0), ("thickness_m", "mm", 1000.0, 0.0),
        ("thickness_m", "metre", 1.0, 0.0), ("density_kg_m3", "g cm-3", 1e-3, 0.0),
        ("density_kg_m3", "kg.m^-3", 1.0, 0.0), ("specific_surface_area_m2_kg", "m2/kg", 1.0, 0.0),
        ("specific_surface_area_m2_kg", "cm2 g-1", 10.0, 0.0), ("temperature_c", "K", 1.0, 273.15),
        ("temperature_c", "degrees_Celsius", 1.0, 0.0), ("liquid_water_content", "%", 100.0, 0.0),
        ("liquid_water_content", "m3 m-3", 1.0, 0.0), (SOOT, "ug g-1", 1e-3, 0.0),
        (SOOT, "ng/g", 1.0, 0.0), (SOOT, "kg kg-1", 1e-9, 0.0),
    ],
)  # fmt: skip
def test_units_are_converted(name, unit, factor, offset):
    optional = {
        "temperature_c": [[-5.0, -2.0]] * 3, "liquid_water_content": [[0.0, 0.02]] * 3,
        SOOT: [[20.0, 5.0]] * 3,
    }  # fmt: skip
    dataset = make_dataset(**optional)
    expected = splits.SnowPacks(dataset).dataset
    dataset[name] = (dataset[name] * factor + offset).assign_attrs(units=unit)
    xr.testing.assert_allclose(splits.SnowPacks(dataset).dataset, expected, atol=1e-12)


def test_zenith_angles_in_radians_are_converted():
    zenith = ("time", np.radians([10.0, 20.0, 100.0]), {"units": "rad"})
    packs = splits.SnowPacks(make_dataset(sun_zenith_deg=zenith))
    np.testing.assert_allclose(packs.dataset.sun_zenith_deg, [10.0, 20.0, 100.0])


def test_an_optical_radius_is_converted_at_the_temperature_of_the_ice():
    radius = 3e6 / (ice_density(-10.0) * 20.0)
    changes = {"optical_radius_um": [[radius] * 2] * 3, "temperature_c": [[-10.0] * 2] * 3}
    packs = splits.SnowPacks(make_dataset(specific_surface_area_m2_kg=None, **changes))
    np.testing.assert_allclose(packs.dataset.specific_surface_area_m2_kg, 20.0)
    assert "optical_radius_um" not in packs.dataset
    flags = list_flags(
        specific_surface_area_m2_kg=None,
        optical_radius_um=[[100.0, 0.0], [100.0, -3.0], [NAN, 100.0]],
    )
    assert flags == ["out_of_range", "out_of_range", "missing_value"]


def repeat_time(dataset):
    return dataset.assign_coords(time=[TIMES[0], TIMES[1], TIMES[0]])


def set_unit(name, unit):
    def change(dataset):
        dataset[name].attrs["units"] = unit
        return dataset

    return change


STRUCTURAL_ERRORS = {
    "missing variable": (lambda ds: ds.drop_vars("density_kg_m3"), r"^density_kg_m3 = None: must"),
    "missing size": (
        lambda ds: ds.drop_vars("specific_surface_area_m2_kg"), "specific_surface_area_m2_kg = None"
    ),
    "both sizes": (
        lambda ds: ds.assign(optical_radius_um=ds.thickness_m), "optical_radius_um = 'given'"
    ),
    "misspelt variable": (
        lambda ds: ds.rename(thickness_m="thicknes_m"),
        r"thicknes_m: unknown key.*did you mean thickness_m",
    ),
    "impurity": (
        lambda ds: ds.assign({"impurities_ng_g.soot": ds.thickness_m}),
        "impurities_ng_g = 'soot': must be one of black_carbon.*did you mean black_carbon",
    ),
    "duplicate time": (repeat_time, r"time = '2024-02-01 00:00:00': must be different for each"),
    "missing time": (
        lambda ds: ds.assign_coords(time=[TIMES[0], TIMES[1], pd.NaT]), "time = 'a gap'"
    ),
    "unit": (
        set_unit("thickness_m", "ell"), r"thickness_m.units = 'ell': must be one of m, metre"
    ),
    "unit of another quantity": (set_unit("density_kg_m3", "m"), r"density_kg_m3.units = 'm'"),
    "depths": (
        lambda ds: ds.assign(depth_top_m=(("time", "layer"), [[0.0, 0.1], [0.2, 0.0], [0.0, 0.1]])),
        r"depth_top_m = \[0.2, 0.0\]: must be strictly increasing.*snowpack at 2024-02-02",
    ),
    "layers": (
        lambda ds: ds.assign_coords(layer=[1, 1]), r"layer = \[1.0, 1.0\]: must be strictly incr"
    ),
    "dimensions": (
        lambda ds: ds.expand_dims(point=[0, 1]), r"thickness_m dimensions = .*must be over"
    ),
    "zenith over layers": (
        lambda ds: ds.assign(sun_zenith_deg=ds.thickness_m), "sun_zenith_deg dimensions"
    ),
    "text": (lambda ds: ds.assign(density_kg_m3=ds.density_kg_m3.astype(str)), "density_kg_m3 = "),
    "empty": (lambda ds: ds.isel(time=[]), "time = 'no values': must be at least one"),
    "array": (lambda ds: ds.thickness_m, "data = 'DataArray': must be an xarray.Dataset or a"),
    "path": (lambda ds: "a.csv", r"splits.read_snow_packs\('a.csv'\) reads files"),
}  # fmt: skip


@pytest.mark.parametrize("name", STRUCTURAL_ERRORS)
def test_structural_errors_raise_one_line(name):
    change, message = STRUCTURAL_ERRORS[name]
    with pytest.raises(InvalidValue, match=message) as error:
        splits.SnowPacks(change(make_dataset()))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda df: pd.concat([df, df[:1]]), "time, layer = '2024-02-01 00:00:00, 0'"),
        (lambda df: df.drop(columns="layer"), "layer = None: must be a column .it counts"),
        (lambda df: df.drop(columns="time"), "time = None: must be a column"),
        (lambda df: df[:0], "data = 'no rows'"),
        (lambda df: df.assign(time=[pd.NaT, *df.time[1:]]), "time = 'a gap'"),
        (lambda df: df.assign(sun_zenith_deg=range(6)), r"sun_zenith_deg = \[0.0, 1.0\]: must be"),
        (lambda df: df.assign(depth_top_m=[0.0, 0.1, 0.0, 0.1, 0.3, 0.2]), r"depth_top_m = \[0.3"),
    ],
)
def test_structural_errors_of_tables_raise_one_line(change, message):
    with pytest.raises(InvalidValue, match=message) as error:
        splits.SnowPacks(change(make_dataset().to_dataframe().reset_index()))
    assert "\n" not in str(error.value)


def test_increasing_depths_with_gaps_in_absent_layers_are_accepted():
    depths = (("time", "layer"), [[0.0, 0.1], [0.0, NAN], [0.0, 0.05]])
    absent = {n: make_dataset()[n].where(np.array([[1, 1], [1, 0], [1, 1]]))
              for n in make_dataset()}  # fmt: skip
    packs = splits.SnowPacks(make_dataset().assign(absent).assign(depth_top_m=depths))
    assert packs.is_good.all() and "depth_top_m" not in packs.dataset


# --- flags ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "flag"),
    [
        ("density_kg_m3", NAN, "missing_value"), ("thickness_m", NAN, "missing_value"),
        ("specific_surface_area_m2_kg", NAN, "missing_value"),
        ("density_kg_m3", np.inf, "missing_value"), ("density_kg_m3", 9.0, "out_of_range"),
        ("density_kg_m3", 917.0, "out_of_range"), ("density_kg_m3", 10.0, "good"),
        ("thickness_m", -0.1, "out_of_range"), ("thickness_m", 1.1e4, "out_of_range"),
        ("specific_surface_area_m2_kg", 0.1, "out_of_range"),
        ("specific_surface_area_m2_kg", 0.2, "good"),
        ("specific_surface_area_m2_kg", 2000.0, "good"),
        ("specific_surface_area_m2_kg", 2001.0, "out_of_range"),
    ],
)  # fmt: skip
def test_a_value_of_one_layer_flags_its_snowpack_only(name, value, flag):
    assert list_flags(**replace(name, (1, 1), value)) == ["good", flag, "good"]


@pytest.mark.parametrize(
    ("name", "values", "flags"),
    [
        ("temperature_c", [0.0, 0.1, -40.1], ["good", "out_of_range", "out_of_range"]),
        ("temperature_c", [1e-13, NAN, -40.0], ["good", "missing_value", "good"]),
        ("liquid_water_content", [0.6, 0.9, -0.01], ["good", "out_of_range", "out_of_range"]),
        (SOOT, [1e8, -1.0, 1.1e8], ["good", "out_of_range", "out_of_range"]),
        (SOOT, [0.0, NAN, 1.0], ["good", "missing_value", "good"]),
    ],
)
def test_optional_variables_are_checked(name, values, flags):
    assert list_flags(**{name: ("time", values)}) == flags


def test_night_has_the_lowest_priority():
    zenith = ("time", [89.9, 90.0, 120.0])
    assert list_flags(sun_zenith_deg=zenith) == ["good", "night", "night"]
    gap = replace("density_kg_m3", (2, 0), NAN)
    assert list_flags(sun_zenith_deg=zenith, **gap) == ["good", "night", "missing_value"]
    wrong = ("time", [-1.0, 181.0, NAN])
    assert list_flags(sun_zenith_deg=wrong) == ["out_of_range", "out_of_range", "missing_value"]


@pytest.mark.parametrize("thickness", [0.0, NAN])
def test_snowpacks_without_layers_have_no_snow(thickness):
    changes = {n: v.values.copy() for n, v in make_dataset().items()}
    for name, values in changes.items():
        values[1] = thickness if name == "thickness_m" else NAN
    packs = splits.SnowPacks(make_dataset(**changes))
    assert list_flags(**changes) == ["good", "no_snow", "good"]
    row = packs.dataset.isel(time=1)
    assert (row.layer_flag == 1).all()
    assert all(np.isnan(row[name]).all() for name in [*changes, "temperature_c"])


def test_layers_of_zero_thickness_are_absent_and_the_others_move_up():
    packs = splits.SnowPacks(make_dataset(**replace("thickness_m", (0, 0), 0.0)))
    row = packs.dataset.isel(time=0)
    assert row.layer_flag.values.tolist() == [0, 1]
    np.testing.assert_array_equal(row.density_kg_m3, [300.0, NAN])
    assert packs.is_good.all()


def test_variables_of_whole_snowpacks_do_not_make_layers_present():
    changes = {n: v.values.copy() for n, v in make_dataset().items()}
    for values in changes.values():
        values[0, 1] = NAN
    assert list_flags(**changes, temperature_c=("time", [-2.0] * 3)) == ["good"] * 3
    assert list_flags(**changes, temperature_c=[[-2.0] * 2] * 3)[0] == "missing_value"


def test_zenith_angles_are_matched_to_the_snowpacks():
    packs = splits.SnowPacks(make_dataset())
    zenith = pd.Series([95.0, 60.0, 50.0], TIMES[::-1])
    assert packs.with_sun_zenith(zenith).count_flags()["night"] == 1
    assert packs.with_sun_zenith(zenith).dataset.sun_zenith_deg.values.tolist() == [50, 60, 95]
    assert packs.with_sun_zenith(100.0).count_flags()["night"] == 3
    assert "sun_zenith_deg" not in packs.dataset
    with pytest.raises(InvalidValue, match=r"sun_zenith_deg = .*must be a number, or 3 numbers"):
        packs.with_sun_zenith([1.0, 2.0])
    with pytest.raises(InvalidValue, match=r"sun_zenith_deg = .values at"):
        packs.with_sun_zenith(pd.Series([1.0, 2.0, 3.0], TIMES + pd.Timedelta("1h")))


# --- stacks, arrays, files ------------------------------------------------------------------------


def make_mixed():
    """Return three snowpacks: of two layers, with a gap, and of one layer."""
    changes = replace("density_kg_m3", (1, 0), NAN) | replace("thickness_m", (2, 1), 0.0)
    water = [[0.01, 0.0]] * 3
    return splits.SnowPacks(
        make_dataset(
            **changes, liquid_water_content=water, temperature_c=[[0.0, -5.0]] * 3,
            **{SOOT: [[30.0, 3.0]] * 3}, sun_zenith_deg=("time", [50.0, 55.0, 60.0]),
        )
    )  # fmt: skip


def test_good_snowpacks_become_stacks():
    stacks = dict(make_mixed().iterate_stacks(ground=0.2))
    assert list(stacks) == [TIMES[0], TIMES[2]]
    expected = splits.Snow.natural(
        depth_m=0.1, density_kg_m3=120, specific_surface_area_m2_kg=40, temperature_c=0.0,
        liquid_water_content=0.01, impurities_ng_g={"black_carbon": 30.0},
    )  # fmt: skip
    assert stacks[TIMES[0]].layers[0] == expected
    assert [len(stack.layers) for stack in stacks.values()] == [2, 1]
    assert make_mixed().make_stack(TIMES[2], ground=0.2) == stacks[TIMES[2]]


def test_snowpacks_at_the_limits_become_stacks():
    changes = {
        "density_kg_m3": [[10.0, 300.0], [916.0, 300.0], [300.0, 300.0]],
        "specific_surface_area_m2_kg": [[0.2, 2000.0], [2000.0, 0.2], [10.0, 10.0]],
        "temperature_c": [[-40.0, 0.0], [0.0, -40.0], [0.0, 0.0]],
        "liquid_water_content": [[0.0, 0.0], [0.0, 0.0], [1.0 - 300.0 / ice_density(0.0)] * 2],
    }
    packs = splits.SnowPacks(make_dataset(**changes))
    assert packs.is_good.all() and len(list(packs.iterate_stacks())) == len(packs) == 3


@pytest.mark.parametrize(
    ("label", "message"),
    [(TIMES[1], "must be a good snowpack.*quality_flag is missing_value"),
     ("2030-01-01", "such as 2024-02-01"), (3.5, "must be the label of a snowpack"),
     ([1], "must be the label of a snowpack")],
)  # fmt: skip
def test_other_labels_have_no_stack(label, message):
    with pytest.raises(InvalidValue, match=message):
        make_mixed().make_stack(label)


def test_good_snowpacks_have_one_number_of_layers_without_nan():
    good = make_mixed().select_good()
    assert good.get_index("time").equals(TIMES[[0, 2]])
    assert good.n_layers.values.tolist() == [2, 1]
    assert good.thickness_m.values.tolist() == [[0.1, 0.4], [0.05, 0.0]]
    assert good.density_kg_m3.values.tolist() == [[120.0, 300.0], [200.0, 200.0]]
    assert good[SOOT].values.tolist() == [[30.0, 3.0], [30.0, 30.0]]
    assert good.sun_zenith_deg.values.tolist() == [50.0, 60.0]
    flagged = splits.SnowPacks(make_dataset(density_kg_m3=[[NAN] * 2] * 3)).select_good()
    assert flagged.thickness_m.shape == (0, 0) and "sun_zenith_deg" not in flagged


def test_files_restore_the_snowpacks(tmp_path):
    for name, packs in {"a": make_mixed(), "b": make_labelled(), "c": make_stacked()}.items():
        splits.save(packs.dataset, tmp_path / f"{name}.nc")
        again = splits.SnowPacks(splits.load(tmp_path / f"{name}.nc"))
        xr.testing.assert_equal(again.dataset, packs.dataset)
        assert repr(again) == repr(packs)


def make_labelled():
    return splits.SnowPacks(make_dataset().assign_coords(time=["b", "a", "c"]))


def make_stacked():
    grid = make_dataset().expand_dims(point=[4, 7])
    return splits.SnowPacks(grid.stack(snowpack=("time", "point")))


def test_stacked_dimensions_are_one_label():
    packs = make_stacked()
    assert packs.label == "snowpack" and len(packs) == 6
    assert len(packs.make_stack((TIMES[1], 7)).layers) == 2
    assert packs.with_sun_zenith(np.full(6, 100.0)).count_flags()["night"] == 6


@pytest.mark.slow
def test_files_follow_the_cf_conventions(tmp_path):
    path = tmp_path / "season.nc"
    splits.save(make_mixed().dataset, path)
    assert collect_remarks([path]) == {path: []}


def test_the_representation_counts_flags():
    text = "SnowPacks(3 over time, at most 2 layers: 2 good, 1 missing_value)"
    assert repr(make_mixed()) == text


def test_input_is_not_modified():
    dataset = make_dataset(**replace("thickness_m", (0, 0), 0.0))
    copy = dataset.copy(deep=True)
    splits.SnowPacks(dataset)
    xr.testing.assert_identical(dataset, copy)


SUN_AND_SOOT = {"sun_zenith_deg": ("time", [50.0] * 3), SOOT: [[3.0, 3.0]] * 3}


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("thickness_m", -0.1, "layers.1.thickness_m = -0.1: must be in (0, 10000] m"),
        ("thickness_m", 20_000, "(in centimetres? write 200;"),
        (
            "density_kg_m3",
            0.3,
            "density_kg_m3 = 0.3: must be in [10, 916.9) kg/m3 (in g/c",
        ),
        (
            "specific_surface_area_m2_kg",
            3000,
            "layers.1.specific_surface_area_m2_kg = 3000.0: ",
        ),
        (
            "temperature_c",
            270.15,
            "layers.1.temperature_c = 270.15: must be in [-40, 0] °C (",
        ),
        ("liquid_water_content", 2, "layers.1.liquid_water_content = 2.0: must be in [0, 0.6619"),
        (SOOT, -1, f"layers.1.{SOOT} = -1.0: must be in [0, "),
        ("sun_zenith_deg", 200, "sun_zenith_deg = 200.0: must be in [0, 180] degrees"),
        ("ground_albedo", 80, "ground = 80.0: must be in [0, 1] (in per cent? write 0.8)"),
    ],
)
def test_the_first_value_out_of_range_is_named(name, value, message):
    dataset = make_dataset(**replace("density_kg_m3", (0, 0), NAN)).assign(
        temperature_c=(("time", "layer"), np.full((3, 2), -1.0)),
        liquid_water_content=(("time", "layer"), np.zeros((3, 2))),
        ground_albedo=("time", [0.2] * 3), **make_dataset(**SUN_AND_SOOT)[[*SUN_AND_SOOT]],
    )  # fmt: skip
    assert "comment" not in splits.SnowPacks(dataset).dataset.quality_flag.attrs
    # A missing value of another snowpack comes before, and does not matter.
    for row in ((0, 1), (1, 1), (2, 1)):
        dataset[name][row if dataset[name].ndim == 2 else row[0]] = value
    packs = splits.SnowPacks(dataset)
    start = "out of range: time 2024-02-02 00:00:00: "
    comment = packs.dataset.quality_flag.attrs["comment"]
    assert comment.startswith(start) and message in comment
    with pytest.raises(InvalidValue, match="quality_flag is out_of_range: ") as error:
        packs.make_stack(TIMES[1])
    assert comment.removeprefix(start) in str(error.value)


WAVELENGTHS = np.array([500.0, 800.0])


def make_packs(ground=None, **variables):
    dims = ("time", "layer")
    values = {"thickness_m": 0.1, "density_kg_m3": 200.0, "specific_surface_area_m2_kg": 20.0}
    columns = {name: (dims, np.full((3, 2), value)) for name, value in values.items()}
    return splits.SnowPacks(xr.Dataset({**columns, **variables}, {"time": TIMES}), ground=ground)


def list_flag_names(packs):
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
        assert list_flag_names(packs) == ["good"] * 3


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
    assert list_flag_names(make_packs([0.1, np.nan, 1.2])) == [
        "good",
        "missing_value",
        "out_of_range",
    ]


def test_another_ground_replaces_the_first():
    packs = make_packs([0.1, np.nan, 1.2]).with_ground(0.4)
    assert "ground_albedo" not in packs.dataset and list_flag_names(packs) == ["good"] * 3
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
