"""Hints in messages about inputs of frequent kinds of mistakes, in all public functions."""

import inspect
import math

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import splits
from splits.core.keywords import RECOGNIZED_ARGUMENTS
from splits.core.validation import check_range
from splits.experiments.config.load import load_experiment

SNOW = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1)
SKY, WAVELENGTHS, DEPTHS = "midlatitude_winter", [500, 600], [0.02]
COLUMNS = {"thickness_m": 0.1, "density_kg_m3": 300.0, "specific_surface_area_m2_kg": 20.0}
PACKS = splits.SnowPacks(
    xr.Dataset({k: (("time", "layer"), [[v]]) for k, v in COLUMNS.items()}, {"time": ["pit"]})
)
OWN_SKY = splits.Sky("own", "test", 50.0, [300.0, 900.0], [1.0, 1.0], [1.0, 1.0])
INSTRUMENTS = [
    getattr(splits, name)
    for name in splits.__all__
    if inspect.isfunction(getattr(splits, name))
    and next(iter(inspect.signature(getattr(splits, name)).parameters), "") == "medium"
]
"""All functions of one medium."""
every_instrument = pytest.mark.parametrize("instrument", INSTRUMENTS, ids=lambda one: one.__name__)


def make_arguments(function):
    """Return valid values of the arguments that a function requires, by name."""
    known = {
        "medium": SNOW, "sky": OWN_SKY, "wavelength_nm": WAVELENGTHS, "depth_m": DEPTHS,
        "incidence_deg": 30.0, "make": splits.Snow.natural, "grid": {"optical_radius_um": [100]},
        "screen_depth_m": [1.0], "radius_m": 0.1, "half_width_m": 0.1, "model": SNOW,
        "measured": (WAVELENGTHS, [0.9, 0.8]),
        "free": ["optical_radius_um"], "dataset": xr.Dataset(), "path": "any.nc",
    }  # fmt: skip
    parameters = inspect.signature(function).parameters.values()
    return {
        one.name: known[one.name]
        for one in parameters
        if one.name in known and (one.kind != one.KEYWORD_ONLY or one.default is one.empty)
    }


def read_message(function, *values, **keywords):
    with pytest.raises((ValueError, TypeError)) as caught:
        function(*values, **keywords)
    message = str(caught.value)
    assert "\n" not in message
    return message


def list_positional(function):
    """Return the names of the arguments that may be given without a keyword."""
    parameters = inspect.signature(function).parameters
    keyword_only = inspect.Parameter.KEYWORD_ONLY
    return [name for name in make_arguments(function) if parameters[name].kind != keyword_only]


def list_swaps():
    functions = [*INSTRUMENTS, splits.build_table, splits.retrieve, splits.save]
    for function in functions:
        names = list_positional(function)
        for one in range(len(names)):
            for other in range(one + 1, len(names)):
                if {names[one], names[other]} & RECOGNIZED_ARGUMENTS.keys():
                    yield function, one, other


@pytest.mark.parametrize(
    ("function", "one", "other"), [*list_swaps()], ids=lambda x: getattr(x, "__name__", None)
)
def test_exchanged_arguments_show_the_order(function, one, other):
    arguments, names = make_arguments(function), list_positional(function)
    values = [arguments.pop(name) for name in names]
    values[one], values[other] = values[other], values[one]
    message = read_message(function, *values, **arguments)
    assert f"(the order is {function.__name__}({', '.join(names)}" in message
    assert "micrometres" not in message


@every_instrument
@pytest.mark.parametrize(
    ("medium", "shown", "hint"),
    [
        ("red_dune", "'red_dune'", "did you mean splits.load_medium('red_dune')?"),
        ("wet_beech", "'wet_beech'", "did you mean splits.load_medium('wet_beach')?"),
        (splits.Snow.natural, "Snow.natural", "call it: Snow.natural(…)"),
        (splits.load_medium, "load_medium", "call it: load_medium(…)"),
        ([SNOW, SNOW], "[", "splits.Stack(layers)"),
        ((SNOW, SNOW), "(", "splits.Stack(layers)"),
        (PACKS, "SnowPacks(", "packs.make_stack(label) returns one of the snowpacks"),
    ],
    ids=["named", "misspelt", "uncalled method", "uncalled function", "list", "tuple", "packs"],
)
def test_values_in_place_of_a_medium(instrument, medium, shown, hint):
    if medium is PACKS and "SnowPacks" in str(inspect.signature(instrument)):
        pytest.skip("takes the snowpacks of a season")
    arguments = {**make_arguments(instrument), "medium": medium}
    if "sky" in arguments:
        # The medium is wrong, whatever else is missing.
        arguments["sky"] = "clear" if medium is PACKS else SKY
    message = read_message(instrument, **arguments)
    assert message.startswith(f"medium = {shown}") and hint in message


@pytest.mark.parametrize(
    ("layer", "hint"),
    [
        ("red_dune", "did you mean splits.load_medium('red_dune')?"),
        (splits.Snow.natural, "call it: Snow.natural(…)"),
        (splits.Snow, "did you mean splits.Snow()?"),
    ],
)
def test_values_in_place_of_a_layer_or_model(layer, hint):
    assert hint in read_message(splits.Stack, [SNOW, layer])
    if layer is not splits.Snow:
        free = ["optical_radius_um"]
        measured = WAVELENGTHS, [0.9, 0.8]
        assert hint in read_message(splits.retrieve, measured, layer, free, 0.01)


@pytest.mark.parametrize(
    ("keywords", "hint"),
    [
        ({"temperature_c": 268.15}, "in kelvin? write -5"),
        ({"liquid_water_content": 5}, "in per cent? write 0.05"),
        ({"saturation": 20}, "in per cent? write 0.2"),
        ({"depth_m": 1.0, "ground": 80}, "in per cent? write 0.8"),
        ({"density_kg_m3": 0.25}, "in g/cm3? write 250"),
        ({"depth_m": 15_000}, "in centimetres? write 150"),
        ({"optical_radius_um": 0.1}, "in millimetres? write 100"),
        ({"optical_radius_um": 2e-4}, "in metres? write 200"),
        ({"optical_radius_um": "0,2"}, "write 0.2, with a decimal point"),
        ({"optical_radius_um": "200"}, "write 200, without quotes"),
        ({"impurities_ng_g": 100}, "such as {'black_carbon': 100}"),
    ],
)
def test_other_units_have_a_hint(keywords, hint):
    size = {} if "optical_radius_um" in keywords else {"optical_radius_um": 100}
    assert hint in read_message(splits.Snow.natural, **size, **keywords)


@pytest.mark.parametrize(
    ("value", "low", "high", "unit"),
    [(1.05, 0.0, 1.0, ""), (-3.0, 0.0, 1.0, ""), (300.0, 0.0, 1.0, ""), (50.0, -1.0, 1.0, ""),
     (2e5, 200.0, 1e5, "nm"), (1.0, -40.0, 0.0, "°C"),
     (0.2, 0.0, 0.1, "m"), (30.0, 0.0, 10.0, "s")],
)  # fmt: skip
def test_numbers_that_no_unit_explains_have_no_hint(value, low, high, unit):
    assert "?" not in read_message(check_range, "x", value, low, high, unit)


@pytest.mark.parametrize(
    ("function", "arguments", "numbers"),
    [
        (splits.spectrophotometer, {"wavelength_nm": (400, 700, 10)}, "400, 705, 10"),
        (splits.spectrophotometer, {"wavelength_nm": [400.0, 500.0, 0.5]}, "400, 500.25, 0.5"),
        (splits.albedo, {"wavelength_nm": (400, 700, 50), "sky": SKY}, "400, 725, 50"),
        (splits.goniophotometer, {"polar_deg": (0, 90, 5)}, "0, 92.5, 5"),
        (splits.goniophotometer, {"azimuth_deg": (0, 360, 30)}, "0, 375, 30"),
        (splits.irradiance_profile, {"depth_m": [0.01, 0.09, 0.01]}, "0.01, 0.095, 0.01"),
    ],
)
def test_a_start_a_stop_and_a_step_have_a_hint(function, arguments, numbers):
    message = read_message(function, **{**make_arguments(function), **arguments})
    assert f"start, stop and step? write all numbers, numpy.arange({numbers})" in message


def test_wavelengths_in_micrometres_have_a_hint():
    message = read_message(splits.spectrophotometer, SNOW, [0.4, 0.7])
    assert message.endswith("(in micrometres? write 400)")


@pytest.mark.parametrize(
    ("function", "values", "hint"),
    [
        (splits.Snow.natural, (20,), "20: must have a keyword, such as specific_surface_area"),
        (splits.sky, ("clear", 40, 1e5), "100000.0: must have a keyword, such as pressure_pa"),
        (splits.spectrophotometer, (SNOW, [500], 0, 0.01, 1, "auto"), "such as max_stderr=0.01"),
    ],
)
def test_surplus_values_need_a_keyword(function, values, hint):
    message = read_message(function, *values)
    assert hint in message and "make_" not in message


@pytest.mark.parametrize("keyword", ["sza", "solar_zenith", "zenith", "incidence_deg"])
def test_the_sun_of_a_sky_has_a_hint(keyword):
    assert "(did you mean zenith_deg?)" in read_message(splits.sky, "clear", **{keyword: 40})


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("cloudy", "subarctic_summer_cloudy or midlatitude_winter_cloudy"),
        ("winter", "midlatitude_winter or midlatitude_winter_cloudy"),
        ("overcast", "midlatitude_winter_cloudy"),
        ("Clear", "clear"),
        ("AM1.5", "astm_g173"),
    ],
)
@pytest.mark.parametrize("function", [splits.sky, splits.albedo, splits.hdrf])
def test_names_of_skies_have_a_hint(function, name, hint):
    values = (name,) if function is splits.sky else (SNOW, name, WAVELENGTHS)
    assert f"(did you mean {hint}?)" in read_message(function, *values)


@pytest.mark.parametrize("depth_m", [1.5588457268119895, 0.1, 1 / 3, 2e-7 / 3])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_limit_shows_on_which_side_of_it_a_value_is(depth_m, side):
    for relative in (1e-3, 1e-6, 2e-9):
        value = depth_m * (1.0 + side * relative)
        low, high = (0.0, depth_m) if side > 0 else (depth_m, 10.0)
        message = read_message(check_range, "x", value, low, high)
        left, right = map(float, message.partition("must be in [")[2][:-1].split(", "))
        assert not left <= value <= right
    # An open limit is the value itself.
    message = read_message(check_range, "x", depth_m, 0.0, depth_m, open_high=True)
    assert message == f"x = {depth_m!r}: must be in (0, {depth_m!r})".replace("(0", "[0")


AZIMUTH_CALLS = {
    "goniophotometer": lambda x: splits.goniophotometer(SNOW, [500], 60, azimuth_deg=x),
    "hdrf": lambda x: splits.hdrf(SNOW, SKY, [500], azimuth_deg=x),
    "at_view": lambda x: make_directional_table().at_view(30, x[-1] if x[0] >= 0 else x[0]),
    "interp": lambda x: make_directional_table().interp(
        polar_deg=30, azimuth_deg=x[-1] if x[0] >= 0 else x[0], optical_radius_um=100
    ),
}


def make_directional_table():
    grid = {"optical_radius_um": [100, 200], "polar_deg": [0, 60], "azimuth_deg": [0, 90, 180]}
    table = splits.build_table(
        splits.Snow.natural, grid, [500], 60, max_stderr=0.1, solver="discrete_ordinates"
    ).dataset
    return splits.Table(table)


@pytest.mark.parametrize("name", AZIMUTH_CALLS)
@pytest.mark.parametrize(("azimuth", "right"), [(-90, 270), (360, 0), (-180.5, 179.5), (450, 90)])
def test_azimuths_are_from_0_to_360_everywhere(name, azimuth, right):
    message = read_message(AZIMUTH_CALLS[name], [azimuth, 10] if azimuth < 0 else [10, azimuth])
    assert f"must be in [0, 360) degrees (write {right:g})" in message


@pytest.mark.parametrize(
    ("name", "hint"),
    [("snow", "Snow"), ("sand", "Sand"), ("spectrofotometer", "spectrophotometer"),
     ("BRDF", "goniophotometer"), ("retreive", "retrieve"), ("snowpacks", "SnowPacks")],
)  # fmt: skip
def test_public_names_have_a_hint(name, hint):
    with pytest.raises(AttributeError, match=rf"'{name}' \(did you mean {hint}\?\)$"):
        getattr(splits, name)


def test_unknown_public_names_without_a_near_one():
    with pytest.raises(AttributeError, match=r"module .splits. has no attribute .xyzzy.$"):
        splits.xyzzy  # noqa: B018
    assert not hasattr(splits, "__wrapped__")


MEDIUM = "medium: {kind: natural_snow, optical_radius_um: 100, depth_m: 0.1}\n"
INSTRUMENT = "instrument: {wavelength_nm: [500, 600]}\n"


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        (MEDIUM.replace("0.1", "0,1") + INSTRUMENT, "line 1: not YAML (a decimal comma? write 0.1"),
        (MEDIUM + "instrument: {wavelength_nm: [500], stderr_scale: 0,3}\n", "write 0.3"),
        ("medium:\n  optical_radius_um: 100\n  depth_m: 0,25\n" + INSTRUMENT,
         "medium.depth_m = '0,25': must be in (0, 10000] m (write 0.25, with a decimal point)"),
        (MEDIUM + "instrument:\n  wavelength_nm: [500]\n  stderr_scale: 0,5\n", "write 0.5, with"),
        (MEDIUM + "instrument:\n  wavelength_nm: 500,600\n", "(write [500,600])"),
        (MEDIUM + "instrument: {wavelength_nm: {start: 400, end: 700, step: 10}}\n",
         "wavelength_nm.end: unknown key, must be one of start, stop, step, also "
         "(did you mean stop?)"),
        (MEDIUM + "instrument: {wavelength_nm: {from: 400, to: 700, by: 10}}\n", "mean start?"),
        (MEDIUM + "instrument: spectrophotometer\n",
         "(write instrument: {kind: spectrophotometer, …})"),
        (MEDIUM + INSTRUMENT + "figure: spectra\n", "(write figure: {kind: spectra, …})"),
        ("medium: sand\n" + INSTRUMENT, "(write medium: {kind: sand, …})"),
        ("medium: red_dune\n" + INSTRUMENT, "(write medium: {base: red_dune})"),
        ("medium:\n\toptical_radius_um: 100\n" + INSTRUMENT, "line 2: not YAML (a tab: indent"),
        ("medium:\n  kind:\tsnow\n\tdepth_m: 1\n" + INSTRUMENT, "not YAML (a tab: indent with"),
    ],
)  # fmt: skip
def test_mistakes_in_files_have_a_hint(tmp_path, text, hint):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    message = read_message(load_experiment, path, tmp_path)
    assert message.startswith(str(path)) and hint in message


def test_a_key_that_is_a_number_is_no_decimal_comma(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("medium: {depth_m: 1, 5: 2}\n" + INSTRUMENT, encoding="utf-8")
    assert "decimal" not in read_message(load_experiment, path, tmp_path)


def test_infinite_limits_and_numbers_are_unchanged():
    assert read_message(check_range, "x", -1, 0.0, math.inf, "m") == "x = -1: must be at least 0 m"
    assert np.isclose(check_range("x", 0.5, 0.0, 1.0), 0.5)


@pytest.mark.parametrize("name", ["Sentinel-2A", "sentinel 2a", "SENTINEL_2A"])
def test_other_spellings_of_a_sensor_suggest_that_sensor(name):
    with pytest.raises(ValueError, match="did you mean sentinel_2a"):
        splits.albedo(SNOW, splits.sky("astm_g173"), bands=name)


def test_the_text_that_is_no_number_is_named():
    column = pd.Series(["110", "x", "120"])
    with pytest.raises(ValueError, match=r"density_kg_m3.* = 'x'"):
        splits.SnowPacks(pd.DataFrame({
            "time": pd.date_range("2024-01-01", periods=3), "layer": [0, 0, 0],
            "thickness_m": [0.1] * 3, "density_kg_m3": column,
            "specific_surface_area_m2_kg": [20.0] * 3,
        }))  # fmt: skip
