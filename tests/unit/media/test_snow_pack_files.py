"""Files of snowpacks: CAAML, Crocus, times in UTC, names of variables, and what files hold."""

import datetime
import decimal

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import splits
from splits.core.validation import InvalidValue

NAN = np.nan
NAMESPACE = "http://caaml.org/Schemas/SnowProfileIACS/v6.0.5"


# --- CAAML ----------------------------------------------------------------------------------------


def write_layers(profile, tag, unit, rows):
    """Return the element of a profile; rows are top and thickness (cm) and value."""
    layers = "".join(
        f'<c:Layer><c:depthTop uom="cm">{top}</c:depthTop>'
        + (f'<c:thickness uom="cm">{thickness}</c:thickness>' if thickness is not None else "")
        + (f'<c:{tag} uom="{unit}">{value}</c:{tag}>' if tag else "")
        + "</c:Layer>"
        for top, thickness, value in rows
    )
    return f"<c:{profile}>{layers}</c:{profile}>"


STRATIGRAPHY = write_layers("stratProfile", "", "", [(0, 10, 0), (10, 30, 0), (40, 60, 0)])
DENSITY = write_layers(
    "densityProfile", "density", "kgm-3", [(0, 10, 100), (10, 10, 200), (25, 10, 300), (45, 5, 350)]
)
AREA = write_layers("specSurfAreaProfile", "specSurfArea", "m2kg-1", [(0, 5, 40), (5, 10, 30)])
WATER = write_layers("lwcProfile", "lwc", "% by Vol", [(0, 100, 2.0)])
TEMPERATURE = (
    '<c:tempProfile><c:Obs><c:depth uom="cm">0</c:depth><c:snowTemp uom="degC">-10</c:snowTemp>'
    '</c:Obs><c:Obs><c:depth uom="cm">50</c:depth><c:snowTemp uom="degC">-5</c:snowTemp></c:Obs>'
    "</c:tempProfile>"
)


def write_pit(path, *profiles, time="2024-02-01T11:30:00+01:00", namespace=NAMESPACE, before="",
              direction="top down"):  # fmt: skip
    """Write a CAAML file and return its path."""
    path.write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>{before}<c:SnowProfile xmlns:c="{namespace}">'
        "<c:timeRef><c:recordTime><c:TimeInstant>"
        f"<c:timePosition>{time}</c:timePosition></c:TimeInstant></c:recordTime></c:timeRef>"
        f'<c:snowProfileResultsOf><c:SnowProfileMeasurements dir="{direction}">'
        f"{''.join(profiles)}</c:SnowProfileMeasurements></c:snowProfileResultsOf></c:SnowProfile>",
        encoding="utf-8",
    )
    return path


def test_profiles_are_averaged_over_their_overlap_with_layers(tmp_path):
    packs = splits.read_caaml(write_pit(tmp_path / "a.xml", STRATIGRAPHY, DENSITY, AREA))
    row = packs.dataset.isel(time=0)
    assert row.time.values == np.datetime64("2024-02-01T10:30")
    np.testing.assert_allclose(row.thickness_m, [0.1, 0.3, 0.6])
    np.testing.assert_allclose(row.density_kg_m3, [100.0, 250.0, 350.0])
    # The second layer overlaps the second interval, the third one lies below both.
    np.testing.assert_allclose(row.specific_surface_area_m2_kg, [35.0, 30.0, 30.0])
    assert (row.temperature_c == -1.0).all() and (row.liquid_water_content == 0.0).all()
    assert packs.is_good.all()


def test_temperatures_are_interpolated_and_water_is_subtracted(tmp_path):
    path = write_pit(tmp_path / "a.xml", STRATIGRAPHY, DENSITY, AREA, WATER, TEMPERATURE)
    row = splits.read_caaml(str(path)).dataset.isel(time=0)
    np.testing.assert_allclose(row.temperature_c, [-9.5, -7.5, -5.0])
    np.testing.assert_allclose(row.liquid_water_content, 0.02)
    np.testing.assert_allclose(row.density_kg_m3, [80.0, 230.0, 330.0])


def test_layers_beyond_the_measurements_may_be_missing(tmp_path):
    path = write_pit(tmp_path / "a.xml", STRATIGRAPHY, DENSITY, AREA)
    packs = splits.read_caaml(path, extend=False)
    assert packs.count_flags()["missing_value"] == 1
    area = packs.dataset.specific_surface_area_m2_kg.values[0]
    np.testing.assert_allclose(area, [35.0, 30.0, NAN])


def test_stratigraphy_may_be_in_any_order_incomplete_or_absent(tmp_path):
    layers = [(10, None, 0), (0, 10, 0), (40, 60, 0)]
    reordered = write_layers("stratProfile", "", "", layers)
    packs = splits.read_caaml(write_pit(tmp_path / "a.xml", reordered, DENSITY, AREA))
    np.testing.assert_allclose(packs.dataset.thickness_m[0], [0.1, 0.3, 0.6])
    gap = write_layers("stratProfile", "", "", [(0, 10, 0), (40, 60, 0)])
    packs = splits.read_caaml(write_pit(tmp_path / "a.xml", gap, DENSITY, AREA))
    np.testing.assert_allclose(packs.dataset.thickness_m[0], [0.1, 0.3, 0.6])
    assert packs.count_flags()["missing_value"] == 1
    packs = splits.read_caaml(write_pit(tmp_path / "a.xml", DENSITY, AREA))
    np.testing.assert_allclose(
        packs.dataset.thickness_m[0], [0.05, 0.05, 0.05, 0.05, 0.05, 0.1, 0.1, 0.05]
    )
    assert splits.read_caaml(write_pit(tmp_path / "a.xml")).count_flags()["no_snow"] == 1
    unknown = STRATIGRAPHY.replace(">60<", ">unknown<")
    packs = splits.read_caaml(write_pit(tmp_path / "a.xml", unknown, DENSITY, AREA))
    assert packs.count_flags()["missing_value"] == 1


def test_several_files_are_one_dataset(tmp_path):
    paths = [
        write_pit(tmp_path / "a.xml", STRATIGRAPHY, DENSITY, AREA),
        write_pit(tmp_path / "b.xml", STRATIGRAPHY, DENSITY, time="2024-03-01T12:00:00"),
        write_pit(tmp_path / "c.xml", time="2024-05-01T12:00:00Z"),
    ]
    packs = splits.read_caaml(paths)
    assert packs.dataset.quality_flag.values.tolist() == [0, 2, 1]
    assert packs.dataset.time.values[1] == np.datetime64("2024-03-01T12:00")
    named = splits.read_caaml(paths, label="file")
    assert named.dataset.file.values.tolist() == ["a.xml", "b.xml", "c.xml"]
    with pytest.raises(InvalidValue, match="time = '2024-02-01 10:30:00': must be different"):
        splits.read_caaml([paths[0], paths[0]])
    with pytest.raises(InvalidValue, match="label = 'site': must be one of file, time"):
        splits.read_caaml(paths, label="site")
    with pytest.raises(InvalidValue, match=r"path = .*at least one file"):
        splits.read_caaml([])


BOMB = '<!DOCTYPE bomb [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;">]>'
OVERLAP = write_layers("stratProfile", "", "", [(0, 10, 0), (5, 30, 0)])


@pytest.mark.parametrize(
    ("profiles", "options", "message"),
    [
        ((), {"before": BOMB}, "a.xml: DOCTYPE = 'given': must be left out"),
        ((), {"namespace": NAMESPACE.replace("6.0.5", "5.0")}, "must be a SnowProfile of Snow"),
        ((), {"time": "yesterday at noon"}, "a.xml: timePosition = 'yesterday at noon'"),
        ((), {"direction": "bottom up"}, "a.xml: dir = 'bottom up': must be top down"),
        ((OVERLAP,), {}, "a.xml: depthTop = 0.05: must be below the layer above it"),
        ((STRATIGRAPHY, DENSITY.replace("kgm-3", "N")), {}, "a.xml: density.units = 'N'"),
        ((STRATIGRAPHY, DENSITY.replace(">200<", ">heavy<")), {}, "density = 'heavy': must be a"),
        (("<c:open>",), {}, "path = 'a.xml': must be an XML file of CAAML .mismatched tag"),
    ],
)
def test_invalid_files_raise_one_line(tmp_path, profiles, options, message):
    path = write_pit(tmp_path / "a.xml", *profiles, **options)
    with pytest.raises(InvalidValue, match=message) as error:
        splits.read_caaml(path)
    assert "\n" not in str(error.value)


# --- Crocus ---------------------------------------------------------------------------------------


def make_output(**units):
    """Return output of Crocus for three times, three layers and two points."""
    dims = ("time", "snow_layer", "Number_of_points")
    thickness = np.full((3, 3, 2), 0.1)
    thickness[0, 2], thickness[1] = 1e20, 0.0
    present = (thickness > 0.0) & (thickness < 1e20)
    fields = {
        "SNOWDZ": (thickness, "m"), "RSN_VEG": (np.where(present, 300.0, 1e20), "kg/m3"),
        "SNOWSSA": (np.where(present, 20.0, 1e20), "m2/kg"),
        "SNOWLIQ": (np.where(present, 30.0, 0.0), "kg/m3"),
        "SNOWTEMP": (np.where(present, np.float32(273.16), 1e20), "K"),
        "SNOWIMP1": (np.where(present, 9e-8, 0.0), "g/g"),
        "SNOWIMP2": (np.where(present, 9e-6, 0.0), "g/g"),
    }  # fmt: skip
    variables = {
        name: (dims, values, {"units": units.get(name, unit)})
        for name, (values, unit) in fields.items()
    }
    variables["WSN_T_ISBA"] = (("time", "Number_of_points"), np.full((3, 2), 60.0))
    times = pd.date_range("2024-01-01", periods=3, freq="6h")
    return xr.Dataset(variables, {"time": times})


def test_output_is_converted():
    packs = splits.read_crocus(make_output(), point=1)
    assert packs.label == "time"
    assert packs.dataset.quality_flag.values.tolist() == [0, 1, 0]
    assert packs.dataset.layer_flag.values.tolist() == [[0, 0, 1], [1, 1, 1], [0, 0, 0]]
    layer = packs.dataset.isel(time=2, layer=0)
    assert layer.liquid_water_content == pytest.approx(0.03)
    assert layer.density_kg_m3 == pytest.approx(270.0)
    assert layer.temperature_c == 0.0
    assert layer["impurities_ng_g.black_carbon"] == pytest.approx(90.0 / 0.9)
    assert layer["impurities_ng_g.dust_sahara"] == pytest.approx(9000.0 / 0.9)
    assert len(packs.make_stack("2024-01-01T12:00").layers) == 3


def test_all_points_are_pairs_with_the_time():
    packs = splits.read_crocus(make_output())
    assert packs.label == "snowpack" and len(packs) == 6
    assert packs.count_flags() == splits.SnowPacks(packs.dataset).count_flags()
    assert packs.count_flags()["no_snow"] == 2


def test_files_of_one_point_and_patches_are_read(tmp_path):
    path = tmp_path / "PRO.nc"
    output = make_output().isel(Number_of_points=[0])
    encoding = {name: {"_FillValue": 1e20} for name in output.data_vars}
    output.expand_dims(Number_of_Patches=[0]).to_netcdf(path, encoding=encoding)
    packs = splits.read_crocus(path)
    expected = splits.read_crocus(make_output(), point=0)
    xr.testing.assert_equal(packs.dataset, expected.dataset)
    splits.save(packs.dataset, tmp_path / "packs.nc")
    assert splits.load(tmp_path / "packs.nc").equals(packs.dataset)


def test_units_in_descriptions_and_depths_of_water_are_read():
    output = make_output(SNOWLIQ="")
    output["SNOWLIQ"].attrs = {"comment": "snow liquid water (m)"}
    output["SNOWLIQ"] = output.SNOWLIQ.copy(data=output.SNOWLIQ.values * 0.1 / 1000.0)
    output = output.rename(RSN_VEG="SNOWRO", time="Time")
    packs = splits.read_crocus(output, point=0)
    expected = splits.read_crocus(make_output(), point=0)
    xr.testing.assert_allclose(packs.dataset, expected.dataset)


def test_impurities_are_chosen():
    packs = splits.read_crocus(make_output(), impurities={"SNOWIMP2": "dust_colorado"}, point=0)
    assert packs.impurities == ("dust_colorado",)
    assert splits.read_crocus(make_output(), impurities={}, point=0).impurities == ()


def test_bad_layers_flag_their_snowpack():
    output = make_output().isel(Number_of_points=0)
    output["SNOWSSA"][0, 0] = 1e20
    output["RSN_VEG"][2, 1] = 950.0
    packs = splits.read_crocus(output)
    assert packs.dataset.quality_flag.values.tolist() == [2, 1, 3]


PATCHES = make_output().expand_dims(tile=[0, 1])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: splits.read_crocus(make_output().drop_vars("SNOWLIQ")), "SNOWLIQ = None: must be"),
        (lambda: splits.read_crocus(make_output(SNOWLIQ="")), "SNOWLIQ.units = None: must be kg"),
        (lambda: splits.read_crocus(make_output(SNOWLIQ="kg")), "SNOWLIQ.units = 'kg'"),
        (lambda: splits.read_crocus(make_output(SNOWDZ="kg/m2")), "SNOWDZ.units = 'kg/m2'"),
        (lambda: splits.read_crocus(make_output(), point=2), "point = 2: must be a whole number"),
        (lambda: splits.read_crocus(make_output(), patch=0), "patch = 0: must be left out"),
        (lambda: splits.read_crocus(PATCHES), "patch = None: must be a whole number from 0 to 1"),
        (lambda: splits.read_crocus(make_output().rename(time="t")), "SNOWDZ dimensions"),
        (lambda: splits.read_crocus(make_output(), impurities=["SNOWIMP1"]), "impurities = "),
        (lambda: splits.read_crocus(make_output(), impurities={"SNOWIMP3": "dust_sahara"}),
         "impurities = 'SNOWIMP3': must be one of SNOWIMP1, SNOWIMP2"),
        (lambda: splits.read_crocus(make_output(), impurities={"SNOWIMP1": "soot"}),
         "impurities_ng_g = 'soot'.*did you mean black_carbon"),
        (lambda: splits.read_crocus(
            make_output(), impurities={"SNOWIMP1": "dust_sahara", "SNOWIMP2": "dust_sahara"}
        ), "different types"),
    ],
)  # fmt: skip
def test_invalid_output_raises_one_line(call, message):
    with pytest.raises(InvalidValue, match=message) as error:
        call()
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named():
    with pytest.raises(FileNotFoundError, match=r"none\.nc: no such file"):
        splits.read_crocus("none.nc")


# --- files of any format --------------------------------------------------------------------------


def test_files_of_all_formats_are_read(tmp_path):
    pits = [
        write_pit(tmp_path / f"{day}.caaml", STRATIGRAPHY, DENSITY, AREA, time=f"2024-02-0{day}")
        for day in (1, 2)
    ]
    names = [str(one) for one in pits]
    packs = splits.read_caaml(pits).with_ground(0.3)
    assert splits.read_snow_packs(names, ground=0.3).dataset.equals(packs.dataset)
    assert splits.read_snow_packs(names[0], ground=0.3).dataset.equals(packs.dataset.isel(time=[0]))
    splits.save(packs.dataset, tmp_path / "own.nc")
    assert splits.read_snow_packs(str(tmp_path / "own.nc")).dataset.equals(packs.dataset)
    make_output().to_netcdf(tmp_path / "crocus.nc")
    crocus = splits.read_snow_packs(str(tmp_path / "crocus.nc"), point=1)
    assert crocus.dataset.equals(splits.read_crocus(make_output(), point=1).dataset)
    table = packs.dataset.drop_vars(["quality_flag", "layer_flag"]).to_dataframe().reset_index()
    table.dropna().to_csv(tmp_path / "own.csv", index=False)
    dates = splits.read_snow_packs(str(tmp_path / "own.csv")).dataset.time
    assert dates.equals(packs.dataset.time)


@pytest.mark.parametrize("file", ["none.csv", "season.txt", [], ["a.csv", "b.csv"], 5, None])
def test_invalid_files_are_named(file):
    with pytest.raises(InvalidValue, match=r"^file = "):
        splits.read_snow_packs(file)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda ds: ds.assign_coords(snow_layer=[3, 2, 1]).isel(snow_layer=[2, 1, 0]), None),
        (lambda ds: ds.rename(snow_layer="layer").assign_coords(layer=[5, 6, 7]), None),
        (lambda ds: ds.assign_coords(snow_layer=("snow_layer", [1, 2, 3], {"positive": "up"})),
         "layer.positive = 'up': must be down"),
        (lambda ds: ds.assign_coords(snow_layer=["a", "b", "c"]), "must be numbers, the smallest"),
        (lambda ds: ds.rename(Number_of_points="Time"), "SNOWDZ dimensions = .*one of time, Time"),
        (lambda ds: ds.rename(Number_of_points="layer"), "SNOWDZ dimensions = .*snow_layer, layer"),
        (lambda ds: ds.rename(Number_of_points="snowpack"), "SNOWDZ dim.*without snowpack"),
        (lambda ds: ds.rename(Number_of_points="quality_flag"), "label = 'quality_flag'"),
    ],
)  # fmt: skip
def test_coordinates_of_crocus_are_obeyed_or_refused(change, expected):
    output = make_output()
    if expected is None:
        found, packs = splits.read_crocus(change(output)), splits.read_crocus(output)
        assert found.dataset.equals(packs.dataset)
        return
    with pytest.raises(InvalidValue, match=expected) as error:
        splits.read_crocus(change(output))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("unit", ["fortnights since 2000-01-01", "days since the flood"])
def test_files_that_cannot_be_decoded_raise_one_line(tmp_path, unit):
    times = ("time", [0.0, 1.0, 2.0], {"units": unit})
    make_output().assign_coords(time=times).to_netcdf(tmp_path / "bad.nc")
    (tmp_path / "pit.caaml").write_text("<a/>", encoding="utf-8")
    for read, name in (
        (splits.read_crocus, "bad.nc"), (splits.read_snow_packs, "bad.nc"),
        (splits.read_crocus, "pit.caaml"),
    ):  # fmt: skip
        with pytest.raises(InvalidValue, match=r"must be a netCDF file that can be read") as error:
            read(tmp_path / name)
        assert "\n" not in str(error.value)
    for read in (splits.load, splits.Table):
        with pytest.raises(ValueError, match=r"bad\.nc: damaged, cannot be read") as error:
            read(tmp_path / "bad.nc")
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("encoding", ["foo-8", "utf-7", "shift_jis", "idna", "rot13", "utf-32"])
def test_other_encodings_of_xml_raise_one_line(tmp_path, encoding):
    path = tmp_path / "pit.caaml"
    path.write_text(f'<?xml version="1.0" encoding="{encoding}"?><a>é</a>', encoding="utf-8")
    with pytest.raises(InvalidValue, match=r"path = 'pit.caaml': must be an XML file") as error:
        splits.read_caaml(path)
    assert "\n" not in str(error.value)


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
