"""Labels and files of snowpacks: times in UTC, names of variables, and what files hold."""

from __future__ import annotations

import datetime
import decimal

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import splits
from splits.core.validation import InvalidValue

HEADER = "time,layer,thickness_m,density_kg_m3,specific_surface_area_m2_kg"
ROW = ",0,0.1,200,20"
PARIS = "Europe/Paris"


def make_frame(labels, name="time"):
    """Return a table of snowpacks of one layer."""
    values = {"thickness_m": 0.1, "density_kg_m3": 200.0, "specific_surface_area_m2_kg": 20.0}
    return pd.DataFrame({name: labels, "layer": 0, **values})


def read_csv(folder, *lines, encoding="utf-8"):
    path = folder / "season.csv"
    path.write_bytes("\n".join([*lines, ""]).encode(encoding))
    return splits.read_snow_packs(path)


# --- CSV files ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["20240131", "01.02.2024", "1/2/2024", "2024", "2024-01", "2024-W05", "now", "", "NaN",
             "2024-02-30", "2024-01-31T25:00", "2024-01-31 10:00 CET", "1706659200", "0999-01-01"]
)  # fmt: skip
def test_times_of_other_forms_are_refused_with_their_line(tmp_path, text):
    message = rf"^file = .*\(line 3: time is {text or 'a gap'}; write ISO 8601"
    with pytest.raises(InvalidValue, match=message) as error:
        read_csv(tmp_path, HEADER, f"2024-01-30{ROW}", text + ROW)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2024-01-31", "2024-01-31T00:00"), ("2024-01-31T10:00", "2024-01-31T10:00"),
        ("2024-01-31 10:00:30.5", "2024-01-31T10:00:30.5"), ("2024-01-31T10:00Z", "2024-01-31T10"),
        ("2024-01-31T10:00+01:00", "2024-01-31T09:00"),
        ("2024-01-31T22:00-0330", "2024-02-01T01:30"),
    ],
)  # fmt: skip
def test_times_are_in_utc(tmp_path, text, expected):
    packs = read_csv(tmp_path, HEADER, text + ROW, f"2024-03-01{ROW}")
    assert packs.dataset.time.values[0] == np.datetime64(expected)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((HEADER, f"2024-01-31{ROW},"), "fields in line 2: 6, in the header: 5; a comma too many"),
        ((), "it has no rows"),
        ((HEADER, '2024-01-31,"0,0.1,200,20'), "line 2: unexpected end of data"),
        ((HEADER, "2024-01-31,0,0.1,200,1 000"), "line 2: specific_surface_area_m2_kg is 1 000"),
        ((HEADER + ",Größe", f"2024-01-31{ROW},1"), "line 1: it is not text in UTF-8"),
        ((HEADER, f"2024-01-31{ROW} # größer"), "line 2: it is not text in UTF-8"),
        ((HEADER.replace("layer,", ""), "2024-01-31,0.1,200,20"), "no column layer; it counts"),
        ((HEADER.replace("layer", "layers"), f"2024-01-31{ROW}"), "layer; did you mean layers"),
        ((HEADER + ",thickness", f"2024-01-31{ROW},1"), "thickness: unknown key"),
    ],
)  # fmt: skip
def test_ambiguous_csv_files_are_refused(tmp_path, lines, message):
    if "#" in "".join(lines):
        # A comment may be in any encoding.
        assert len(read_csv(tmp_path, *lines, encoding="latin-1")) == 1
        return
    with pytest.raises(ValueError, match=message) as error:
        read_csv(tmp_path, *lines, encoding="latin-1")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("ground", [None, 0.3, "black", "camborthid", [0.1, 0.2]])
def test_the_ground_survives_a_table(tmp_path, ground):
    packs = splits.SnowPacks(make_frame(pd.date_range("2024", periods=2)), ground=ground)
    frame = packs.dataset.drop_vars(["quality_flag", "layer_flag"]).to_dataframe()
    assert repr(splits.SnowPacks(frame)) == repr(packs)
    frame.to_csv(tmp_path / "own.csv")
    assert splits.read_snow_packs(tmp_path / "own.csv").dataset.equals(packs.dataset)


def test_points_are_those_of_crocus_only(tmp_path):
    path = tmp_path / "own.nc"
    splits.save(splits.SnowPacks(make_frame([1, 2])).dataset, path)
    with pytest.raises(InvalidValue, match="point = 0: must be left out"):
        splits.read_snow_packs(path, point=0)


# --- labels ---------------------------------------------------------------------------------------

KEPT_LABELS = {
    "mixed offsets": [pd.Timestamp("2024-01-01T10+01:00"), pd.Timestamp("2024-01-02T10-03:00")],
    "zone": pd.date_range("2024", periods=2, tz=PARIS),
    "zone and none": [pd.Timestamp("2024", tz=PARIS), pd.Timestamp("2025")],
    "dates": [datetime.date(2024, 1, 1), datetime.date(2024, 1, 2)],
    "datetimes": [datetime.datetime(2024, 1, 1), datetime.datetime(2024, 1, 2)],
    "other calendar": xr.date_range("2024", periods=2, calendar="noleap", use_cftime=True),
    "texts": ["Weißfluhjoch", ""], "category": pd.Categorical(["a", "b"]),
    "nullable": pd.array([1, 2], dtype="Int64"), "floats": [1.5, np.inf], "truth": [True, False],
    "durations": pd.to_timedelta([1, 2], unit="s"), "bytes": [b"a", b"b"],
}  # fmt: skip
REFUSED_LABELS = {
    "tuples": [(1, 2), (3, 4)], "periods": pd.period_range("2024", periods=2, freq="Y"),
    "mixed": [1, "a"], "complex": [1j, 2j], "decimals": [decimal.Decimal(1), decimal.Decimal(2)],
    "intervals": pd.interval_range(0, 2), "NUL": ["a\0b", "c"], "surrogates": ["a\ud800", "c"],
    "huge": [2**70, 2**71], "clock": [datetime.time(1), datetime.time(2)],
    "old": [datetime.datetime(1, 1, 1), datetime.datetime(2, 1, 1)],
}  # fmt: skip


@pytest.mark.parametrize("name", KEPT_LABELS)
def test_labels_that_are_taken_are_kept_in_files(tmp_path, name):
    frame = make_frame([1, 2]).set_index(["time", "layer"]).to_xarray()
    data = [frame.assign_coords(time=KEPT_LABELS[name])]
    data += [] if name == "other calendar" else [make_frame(KEPT_LABELS[name])]
    for one in data:
        packs = splits.SnowPacks(one)
        splits.save(packs.dataset, tmp_path / "packs.nc")
        read = splits.load(tmp_path / "packs.nc")
        assert read.equals(packs.dataset)
        assert splits.SnowPacks(read).dataset.equals(packs.dataset)


@pytest.mark.parametrize("name", REFUSED_LABELS)
def test_other_labels_are_refused_at_once(name):
    with pytest.raises(InvalidValue, match=r"^time = ") as error:
        splits.SnowPacks(make_frame(REFUSED_LABELS[name]))
    assert "\n" not in str(error.value)


def test_other_coordinates_are_kept_or_refused(tmp_path):
    data = make_frame([1, 2]).set_index(["time", "layer"]).to_xarray()
    zones = pd.date_range("2024", periods=2, tz=PARIS)
    data = data.assign_coords(when=("time", zones, {"note": None, "by": "me"}), year=2024)
    packs = splits.SnowPacks(data)
    assert packs.dataset.when.values[0] == np.datetime64("2023-12-31T23:00")
    assert packs.dataset.when.attrs == {"by": "me"} and packs.dataset.year == 2024
    splits.save(packs.dataset, tmp_path / "packs.nc")
    with pytest.raises(InvalidValue, match=r"^site = '2024 of type Period"):
        splits.SnowPacks(data.assign_coords(site=pd.Period("2024")))


def test_the_same_instants_in_two_zones_are_one_label():
    twice = [pd.Timestamp("2024-01-01T10:00+01:00"), pd.Timestamp("2024-01-01T09:00")]
    with pytest.raises(InvalidValue, match="time = '2024-01-01 09:00:00': must be different"):
        splits.SnowPacks(make_frame(twice))


@pytest.mark.parametrize(
    "name", ["quality_flag", "layer_flag", "ground", "wavelength", "temperature_c",
             "sun_zenith_deg",
             "impurities_ng_g.black_carbon"],
)  # fmt: skip
def test_labels_have_names_of_their_own(name):
    data = make_frame(["a", "b"]).set_index(["time", "layer"]).to_xarray()
    for given in (data.rename(time=name), data.assign_coords(time=[1, 2]).rename(time=name)):
        with pytest.raises(InvalidValue, match=rf"^label = '{name}': must be a name"):
            splits.SnowPacks(given)
    with pytest.raises(InvalidValue, match=r"^label = "):
        splits.SnowPacks(make_frame(["a", "b"], name), name)


@pytest.mark.parametrize("name", ["reflectance", "absorptance_stderr"])
def test_results_do_not_replace_coordinates(name):
    packs = splits.SnowPacks(make_frame(["a", "b"], name), name)
    with pytest.raises(InvalidValue, match=f"snowpacks = 'with the coordinate {name}'"):
        splits.spectrophotometer(packs, [500.0, 600.0], threads=1)


def test_times_with_a_zone_are_taken_everywhere():
    packs = splits.SnowPacks(make_frame(pd.date_range("2024", periods=2)))
    zoned = pd.date_range("2024-01-01T01:00", periods=2, tz=PARIS)
    angles = pd.Series([60.0, 50.0], zoned[::-1])
    assert packs.with_sun_zenith(angles).dataset.sun_zenith_deg.values.tolist() == [50.0, 60.0]
    albedo = packs.with_ground(angles / 100.0).compute_ground_albedo(np.array([500.0]))
    assert albedo.tolist() == [[0.5], [0.6]]
    assert packs.make_stack(zoned[0]) == packs.make_stack("2024-01-01T00:00")
    with pytest.raises(InvalidValue, match=r"sun_zenith_deg = .values at"):
        packs.with_sun_zenith(pd.Series([60.0, 50.0], pd.date_range("2024", periods=2, tz=PARIS)))


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["2024-01-31", "2024-02-01"], ["2024-01-31T00:00", "2024-02-01T00:00"]),
        (["2024-01-31T10:00+01:00", "2024-01-31 10:00"], ["2024-01-31T09:00", "2024-01-31T10:00"]),
        (pd.Categorical(["2024-01-31", "2024-02-01"]), ["2024-01-31T00:00", "2024-02-01T00:00"]),
    ],
)
def test_texts_of_iso_8601_are_times(texts, expected):
    frame = make_frame(texts)
    for data in (frame, frame.set_index(["time", "layer"]).to_xarray()):
        packs = splits.SnowPacks(data)
        assert (np.sort(packs.dataset.time) == np.array(expected, "datetime64[ns]")).all()
        angles = packs.with_sun_zenith(pd.Series([1.0, 2.0], texts)).dataset.sun_zenith_deg
        assert angles.sel(time=expected).values.tolist() == [1.0, 2.0]
        assert packs.make_stack(texts[0]) == packs.make_stack(pd.Timestamp(expected[0]))


@pytest.mark.parametrize("name", ["time", "visit"])
@pytest.mark.parametrize(
    "text", ["01.02.2024", "1/2/2024", "20240131", "2024/1/31 10:00", "31 Jan 2024", "2024-02-30",
             "January 31, 2024", "2024-01-31T25:00", "20240131T1000"],
)  # fmt: skip
def test_texts_of_other_dates_are_refused(name, text):
    for labels in ([text, text + "0"], ["2024-01-30", text]):
        frame = make_frame(labels, name)
        for data in (frame, frame.set_index([name, "layer"]).to_xarray()):
            with pytest.raises(InvalidValue, match=rf"^{name} = .*must be a time of ISO 8601"):
                splits.SnowPacks(data, name)


def test_texts_that_are_no_dates_are_labels():
    labels = ["1.2.3", "2024", "12345678", "pit 2024-01-31", "2024-01-31.xml", "May 3", "10-20-30"]
    assert splits.SnowPacks(make_frame(labels)).dataset.time.values.tolist() == labels
    with pytest.raises(InvalidValue, match="time = 'pit 3': must be a time of ISO 8601"):
        splits.SnowPacks(make_frame(["2024-01-31", "pit 3"]))


# --- layers ---------------------------------------------------------------------------------------


def test_layers_that_count_over_all_rows_are_refused():
    n_packs = 8760
    frame = pd.concat([make_frame(np.arange(n_packs))] * 2).sort_values("time")
    with pytest.raises(InvalidValue, match=r"layer = '17520 different numbers'.*cumcount"):
        splits.SnowPacks(frame.assign(layer=np.arange(2 * n_packs)))


def test_only_the_order_of_numbers_of_layers_matters():
    frame = pd.concat([make_frame(["a", "b"])] * 2).assign(thickness_m=[0.1, 0.2, 0.3, 0.4])
    packs = splits.SnowPacks(frame.assign(layer=[1e6, 7, -2, 1e6]))
    assert packs.dataset.thickness_m.values.tolist() == [[0.3, 0.1], [0.2, 0.4]]


@pytest.mark.parametrize("positive", ["up", "UP"])
def test_layers_that_count_upwards_are_refused(positive):
    data = make_frame(["a", "b"]).set_index(["time", "layer"]).to_xarray()
    data.layer.attrs["positive"] = positive
    with pytest.raises(InvalidValue, match=r"layer.positive = 'up': must be down"):
        splits.SnowPacks(data)


# --- ground ---------------------------------------------------------------------------------------

TABLES = [{"wavelength_nm": [400.0, 900.0], "albedo": [0.1, one]} for one in (0.2, 0.3)]


def concatenate(*grounds):
    parts = [
        splits.SnowPacks(make_frame([number]), ground=ground).dataset
        for number, ground in enumerate(grounds)
    ]
    return xr.concat(parts, "time")


@pytest.mark.parametrize(
    ("grounds", "expected"),
    [
        ((0.2, 0.8), [0.2, 0.8]), ((0.8, "black"), [0.8, 0.0]), ((0.2, [0.3]), [0.2, 0.3]),
        (([0.3], 0.2), [0.3, 0.2]), ((TABLES[0], TABLES[0]), [0.12, 0.12]),
        ((0.2, 0.2), [0.2, 0.2]),
    ],
)  # fmt: skip
def test_concatenated_snowpacks_keep_their_grounds(tmp_path, grounds, expected):
    data = concatenate(*grounds)
    splits.save(splits.SnowPacks(data).dataset, tmp_path / "packs.nc")
    for one in (data, splits.load(tmp_path / "packs.nc")):
        found = splits.SnowPacks(one).compute_ground_albedo(np.array([500.0]))
        np.testing.assert_allclose(found[:, 0], expected)
    last = splits.SnowPacks(data.isel(time=[1])).compute_ground_albedo(np.array([500.0]))
    np.testing.assert_allclose(last[:, 0], expected[1:])


@pytest.mark.parametrize("grounds", [("open", 0.2), (0.2, "camborthid"), TABLES, (None, "black")])
def test_grounds_that_are_no_albedos_are_not_mixed(grounds):
    data = concatenate(*grounds)
    with pytest.raises(InvalidValue, match=r"^ground = .*must be the same below all snowpacks"):
        splits.SnowPacks(data)
    assert "albedo 0.5" in repr(splits.SnowPacks(data, ground=0.5))
