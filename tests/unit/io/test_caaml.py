"""Texts of CAAML as programs and people write them, and measured profiles assigned to layers."""

import itertools
import tracemalloc

import numpy as np
import pytest
import xarray as xr

import splits
from splits.core.validation import InvalidValue
from splits.io.caaml import DepthProfile, average_over_layers, interpolate_to_layers

SCHEMA = "http://caaml.org/Schemas/SnowProfileIACS/v6.0.3"
TIME = "2016-02-10T09:30:00.000+01:00"
DENSITY, AREA, WATER = ("densityProfile", "density"), ("specSurfAreaProfile", "specSurfArea"), (
    "lwcProfile", "lwc",
)  # fmt: skip
UNITS = {"depthTop": "cm", "thickness": "cm", "density": "kgm-3", "specSurfArea": "m2kg-1",
         "lwc": "% by Vol"}  # fmt: skip
STRATIGRAPHY = [(0, 10, None), (10, 40, None)]


def write_profile(kind, rows, attributes="", units=UNITS, row_attributes=""):
    """Return a profile of layers; rows are depth, thickness and value, None if left out."""
    profile, value = kind
    layers = ""
    for row in rows:
        numbers = ""
        for tag, number in zip(("depthTop", "thickness", value), row, strict=True):
            if number is not None:
                unit = units.get(tag)
                numbers += f"<c:{tag}{'' if unit is None else f' uom={unit!r}'}>{number}</c:{tag}>"
        layers += f"<c:Layer {row_attributes}>{numbers}</c:Layer>"
    return f"<c:{profile} {attributes}>{layers}</c:{profile}>"


def write_points(text, components="", attributes="", order=("depth", "specSurfArea")):
    """Return a profile of points."""
    names = "".join(f"<c:{name}>template</c:{name}>" for name in order)
    return (
        f"<c:specSurfAreaProfile><c:MeasurementComponents {components}>{names}"
        f"</c:MeasurementComponents><c:Measurements><c:tupleList {attributes}>{text}"
        "</c:tupleList></c:Measurements></c:specSurfAreaProfile>"
    )


def write_text(*profiles, time=f"<c:timePosition>{TIME}</c:timePosition>", schema=SCHEMA):
    """Return the text of a file."""
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><c:SnowProfile xmlns:c="{schema}" '
        'xmlns:gml="http://www.opengis.net/gml" xmlns:snp="http://www.slf.ch/snowpack/1.0">'
        f"<c:timeRef><c:recordTime><c:TimeInstant>{time}</c:TimeInstant></c:recordTime></c:timeRef>"
        '<c:snowProfileResultsOf><c:SnowProfileMeasurements dir="top down">'
        f"{''.join(profiles)}</c:SnowProfileMeasurements></c:snowProfileResultsOf></c:SnowProfile>"
    )


@pytest.fixture
def read(tmp_path):
    """Return a function that reads a text, or profiles, as one snow pit."""

    def read_pit(*texts, label="file", **options):
        path = tmp_path / "pit.caaml"
        text = texts[0] if texts and texts[0].startswith("<?xml") else write_text(*texts, **options)
        path.write_text(text, encoding="utf-8")
        return splits.read_caaml(path, label=label).dataset.squeeze(label, drop=label == "file")

    return read_pit


STRATA = write_profile(("stratProfile", "hardness"), STRATIGRAPHY)
LAYERS = write_profile(DENSITY, [(0, 20, 150), (20, 30, 300)])
AREAS = write_profile(AREA, [(0, 50, 25)])


# --- namespaces -----------------------------------------------------------------------------------


@pytest.mark.parametrize("schema", [SCHEMA, SCHEMA[:-1] + "6", SCHEMA.replace("http", "https")])
def test_prefixes_of_the_schema_do_not_matter(read, schema):
    text = write_text(STRATA, LAYERS, AREAS, schema=schema)
    expected = read(text)
    for other in (
        text.replace("<c:", "<").replace("</c:", "</").replace("xmlns:c=", "xmlns="),
        text.replace("c:", "caaml:").replace("xmlns:c", "xmlns:caaml"),
        text.replace("<c:", "<").replace("</c:", "</").replace(f'xmlns:c="{schema}"', ""),
        text.replace("c:timePosition", "gml:timePosition").replace("c:TimeInst", "gml:TimeInst"),
        text.replace(" uom=", " c:uom="),
        text.replace(" uom=", " UOM="),
    ):
        assert read(other).equals(expected)


def test_elements_of_other_programs_are_not_read(read):
    text = write_text(STRATA, LAYERS, AREAS)
    foreign = LAYERS.replace("c:", "snp:").replace(">150<", ">20<")
    assert read(text.replace(LAYERS, LAYERS + foreign)).equals(read(text))
    inside = LAYERS.replace("<c:density ", "<snp:density>heavy</snp:density><c:density ")
    assert read(text.replace(LAYERS, inside)).equals(read(text))


@pytest.mark.parametrize(
    "schema",
    ["http://caaml.org/Schemas/V5.0/Profiles/SnowProfileIACS",
     "http://caaml.org/Schemas/SnowProfileIACS/v7.0", "http://www.opengis.net/gml"],
)  # fmt: skip
def test_other_versions_are_refused(read, schema):
    with pytest.raises(
        InvalidValue, match=r"SnowProfile.*must be a SnowProfile of SnowProfileIACS"
    ):
        read(STRATA, LAYERS, schema=schema)


@pytest.mark.parametrize("encoding", ["x-unknown", "utf-7", "big5"])
def test_encodings_that_cannot_be_read_are_refused(read, encoding):
    text = write_text(STRATA, LAYERS).replace("UTF-8", encoding)
    with pytest.raises(InvalidValue, match=r"path = 'pit.caaml': must be an XML file of CAAML"):
        read(text)


# --- units ----------------------------------------------------------------------------------------

FACTORS = {
    "depthTop": {"cm": 1, "mm": 10, "m": 0.01, "in": 1 / 2.54, "ft": 1 / 30.48},
    "thickness": {"cm": 1, "mm": 10, "m": 0.01, "in": 1 / 2.54, "ft": 1 / 30.48},
    "density": {"kgm-3": 1, "Kg/m3": 1, "kg m⁻³": 1, "g cm-3": 1e-3, "g/cm³": 1e-3, "KG/M^3": 1},
    "specSurfArea": {"m2kg-1": 1, "m²/kg": 1, "m² kg⁻¹": 1, "cm2 g-1": 10},
    "lwc": {"% by Vol": 1, "%": 1, "1": 0.01, "m3/m3": 0.01, "Percent": 1},
}
ATTRIBUTES = {"depthTop": "uomDepthTop", "thickness": "uomThickness", "density": "uomDensity",
              "specSurfArea": "uomSpecSurfArea", "lwc": "uomLwc"}  # fmt: skip
PIT = {DENSITY: [(0, 20, 150), (20, 30, 300)], AREA: [(0, 6, 40), (6, 44, 25)],
       WATER: [(0, 50, 2)]}  # fmt: skip


@pytest.mark.parametrize("place", ["value", "row", "profile", "all"])
def test_units_are_obeyed_wherever_they_are_stated(read, place):
    """Numbers in any unit, stated with them or around them, are those of the schema's units."""
    expected = read(STRATA, *(write_profile(kind, rows) for kind, rows in PIT.items()))
    random = np.random.default_rng(58)
    for _ in range(6):
        profiles = []
        for kind, rows in PIT.items():
            tags = ("depthTop", "thickness", kind[1])
            units = {tag: str(random.choice(list(FACTORS[tag]))) for tag in tags}
            scaled = [
                tuple(n * FACTORS[tag][units[tag]] for n, tag in zip(row, tags, strict=True))
                for row in rows
            ]
            text = " ".join(f"{ATTRIBUTES[tag]}={unit!r}" for tag, unit in units.items())
            wrong = "uomDepthTop='m' uomThickness='ft' uomDensity='g/cm3' uomLwc='1'"
            options = {
                "value": {"units": units},
                "row": {"units": {}, "row_attributes": text},
                "profile": {"units": dict.fromkeys(tags, " "), "attributes": text},
                "all": {"units": units, "row_attributes": wrong, "attributes": wrong},
            }[place]
            profiles.append(write_profile(kind, scaled, **options))
        found = read(STRATA, *profiles)
        xr.testing.assert_allclose(found, expected, rtol=1e-12)


def test_empty_units_are_those_of_the_schema(read):
    expected = read(STRATA, LAYERS, AREAS)
    for unit in ("", " "):
        units = dict.fromkeys(UNITS, unit)
        strata = write_profile(("stratProfile", "hardness"), STRATIGRAPHY, units=units)
        assert read(strata, LAYERS, AREAS).equals(expected)
        layers = write_profile(DENSITY, PIT[DENSITY], units=units)
        assert read(STRATA, layers, AREAS).equals(expected)


def test_units_of_points_are_those_of_their_components(read):
    expected = read(STRATA, LAYERS, write_points("5,40 15,30 45,10"))
    for text, components in (
        ("50,40 150,30 450,10", "uomDepth='mm' uomSpecSurfArea='m2kg-1'"),
        ("0.05,400 0.15,300 0.45,100", "uomDepth='m' uomSpecSurfArea='cm2 g-1'"),
        ("5,40 15,30 45,10", "uomDepth='' uomSpecSurfArea=''"),
    ):
        found = read(STRATA, LAYERS, write_points(text, components))
        np.testing.assert_allclose(
            found.specific_surface_area_m2_kg, expected.specific_surface_area_m2_kg, rtol=1e-12
        )


def test_one_unit_may_state_all_depths_of_a_profile(read):
    expected = read(STRATA, LAYERS, AREAS)
    rows = [(10 * top, 10 * thickness, value) for top, thickness, value in PIT[DENSITY]]
    layers = write_profile(DENSITY, rows, "uomDepth='mm'", units={})
    np.testing.assert_allclose(read(STRATA, layers, AREAS).density_kg_m3, expected.density_kg_m3)


def test_temperatures_have_the_units_of_their_profile(read):
    def write_temperatures(attributes, *pairs):
        points = "".join(
            f"<c:Obs><c:depth>{depth}</c:depth><c:snowTemp>{value}</c:snowTemp></c:Obs>"
            for depth, value in pairs
        )
        return f"<c:tempProfile {attributes}>{points}</c:tempProfile>"

    expected = read(STRATA, LAYERS, AREAS, write_temperatures("", (0, -10), (50, -5)))
    np.testing.assert_allclose(expected.temperature_c, [-9.5, -7.0])
    for attributes, pairs in (
        ("uomDepth='m' uomTemp='K'", ((0, 263.15), (0.5, 268.15))),
        ("uomDepth='mm' uomSnowTemp='degC'", ((0, -10), (500, -5))),
    ):
        found = read(STRATA, LAYERS, AREAS, write_temperatures(attributes, *pairs))
        np.testing.assert_allclose(found.temperature_c, expected.temperature_c)


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        (LAYERS.replace("<c:densityProfile ", "<c:densityProfile uom='g/cm3' "),
         "densityProfile.uom = 'g/cm3': must be left out"),
        (LAYERS.replace("<c:Layer ", "<c:Layer uom='mm' "), "Layer.uom = 'mm': must be left out"),
        (write_points("5,40", "uom='mm'"), "MeasurementComponents.uom = 'mm': must be left out"),
        (write_points("5,40", "uomDepth='Mm'"), "depth.units = 'Mm': must be one of m"),
        (write_profile(DENSITY, PIT[DENSITY], "uomDensity='kPa'", units={}),
         "density.units = 'kPa': must be one of kg m-3"),
        (write_profile(WATER, PIT[WATER], units={**UNITS, "lwc": "% by Mass"}),
         "lwc.units = '% by Mass': must be one of"),
    ],
)  # fmt: skip
def test_units_that_say_nothing_are_refused(read, profile, message):
    with pytest.raises(InvalidValue, match=message) as error:
        read(STRATA, profile)
    assert "\n" not in str(error.value)


# --- times ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [(TIME, "2016-02-10T08:30"), ("2016-02-10T09:30:00", "2016-02-10T09:30"),
     ("\n 2016-02-10T09:30Z\n", "2016-02-10T09:30"), ("2016-02-10", "2016-02-10"),
     ("2016-02-10 23:30:15.5-0700", "2016-02-11T06:30:15.5")],
)  # fmt: skip
def test_times_are_dates_of_iso_8601(read, text, expected):
    time = f"<c:timePosition>{text}</c:timePosition>"
    found = read(STRATA, LAYERS, AREAS, time=time, label="time").time
    assert found.values == np.datetime64(expected)


@pytest.mark.parametrize(
    "text",
    ["now", "today", "10:00", "09:30:00Z", "10.02.2016", "02/10/2016", "Feb 10 2016", "1455096600",
     "2016-02-30", "2016-13-01", "2016-02-10T25:00", "2016", "2016-02", "NaT", "unknown", "",
     "20160210 or later", "2016-02-10T09:30:00+99:00"],
)  # fmt: skip
def test_other_times_are_refused_where_a_time_is_needed(read, text):
    time = f"<c:timePosition>{text}</c:timePosition>"
    with pytest.raises(InvalidValue, match=r"pit.caaml: timePosition = .*label='file' needs no t"):
        read(STRATA, LAYERS, AREAS, time=time, label="time")
    assert read(STRATA, LAYERS, AREAS, time=time).equals(read(STRATA, LAYERS, AREAS))


def test_limits_of_a_time_are_no_time(read):
    time = f"<c:timePosition indeterminatePosition='before'>{TIME}</c:timePosition>"
    with pytest.raises(InvalidValue, match="timePosition = 'before 2016-02-10T"):
        read(STRATA, LAYERS, AREAS, time=time, label="time")


def test_pits_without_time_may_be_labelled_by_file(tmp_path, read):
    text = write_text(STRATA, LAYERS, AREAS)
    start, end = text.index("<c:timeRef>"), text.index("<c:snowProfileResultsOf>")
    for name in ("a.xml", "b.xml"):
        (tmp_path / name).write_text(text[:start] + text[end:], encoding="utf-8")
    packs = splits.read_caaml([tmp_path / "a.xml", tmp_path / "b.xml"], label="file")
    assert packs.dataset.file.values.tolist() == ["a.xml", "b.xml"]
    assert packs.dataset.isel(file=0, drop=True).equals(read(text))
    with pytest.raises(InvalidValue, match=r"a.xml: timePosition = ''"):
        splits.read_caaml(tmp_path / "a.xml")


# --- numbers and gaps -----------------------------------------------------------------------------


@pytest.mark.parametrize("number", ["-5", "inf", "-inf", "1e999", "Infinity", "1_0", "2,5", "٣"])
@pytest.mark.parametrize("tag", ["depthTop", "thickness", "density"])
def test_numbers_that_the_schema_excludes_are_refused(read, tag, number):
    position = ("depthTop", "thickness", "density").index(tag)
    row = [20, 10, 300]
    row[position] = number
    with pytest.raises(InvalidValue, match=f"pit.caaml: {tag} = '{number}': must be a"):
        read(STRATA, write_profile(DENSITY, [(0, 20, 150), row]), AREAS)
    if tag != "density":
        strata = write_profile(("stratProfile", "hardness"), [(0, 20, None), (*row[:2], None)])
        with pytest.raises(InvalidValue, match=f"{tag} = '{number}': must be a"):
            read(strata, LAYERS, AREAS)


@pytest.mark.parametrize("point", ["-5,40", "5,-40", "5,inf", "5;40", "5,40,1", "5", "5,4 0,"])
def test_points_that_are_no_pairs_are_refused(read, point):
    with pytest.raises(InvalidValue, match=r"pit.caaml: (tupleList|depth|specSurfArea) = "):
        read(STRATA, LAYERS, write_points(f"{point} 15,30 45,10"))


@pytest.mark.parametrize(
    "word", ["missing", "Unknown", "withheld", "template", "inapplicable", "other:wet", "NaN", " "]
)
def test_words_for_gaps_are_gaps_everywhere(read, word):
    without = read(STRATA, write_profile(DENSITY, [(0, 20, 150)]), AREAS)
    found = read(STRATA, write_profile(DENSITY, [(0, 20, 150), (20, 30, word)]), AREAS)
    assert found.equals(without)
    points = read(STRATA, LAYERS, write_points("5,40 45,10"))
    if word.strip():
        assert read(STRATA, LAYERS, write_points(f"5,40 15,{word} 45,10")).equals(points)
        assert read(STRATA, LAYERS, write_points(f"5,40 {word},12 45,10")).equals(points)


# --- points ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "attributes", "order"),
    [
        ("\n5, 40\n15, 30\n25, 20\n45, 10\n", "", None),
        ("5 ,40\t15,30\r\n25,20   45,10", "", None),
        ("5,40;15,30;25,20;45,10;", "ts=';'", None),
        ("5|40 15|30 25|20 45|10", "cs='|'", None),
        ("5 40;15 30;25 20; 45 10", "cs=' ' ts=';'", None),
        ("5,0;40 15,0;30 25,0;20 45,0;10", "cs=';' decimal=','", None),
        ("40,5 30,15 20,25 10,45", "", ("specSurfArea", "depth")),
        ("5,1,40 15,2,30 25,1,20 45,3,10", "", ("depth", "quality", "specSurfArea")),
    ],
)
def test_lists_of_points_follow_their_own_separators(read, text, attributes, order):
    expected = read(STRATA, LAYERS, write_points("5,40 15,30 25,20 45,10"))
    np.testing.assert_allclose(expected.specific_surface_area_m2_kg, [40.0, 20.0])
    options = {} if order is None else {"order": order}
    assert read(STRATA, LAYERS, write_points(text, attributes=attributes, **options)).equals(
        expected
    )


def test_all_lists_of_points_are_read(read):
    one = write_points("5,40 15,30 25,20 45,10")
    two = one.replace("15,30 25,20", "15,30</c:tupleList><c:tupleList>25,20")
    assert two != one
    assert read(STRATA, LAYERS, two).equals(read(STRATA, LAYERS, one))


def test_an_interval_does_not_hide_the_points_of_another_profile(read):
    cubes = write_profile(AREA, [(0, 6, 40), (6, 6, 38)])
    points = write_points("15,20 20,18 25,16 30,15 35,14 40,13 45,12")
    area = read(STRATA, LAYERS, cubes, points).specific_surface_area_m2_kg.values
    # The interval covers 2 cm of 40 cm; the points have a mean of 108/7.
    np.testing.assert_allclose(area, [39.2, (2 * 38 + 38 * 108 / 7) / 40])
    for profiles in itertools.permutations([cubes, points, LAYERS]):
        assert (read(STRATA, *profiles).specific_surface_area_m2_kg.values == area).all()


# --- soil -----------------------------------------------------------------------------------------


def write_model_output(n_soil):
    """Return a pit of the model SNOWPACK: four layers of snow above layers of soil."""
    snow = [(0, 5, 120, 60), (5, 10, 200, 35), (15, 15, 280, 20), (30, 20, 350, 12)]
    soil = [(50 + 10 * i, 10, 1811.5, "inf") for i in range(n_soil)]
    strata = "".join(
        "<c:Layer><c:metaData><c:customData>"
        f"<snp:phiSoil>{0.6 if density > 1000 else 0:.4f}</snp:phiSoil>"
        "</c:customData></c:metaData>"
        f"<c:depthTop uom='cm'>{top:.4f}</c:depthTop><c:thickness uom='cm'>{thickness:.4f}"
        "</c:thickness></c:Layer>"
        for top, thickness, density, _ in snow + soil
    )
    temperatures = "".join(
        f"<c:Obs><c:depth uom='cm'>{depth:.4f}</c:depth>"
        f"<c:snowTemp uom='degC'>{min(-8 + 0.2 * depth, 6):.3f}</c:snowTemp></c:Obs>"
        for depth in range(0, 51 + 10 * n_soil, 5)
    )
    return (
        f"<c:stratProfile>{strata}</c:stratProfile><c:tempProfile>{temperatures}</c:tempProfile>",
        write_profile(DENSITY, [(top, thick, rho) for top, thick, rho, _ in snow + soil]),
        write_profile(
            WATER, [(top, thick, 30 * (rho > 1000)) for top, thick, rho, _ in snow + soil]
        ),
        write_profile(AREA, [(top, thick, area) for top, thick, _, area in snow + soil]),
    )


def test_layers_of_soil_end_the_snow(read):
    snow, bare = read(*write_model_output(3)), read(*write_model_output(0))
    assert snow.equals(bare)
    assert snow.quality_flag == 0
    np.testing.assert_allclose(snow.thickness_m, [0.05, 0.1, 0.15, 0.2])
    np.testing.assert_allclose(snow.specific_surface_area_m2_kg, [60, 35, 20, 12])
    np.testing.assert_allclose(snow.temperature_c, [-7.5, -6.0, -3.5, 0.0], atol=1e-9)
    without_snow = write_model_output(3)[0].replace("0.0000</snp", "0.6000</snp")
    assert read(without_snow).quality_flag == 1


TOP, THICKNESS = np.array([0.0, 0.2, 0.4, 0.8]), np.array([0.2, 0.2, 0.4, 0.2])


def profile(*rows):
    return DepthProfile(*np.array(rows, dtype=float).T)


@pytest.mark.parametrize("extend", [True, False])
def test_the_mean_over_layers_conserves_the_total_of_a_complete_profile(extend):
    measured = profile((0.0, 0.1, 5.0), (0.1, 0.3, 2.0), (0.4, 0.35, 7.0), (0.75, 0.25, 1.0))
    mean = average_over_layers(measured, TOP, THICKNESS, extend=extend)
    assert mean @ THICKNESS == pytest.approx(measured.values @ measured.thickness_m)
    np.testing.assert_allclose(mean[:2], [3.5, 2.0])


def test_gaps_are_dropped_and_the_order_does_not_matter():
    rows = [(0.4, 0.2, 3.0), (0.0, 0.2, 1.0), (0.2, 0.2, np.nan), (np.nan, 0.1, 9.0)]
    mean = average_over_layers(profile(*rows), TOP, THICKNESS, extend=True)
    np.testing.assert_allclose(mean, [1.0, 2.0, 3.0, 3.0])
    assert np.isnan(average_over_layers(profile(rows[2]), TOP, THICKNESS, extend=True)).all()


def test_a_contact_by_rounding_is_no_overlap():
    measured = profile((0.0, 0.2 + 1e-15, 1.0), (0.3, 0.1, 5.0))
    assert average_over_layers(measured, TOP, THICKNESS, extend=True)[1] == pytest.approx(5.0)


def test_points_are_interpolated_to_the_middle_of_layers():
    measured = profile((0.0, 0.0, -10.0), (0.6, 0.0, -4.0))
    for extend, last in ((True, -4.0), (False, np.nan)):
        values = interpolate_to_layers(measured, TOP, THICKNESS, extend=extend)
        np.testing.assert_allclose(values, [-9.0, -7.0, -4.0, last])


def average_all_pairs(measured, top, thickness):
    """Return means over layers from the overlaps of all layers with all intervals or points."""
    bottom = (top + thickness)[:, None]
    if (measured.thickness_m == 0.0).all():
        weights = 1.0 * ((measured.top_m >= top[:, None]) & (measured.top_m < bottom))
    else:
        lowest = np.minimum(bottom, measured.top_m + measured.thickness_m)
        weights = lowest - np.maximum(top[:, None], measured.top_m)
        weights = np.where(weights > 1e-6, weights, 0.0)
    total = weights.sum(axis=1)
    between = interpolate_to_layers(measured, top, thickness, extend=True)
    return np.where(total > 0, weights @ measured.values / np.where(total > 0, total, 1), between)


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("points", [True, False])
def test_intervals_alone_and_points_alone_have_the_means_of_all_pairs(points, seed):
    """Intervals may overlap each other, lie in each other, and have any order."""
    random = np.random.default_rng(seed)
    n, thickness = random.integers(1, 40), random.uniform(0.001, 0.3, random.integers(1, 20))
    top = np.cumsum(thickness) - thickness
    lengths = np.zeros(n) if points else random.choice([0.01, 0.05, 0.3, 2.0], n)
    tops = np.round(random.uniform(0.0, top[-1] + 0.2, n), random.choice([2, 8]))
    measured = DepthProfile(tops, lengths, random.uniform(50, 900, n))
    found = average_over_layers(measured, top, thickness, extend=True)
    np.testing.assert_allclose(found, average_all_pairs(measured, top, thickness), rtol=1e-13)


@pytest.mark.parametrize("seed", range(10))
def test_points_share_the_part_of_a_layer_without_intervals(seed):
    """The mean is that of a fine grid, whose free cells have the mean of the free points."""
    random = np.random.default_rng(seed)
    cells = np.arange(1000)
    tops = np.sort(random.choice(cells[::10], 12, replace=False))
    lengths = np.minimum(random.integers(1, 60, 12), np.diff(tops, append=1000))
    depths = random.choice(cells[5::10], 60)
    values = random.uniform(5.0, 60.0, 72)
    grid = np.full(1000, np.nan)
    for top, length, value in zip(tops, lengths, values, strict=False):
        grid[top : top + length] = value
    measured = DepthProfile(
        np.concatenate([tops, depths]) / 1e3, np.append(lengths, np.zeros(60)) / 1e3, values
    )
    shuffled = random.permutation(72)
    measured = DepthProfile(*(column[shuffled] for column in measured))
    edges = np.arange(0, 1001, 100)
    found = average_over_layers(measured, edges[:-1] / 1e3, np.full(10, 0.1), extend=True)
    for i, (first, last) in enumerate(itertools.pairwise(edges)):
        layer = grid[first:last].copy()
        free = [v for d, v in zip(depths, values[12:], strict=True)
                if first <= d < last and np.isnan(grid[d])]  # fmt: skip
        if free:
            layer[np.isnan(layer)] = np.mean(free)
        assert found[i] == pytest.approx(np.nanmean(layer), rel=1e-9)


def test_points_change_nothing_where_intervals_cover_the_layer():
    intervals = [(0.0, 0.2, 5.0), (0.2, 0.2, 2.0), (0.2, 0.2, 4.0), (0.4, 0.4, 7.0), (0.8, 0.2, 1)]
    alone = average_over_layers(profile(*intervals), TOP, THICKNESS, extend=True)
    points = [(depth, 0.0, 100.0) for depth in (0.0, 0.1, 0.2, 0.39, 0.4, 0.8, 0.95)]
    both = average_over_layers(profile(*points, *intervals), TOP, THICKNESS, extend=True)
    np.testing.assert_allclose(both, alone, rtol=1e-12)
    np.testing.assert_allclose(alone, [5.0, 3.0, 7.0, 1.0])


def test_two_intervals_at_one_depth_do_not_outweigh_the_points():
    measured = [(0.0, 0.05, 5.0), (0.0, 0.05, 7.0), (0.1, 0.0, 2.0), (0.15, 0.0, 4.0)]
    mean = average_over_layers(profile(*measured), TOP[:1], THICKNESS[:1], extend=True)
    np.testing.assert_allclose(mean, [(0.05 * 6.0 + 0.15 * 3.0) / 0.2])


@pytest.mark.parametrize("thickness", [0.0, 2.5e-4, 5.0])
def test_memory_grows_with_the_number_of_intervals_only(thickness):
    """One array over all layers and intervals would take 32 MB."""
    n, step = 2000, 2.5e-4
    top = np.arange(n) * step
    measured = DepthProfile(top + 1e-5, np.full(n, thickness), 300.0 + np.arange(n) % 7)
    tracemalloc.start()
    average_over_layers(measured, top, np.full(n, step), extend=True)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e6
