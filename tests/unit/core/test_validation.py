"""Validation: messages, values at the ends of ranges, units, and equality of inputs by value."""

import copy
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from array_inputs import FIXED, SIZE, SOOT, TABLE, user_index
from chi2 import NEEDS_JIT
from formula_tables import W, evaluate_spectrum, make_table

import splits
from splits.analysis.colour import covers_visible
from splits.core.arrays import check_named_numbers
from splits.core.inputs import check_polar_angles, check_wavelengths
from splits.core.labels import CONVERSIONS, convert_units, is_unit
from splits.core.validation import (
    InvalidValue,
    check_choice,
    check_number,
    check_range,
    invalid,
    snap_to_limits,
    suggest_name,
    unknown_key,
)
from splits.illumination.bands import SpectralBand
from splits.materials import make_refractive_index
from splits.media.ground import Ground


def test_errors_name_key_value_range_and_hint():
    error = invalid("depth_m", -1, "above 0", "think positive")
    assert str(error) == "depth_m = -1: must be above 0 (think positive)"
    assert str(invalid("depth_m", "x", "above 0")) == "depth_m = 'x': must be above 0"
    assert isinstance(error, ValueError)


@pytest.mark.parametrize("value", [1, 1.5, np.float32(0.5), np.int64(3), -0.0])
def test_real_numbers_are_converted_to_float(value):
    result = check_number("x", value)
    assert type(result) is float
    assert result == float(value)


@pytest.mark.parametrize("value", [True, None, "1", 1j, [1], math.nan, math.inf, np.bool_(True)])
def test_other_values_are_rejected_as_numbers(value):
    with pytest.raises(ValueError, match=r"^x = .*: must be a finite number"):
        check_number("x", value)


@pytest.mark.parametrize(
    ("limits", "inside", "outside", "allowed"),
    [
        ({}, (0.0, 0.5, 1.0), (-1e-9, 1.1), r"in \[0, 1\] m"),
        ({"open_low": True}, (1e-9, 1.0), (0.0,), r"in \(0, 1\] m"),
        ({"open_high": True}, (0.0, 0.999), (1.0,), r"in \[0, 1\) m"),
        ({"high": math.inf}, (0.0, 1e300), (-1.0, math.inf), "at least 0 m"),
        ({"high": math.inf, "open_low": True}, (1e-300,), (0.0,), "above 0 m"),
    ],
)
def test_ranges_include_their_limits_unless_open(limits, inside, outside, allowed):
    arguments = {"low": 0.0, "high": 1.0, "unit": "m", "hint": "look", **limits}
    for value in inside:
        assert check_range("x", value, **arguments) == value
    for value in outside:
        with pytest.raises(ValueError, match=f"^x = {value}: must be {allowed}"):
            check_range("x", value, **arguments)


def test_the_hint_is_at_the_end():
    with pytest.raises(ValueError, match=r"\[0, 1\] \(use less\)$"):
        check_range("x", 1.5, 0.0, 1.0, hint="use less")


def test_number_sequences_are_converted():
    assert check_named_numbers("x", [1, 2.5], ("low", "high")) == (1.0, 2.5)
    assert check_named_numbers("x", np.array([1, 2]), ("low", "high")) == (1.0, 2.0)
    assert check_named_numbers("x", (v for v in (1, 2)), ("low", "high")) == (1.0, 2.0)


@pytest.mark.parametrize("value", [(1,), (1, 2, 3), "12", b"12", 7, None])
def test_sequences_of_another_length_are_rejected(value):
    with pytest.raises(ValueError, match=r"^x = .*must be 2 numbers \(low, high\)"):
        check_named_numbers("x", value, ("low", "high"))


def test_the_invalid_element_of_a_sequence_is_named():
    with pytest.raises(ValueError, match=r"^x \(high\) = 'y'"):
        check_named_numbers("x", (1, "y"), ("low", "high"))


def test_choices_are_checked():
    assert check_choice("x", "b", ["b", "a"]) == "b"
    with pytest.raises(ValueError, match=r"^x = 'lobbe': must be one of lobe, mirrored \(did you"):
        check_choice("x", "lobbe", ["mirrored", "lobe"])
    with pytest.raises(ValueError, match=r"^x = 3: must be one of a, b$"):
        check_choice("x", 3, ["b", "a"])


def test_suggestions_require_similar_names():
    assert suggest_name("saturaton", ["density", "saturation"]) == "did you mean saturation?"
    assert suggest_name("qqq", ["density", "saturation"]) == ""
    assert suggest_name(7, ["density"]) == ""


def test_suggestions_explain_angles_under_other_names():
    names = ["polar_deg", "azimuth_deg"]
    for given in ("vza", "view_zenith", "VIEW_ZENITH_deg"):
        assert suggest_name(given, names) == "did you mean polar_deg?"
    for given in ("raa", "relative_azimuth_deg"):
        assert suggest_name(given, names) == (
            "did you mean azimuth_deg? "
            "azimuth_deg is 180 minus a relative azimuth that is 0 on the side of the sun"
        )
    assert suggest_name("azimut_deg", names) == "did you mean azimuth_deg?"
    assert suggest_name("sza", ["incidence_deg"]) == "did you mean incidence_deg?"
    for given in ("sza", "incidence_deg"):
        assert suggest_name(given, names) == (
            "incidence_deg is an argument of instruments, and of tables with this axis"
        )


def test_errors_keep_their_attributes():
    error = invalid("depth_m", -1.0, "above 0", "in metres")
    assert (error.key, error.value, error.allowed) == ("depth_m", -1.0, "above 0")
    prefixed = pickle.loads(pickle.dumps(error)).add_prefix("medium", "not in cm")
    assert str(prefixed) == "medium.depth_m = -1.0: must be above 0 (in metres) (not in cm)"
    missing = unknown_key("depth", ["depth_m"]).add_prefix("medium")
    assert isinstance(missing, ValueError)
    assert str(missing) == (
        "medium.depth: unknown key, must be one of depth_m (did you mean depth_m?)"
    )


NARROW_TABLE = make_table(
    lambda size, _: evaluate_spectrum(size, 0.0),
    {SIZE: [50.0, 100.0], "incidence_deg": [30.0, 60.0]},
)
SKY = {"wavelength_nm": [400.0, 800.0], "direct": [1.0, 1.0], "diffuse": [1.0, 1.0]}
MEASURED = (W, evaluate_spectrum(200.0, 64.0))


def interp(table=TABLE, **point):
    return table.interp(**point).reflectance.values


def shift_relative(value, error):
    """Return a value with a relative error, or with an error of 1e-3 of that at 0."""
    return value * (1.0 + error) if value else 1e-3 * error


RANGE_ENDS = {
    "Snow.saturation": (lambda x: splits.Snow(saturation=x).saturation, 1.0, 1),
    "Snow.saturation low": (lambda x: splits.Snow(saturation=x).saturation, 0.0, -1),
    "Snow.temperature_c": (lambda x: splits.Snow(temperature_c=x).temperature_c, -40.0, -1),
    "Snow.depth_m": (lambda x: splits.Snow(depth_m=x).depth_m, 1e4, 1),
    "Snow.facetness": (lambda x: splits.Snow(facetness=(0, x, 0.5, 0.1)).facetness[1], 1.0, 1),
    "Snow.grain_size_um": (lambda x: splits.Snow(grain_size_um=(x, 50)).grain_size_um[0], 1.0, -1),
    "Snow.ground": (lambda x: splits.Snow(ground=x).ground.albedo_values, 1.0, 1),
    "ground.albedo": (
        lambda x: splits.Snow(
            ground={"wavelength_nm": [300, 900], "albedo": [x, 0]}).ground.albedo_values,
        1.0, 1),
    "Sand.roundness": (lambda x: splits.Sand(roundness=(x, 0.1)).roundness[0], 1.0, 1),
    "Sand.partition": (lambda x: splits.Sand(partition=(0, x, 0)).partition[1], 1.0, 1),
    "Sand.texture": (lambda x: splits.Sand(texture=(x, 0, 1)).texture[0], 0.0, -1),
    "ParticleLayer.asymmetry": (lambda x: splits.ParticleLayer(asymmetry=x).asymmetry, 0.999, 1),
    "ParticleLayer.phase_function": (
        lambda x: splits.ParticleLayer(
            phase_function={"cosine": [x, 1], "density": [1, 1]}).kernel_phase_function.cosines,
        -1.0, 1),
    "refractive_index": (lambda x: make_refractive_index("quartz")(x), 198.0, -1),
    "user index": (lambda x: user_index()[0][0] and make_refractive_index("ice", {
        "wavelength_nm": [400, 800], "n": [1.3, 1.4], "k": [0, 0]})(x), 800.0, 1),
    "wavelength_nm": (lambda x: check_wavelengths("wavelength_nm", x), 200.0, -1),
    "polar_deg": (lambda x: check_polar_angles("polar_deg", [x]), 0.0, -1),
    "sky": (lambda x: splits.sky(SKY, 50).compute_direct_fraction(np.array([x])), 800.0, 1),
    "zenith_deg": (lambda x: splits.sky(SKY, x).zenith_deg, 89.0, 1),
    "Table.interp": (lambda x: interp(NARROW_TABLE, incidence_deg=x, **{SIZE: 60}), 30.0, -1),
    "Table.interp root": (lambda x: interp(**FIXED | {SOOT: x, SIZE: 60}), 0.0, -1),
    "Table.interp wavelength": (
        lambda x: interp(**FIXED, wavelength=x, **{SIZE: 60}), 1500.0, 1),
    "Table.derivatives": (
        lambda x: NARROW_TABLE.derivatives(
            [SIZE], incidence_deg=60, **{SIZE: x}).reflectance_jacobian,
        50.0, -1),
    "Table.interp bands": (
        lambda x: TABLE.interp(bands={"a": (x, 600)}, **FIXED, **{SIZE: 60}).band_reflectance,
        500.0, -1),
    "retrieve": (
        lambda x: splits.retrieve(
            ([x, 700], [0.9, 0.8]), TABLE, [SIZE], 0.1, fixed=FIXED).values[SIZE],
        500.0, -1),
    "retrieve fixed": (
        lambda x: splits.retrieve(
            MEASURED, TABLE, [SIZE], 0.1, fixed={SOOT: 64.0, "sza": x}).values[SIZE], 60.0, 1),
    "retrieve free": (
        lambda x: splits.retrieve(MEASURED, TABLE, {SIZE: (x, 800)}, 0.1, fixed=FIXED).values[SIZE],
        40.0, -1),
    "retrieve prior": (
        lambda x: splits.retrieve(
            MEASURED, TABLE, [SIZE], 0.1, fixed=FIXED, prior={SIZE: (x, 200)}).values[SIZE],
        2000.0, 1),
}  # fmt: skip
"""The result for a value, the end of its range, and the side of this end."""


@pytest.mark.parametrize("name", RANGE_ENDS)
def test_rounding_errors_at_range_ends_are_snapped(name):
    call, end, side = RANGE_ENDS[name]
    sign = side * math.copysign(1.0, end) if end else side
    error = 4.0 * np.finfo(float).eps if end else 1e-10
    rounded, outside = shift_relative(end, sign * error), shift_relative(end, sign * 1e-6)
    assert rounded != end
    np.testing.assert_array_equal(call(rounded), call(end))
    with pytest.raises(InvalidValue) as error_info:
        call(outside)
    assert "\n" not in str(error_info.value)


def test_angles_rounded_by_their_cosine_are_accepted():
    """The cosine and its inverse change the last digit of the angle."""
    angle = math.degrees(math.acos(math.cos(math.radians(30.0))))
    assert angle != 30.0
    for table in (NARROW_TABLE, TABLE):
        point = {SIZE: 60.0} if table is NARROW_TABLE else {SIZE: 60.0, SOOT: 64.0}
        np.testing.assert_allclose(
            interp(table, sza=angle, **point),
            interp(table, sza=30.0, **point),
            rtol=1e-12,
        )


def test_values_inside_a_range_are_unchanged():
    inside = np.array([1e-300, 1e-15, 1.0 - 1e-12, 1.0])
    np.testing.assert_array_equal(snap_to_limits(inside, 0.0, 1.0), inside)
    assert check_range("x", 1e-300, 0.0, 1.0, open_low=True) == 1e-300
    for open_end in (-1e-15, 0.0, 1.0, 1.0 + 1e-15):
        with pytest.raises(InvalidValue):
            check_range("x", open_end, 0.0, 1.0, open_low=True, open_high=True)
    np.testing.assert_array_equal(snap_to_limits([math.nan, -math.inf, math.inf], 0.0, math.inf),
                                  [math.nan, -math.inf, math.inf])  # fmt: skip


@NEEDS_JIT
def test_rounded_bottom_depth_is_rejected():
    """Otherwise an interval would be as thin as a rounding error."""
    for thickness, depth in ((0.3, 0.1 + 0.2), (0.1 + 0.2, 0.3)):
        with pytest.raises(InvalidValue, match="top and bottom are always included"):
            splits.irradiance_profile(splits.Snow(depth_m=thickness), [500.0], depth_m=[depth])


def test_visible_range_is_covered_up_to_rounding():
    w = np.linspace(400.0, 780.0, 39)
    assert covers_visible(w)
    assert covers_visible(np.nextafter(w, 800.0)) and covers_visible(np.nextafter(w, 0.0))
    assert not covers_visible(w + 1.0) and not covers_visible(w[::2])


@pytest.mark.parametrize("target", CONVERSIONS)
def test_every_spelling_is_known_and_the_target_changes_nothing(target):
    values = np.array([1.0, np.nan])
    for unit in CONVERSIONS[target]:
        assert is_unit(unit, target)
        assert np.isfinite(convert_units("x", values, unit, target)[0])
    for unit in (target, None, " "):
        np.testing.assert_array_equal(convert_units("x", values, unit, target), values)


@pytest.mark.parametrize(
    ("unit", "target", "expected"),
    [("µm", "um", 1.0), ("m", "um", 1e6), ("K", "degC", -272.15), ("% by Vol", "1", 0.01),
     ("kg * m^-3", "kg m-3", 1.0), ("rad", "degree", 57.29577951), ("Kg/m3", "kg m-3", 1.0),
     ("kg m⁻³", "kg m-3", 1.0), ("kg·m⁻³", "kg m-3", 1.0), ("G/CM³", "kg m-3", 1000.0),
     ("m²/Kg", "m2 kg-1", 1.0), ("M2/KG", "m2 kg-1", 1.0), ("℃", "degC", 1.0),
     ("Micron", "um", 1.0), ("μm", "um", 1.0), ("Cm", "m", 0.01), ("in", "m", 0.0254),
     ("ft", "m", 0.3048), ("kg m−3", "kg m-3", 1.0),
     ("cells / mL", "ml-1", 1.0), ("L-1", "ml-1", 1e-3)],
)  # fmt: skip
def test_values_are_converted(unit, target, expected):
    assert convert_units("x", np.array(1.0), unit, target) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("unit", "target"),
    [("M", "m"), ("Mm", "m"), ("Mm", "um"), ("Mg m-3", "kg m-3"), ("Mg/kg", "1e-9"),
     ("kg", "kg m-3"), ("C", "degC"), (1, "m")],
)  # fmt: skip
def test_other_units_are_rejected(unit, target):
    assert not is_unit(unit, target)
    with pytest.raises(InvalidValue, match=r"x.units = .*must be one of"):
        convert_units("x", np.ones(2), unit, target)


END_WAVELENGTHS = [200.0, 3000.0]
OWN_SOOT = {
    "ng_g": 5.0,
    "wavelength_nm": np.array(END_WAVELENGTHS),
    "absorption_m2_kg": np.array([2.0, 1.0]),
}
WAVES = {"wave_number_per_m": [0.0, 1.0, 2.0], "density": [1.0, 2.0, 0.0]}
ROUGH = {"rms_height_m": 0.01, "correlation": "spectrum", "spectrum": WAVES}
PHASE_FUNCTION = {"cosine": np.array([-1.0, 0.5, 1.0]), "density": np.array([1.0, 1.0, 2.0])}
USER_INDEX = {"wavelength_nm": END_WAVELENGTHS, "n": [1.3, 1.3], "k": [0.0, 1e-5]}


def make_stack(**changes):
    return splits.Stack([splits.Snow(depth_m=0.1), splits.Snow(),
                         splits.ParticleLayer(ground=None)],
                        **changes)  # fmt: skip


OBJECT_FACTORIES = {
    "snow": splits.Snow,
    "snow, own ice": lambda: splits.Snow(refractive_index={"ice": USER_INDEX}, ground="black"),
    "snow, own impurity": lambda: splits.Snow(impurities_ng_g={"mine": OWN_SOOT}),
    "snow, soot": lambda: splits.Snow(impurities_ng_g={"black_carbon": 3}),
    "snow, natural": lambda: splits.Snow.natural(optical_radius_um=100, depth_m=1),
    "sand": splits.Sand,
    "sand, oil": lambda: splits.Sand(pores={"oil": 0.1}, refractive_index={"oil": 1.5}),
    "layer": splits.ParticleLayer,
    "layer, own phase function": lambda: splits.ParticleLayer(phase_function=PHASE_FUNCTION),
    "layer, rough": lambda: splits.ParticleLayer(surface=ROUGH),
    "stack": lambda: make_stack(ground=0.3),
    "stack, other interpretation": lambda: make_stack(interpretation="geometric"),
    "surface": lambda: splits.RoughSurface([ROUGH, {**ROUGH, "waves": 3}]),
    "ground": lambda: Ground.from_input(0.3),
    "ground, table": lambda: Ground.from_input(
        {"wavelength_nm": END_WAVELENGTHS, "albedo": [0.1, 0.2]}
    ),
    "interpretation": splits.Interpretation,
    "interpretation of sand": lambda: splits.SandInterpretation(mixing="linear"),
    "composition": lambda: splits.Sand().composition,
    "sizes": lambda: splits.Sand().size_distribution,
    "index": lambda: make_refractive_index("ice"),
    "index, scaled": lambda: make_refractive_index("ice", {"k_factor": 2.0}),
    "index, oscillators": lambda: make_refractive_index("goethite"),
    "index, constant": lambda: make_refractive_index("ice", 1.3 + 1e-7j),
    "index, own": lambda: make_refractive_index("ice", USER_INDEX),
    "sky": splits.sky,
    "sky, own": lambda: splits.sky(
        {"wavelength_nm": END_WAVELENGTHS, "direct": [1, 2], "diffuse": [0, 1]}, 50.0
    ),
    "band": lambda: SpectralBand.from_limits(400.0, 700.0),
}
COPY_FUNCTIONS = {
    "constructed again": lambda one, make: make(),
    "copied": lambda one, make: copy.copy(one),
    "copied deeply": lambda one, make: copy.deepcopy(one),
    "pickled": lambda one, make: pickle.loads(pickle.dumps(one)),
    "replaced": lambda one, make: replace(one),
}


@pytest.mark.parametrize("copy_method", COPY_FUNCTIONS)
@pytest.mark.parametrize("name", OBJECT_FACTORIES)
def test_equal_objects_have_equal_hashes(name, copy_method):
    original = OBJECT_FACTORIES[name]()
    copied = COPY_FUNCTIONS[copy_method](original, OBJECT_FACTORIES[name])
    assert original == copied
    assert hash(original) == hash(copied)
    assert copied in [None, original] and [None, original].index(copied) == 1
    assert {original: "found"}[copied] == "found"


def test_different_objects_are_not_equal():
    objects = [make() for make in OBJECT_FACTORIES.values()]
    assert all(one != other for i, one in enumerate(objects) for other in objects[:i])
    assert len(set(objects)) == len(objects)
    assert splits.Snow() != "snow" and splits.sky() != "midlatitude_winter"


def test_equality_is_independent_of_types_and_order():
    lists = {key: list(value) if key != "ng_g" else value for key, value in OWN_SOOT.items()}
    equivalent = {"mine": OWN_SOOT, "ash_st_helens": 4}, {"ash_st_helens": 4.0, "mine": lists}
    first, second = (splits.Snow(impurities_ng_g=amounts) for amounts in equivalent)
    assert first == second and hash(first) == hash(second)


def test_tables_are_compared_by_content(tmp_path):
    path = tmp_path / "mine.csv"

    def make_snow(absorption):
        path.write_text(f"wavelength_nm,absorption_m2_kg\n200,{absorption}\n3000,1\n")
        return splits.Snow(impurities_ng_g={"mine": {"ng_g": 5, "table": str(path)}})

    assert make_snow(2) == make_snow(2) != make_snow(3)
