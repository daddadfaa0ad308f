"""Public callables: signatures, types of arguments, parameters given twice, lines of errors."""

import inspect
import itertools
import re
import subprocess
import sys
import traceback
from inspect import Parameter
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from array_inputs import FIXED, SIZE, SOOT, TABLE
from formula_tables import W, evaluate_spectrum, make_table

import splits
from splits.core.discovery import load_instruments
from splits.core.inputs import check_beam_angle, check_incidence, check_wavelengths
from splits.core.validation import InvalidValue, check_integer, check_number, short_repr
from splits.experiments.config.experiment import ExperimentConfig
from splits.retrieval.medium_model import check_measurement_incidence, make_medium_state_vector
from splits.tables.conversions import convert_to_isofit

ROOT = Path(__file__).parents[2]
TAKES_OTHER_KEYWORDS = {f"Table.{name}" for name in (
    "derivatives", "deviations", "interp", "interpolation_errors", "to_eradiate", "to_isofit",
)} | {"draw", "load_medium"}  # fmt: skip
"""Callables whose keywords are axes of a table, keywords of a medium, or settings of a figure."""


def list_public_callables():
    """Return all public callables by name: functions, classes, and methods of classes."""
    callables = {name: getattr(splits, name) for name in splits.__all__ if name != "__version__"}
    for cls in [item for item in callables.values() if inspect.isclass(item)]:
        for name in vars(cls):
            if not name.startswith("_") and callable(getattr(cls, name)):
                callables[f"{cls.__name__}.{name}"] = getattr(cls, name)
    return callables


def test_parameters_of_instruments_are_documented_in_their_order():
    functions = load_instruments().values()
    assert len(functions) >= 11
    for function in functions:
        text = inspect.getdoc(function).split("Parameters\n----------\n")[1].split("\n\n")[0]
        heads = [line.split(" : ")[0] for line in text.splitlines() if not line.startswith(" ")]
        assert ", ".join(heads).split(", ") == list(inspect.signature(function).parameters)


@pytest.mark.parametrize("name", list_public_callables())
def test_public_callables_have_complete_signatures(name):
    parameters = inspect.signature(list_public_callables()[name]).parameters.values()
    kinds = {parameter.kind for parameter in parameters}
    assert Parameter.VAR_POSITIONAL not in kinds
    assert (Parameter.VAR_KEYWORD in kinds) == (name in TAKES_OTHER_KEYWORDS)
    assert all(
        parameter.annotation is not Parameter.empty
        for parameter in parameters
        if parameter.name != "self"
    )


@pytest.mark.parametrize("name", ["Snow", "Snow.natural"])
def test_snow_signatures_list_all_keywords(name):
    keywords = {*inspect.signature(splits.Snow).parameters}
    assert {"specific_surface_area_m2_kg", "optical_radius_um", "liquid_water_content"} < keywords
    assert {*inspect.signature(list_public_callables()[name]).parameters} == keywords


def test_type_checkers_see_the_same_parameters(tmp_path):
    pytest.importorskip("mypy")
    program = tmp_path / "program.py"
    # Mypy does not infer the keywords of a constructor from its class.
    callables = {n: one for n, one in list_public_callables().items() if n != "Snow.natural"}
    lines = [f"reveal_type(splits.{name})" for name in callables]
    program.write_text("\n".join(["import splits", *lines]), encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "-m", "mypy", str(program)], cwd=ROOT, capture_output=True, text=True
    )
    signatures = re.findall(r'program\.py:\d+: note: Revealed type is "def (.*)"', result.stdout)
    assert len(signatures) == len(callables), result.stdout + result.stderr
    for (name, one), text in zip(callables.items(), signatures, strict=True):
        parameters = list(inspect.signature(one).parameters)
        assert re.findall(r"(?:^\(|, |\*\*)(\w+): ", text) == parameters, name


# --- invalid calls --------------------------------------------------------------------------------

SNOW, LAYER, EMPTY = splits.Snow(), splits.ParticleLayer(), xr.Dataset()
INVALID_CALLS = {
    "ParticleLayer": lambda: splits.ParticleLayer(asymmetry=2),
    "Interpretation": lambda: splits.Interpretation(entry_point="x"),
    "RoughSurface": lambda: splits.RoughSurface({"rms_height_m": -1, "wave_number_per_m": 1}),
    "Sand": lambda: splits.Sand(iron_oxide=0.5),
    "SandInterpretation": lambda: splits.SandInterpretation(water="x"),
    "Snow": lambda: splits.Snow(specific_surface_area_m2_kg=-1),
    "Snow.natural": lambda: splits.Snow.natural(optical_radius_um=-1),
    "Stack": lambda: splits.Stack([SNOW, 3]),
    "Table": lambda: splits.Table(EMPTY),
    "albedo": lambda: splits.albedo(splits.Snow(ground="camborthid"), "midlatitude_winter"),
    "beam_spread": lambda: splits.beam_spread(SNOW, "x"),
    "draw": lambda: splits.draw(EMPTY, "spectrum"),
    "make_colour_table": lambda: splits.make_colour_table(EMPTY),
    "select_principal_plane": lambda: splits.select_principal_plane(EMPTY),
    "compute_mie_matrix": lambda: splits.compute_mie_matrix([500], 1.33, 10.0, 2.0),
    "goniophotometer": lambda: splits.goniophotometer(SNOW, [500], 95),
    "hdrf": lambda: splits.hdrf(SNOW, "midlatitude", [500]),
    "lens": lambda: splits.lens(LAYER, screen_depth_m=[1], radius_m=-1),
    "radiation_profile": lambda: splits.radiation_profile(SNOW, {"direct": [1]}, depth_m=[0.1]),
    "load": lambda: splits.load("there/is/none.nc"),
    "load_medium": lambda: splits.load_medium("red_dune", saturation=2),
    "phase_function": lambda: splits.phase_function(3),
    "irradiance_profile": lambda: splits.irradiance_profile(SNOW, [500], depth_m=[-1]),
    "retrieve": lambda: splits.retrieve([1, 2], SNOW, {}),
    "retrieve_map": lambda: splits.retrieve_map(3, 3, {}, 3),
    "SnowPacks": lambda: splits.SnowPacks(EMPTY),
    "read_caaml": lambda: splits.read_caaml("there/is/none.xml"),
    "read_crocus": lambda: splits.read_crocus(EMPTY),
    "read_snow_packs": lambda: splits.read_snow_packs("there/is/none.csv"),
    "save": lambda: splits.save(EMPTY, "x.txt"),
    "sensor_bands": lambda: splits.sensor_bands("x"),
    "single_scattering": lambda: splits.single_scattering(SNOW, "x"),
    "sky": lambda: splits.sky("clear", zenith_deg=100),
    "spectrophotometer": lambda: splits.spectrophotometer(SNOW, [500], progress=3),
    "surface_map": lambda: splits.surface_map(LAYER, half_width_m=-1),
    "time_of_flight": lambda: splits.time_of_flight(SNOW, "x"),
    "build_table": lambda: (
        splits.build_table(splits.Snow.natural, {"depth_m": [1, 2]}, "x").dataset
    ),
    "retrieve_return": lambda: splits.retrieve_return(([0, 1], [1]), EMPTY, ["depth_m"], 1),
    "with_diffraction": lambda: splits.with_diffraction(EMPTY, -1),
}
NO_INVALID_VALUES = {"Progress", "ProgressBar", "Sky", "list_media"}
"""Results of instruments and of `splits.sky`, the progress bar, and a function of no arguments."""


def test_every_public_callable_has_an_invalid_call():
    names = {name for name in list_public_callables() if "." not in name} | {"Snow.natural"}
    assert set(INVALID_CALLS) == names - NO_INVALID_VALUES


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_errors_are_raised_at_the_calling_line(name):
    with pytest.raises((ValueError, FileNotFoundError)) as error:
        INVALID_CALLS[name]()
    assert "\n" not in str(error.value)
    frames = traceback.extract_tb(error.value.__traceback__)
    inner = [frame for frame in frames if frame.filename != __file__]
    # Constructors of media raise their errors themselves.
    assert {Path(frame.filename).name for frame in inner} < {"keywords.py", "declarations.py"}
    assert len(inner) == 1
    assert error.value.__cause__ is None and error.value.__suppress_context__


@pytest.mark.parametrize("value", [30, 30.0, np.float32(30), np.array(30.0), xr.DataArray(30.0)])
def test_all_scalar_types_are_accepted(value):
    assert (
        check_incidence("incidence_deg", value) == check_beam_angle("incidence_deg", value) == 30.0
    )
    assert check_wavelengths("wavelength_nm", 500.0 + 0 * value).tolist() == [500.0]
    assert splits.Snow(density_kg_m3=value * 10).density_kg_m3 == 300.0
    if not isinstance(value, float | np.float32) and np.asarray(value).dtype.kind == "i":
        assert check_integer("rays", value, 1) == 30


@pytest.mark.parametrize("value", [3, np.int64(3), np.array(3)])
def test_all_integer_types_are_accepted(value):
    assert check_integer("rays", value, 1) == 3


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("500", "wavelength_nm = '500': must be numbers in nanometres (write 500, "),
        (["500"], "wavelength_nm = '500': must be numbers in nanometres (write 500"),
        (np.array(["500"]), "wavelength_nm = '500': must be numbers in nanometres (write 500"),
        ([None], "wavelength_nm = None: must be numbers in nanometres"),
        (None, "wavelength_nm = None: must be numbers in nanometres"),
        (0.5, "wavelength_nm = 0.5: must be in [200, 100000] nm (in micrometres? write 500)"),
        ([0.4, 0.5], "wavelength_nm = 0.4: must be in [200, 100000] nm (in micrometres? "),
        (150, "wavelength_nm = 150.0: must be in [200, 100000] nm"),
        ([], "wavelength_nm = []: must be numbers in nanometres, at least one"),
        ([500, np.nan], "wavelength_nm = nan: must be numbers in nanometres"),
        ([10**400], "wavelength_nm = 1000"),
        ([[400, 500]], "wavelength_nm = [[400, 500]]: must be one row of numbers in nanometres"),
        ({"start": 400}, "wavelength_nm.stop = None: must be given"),
        (itertools.count(300), "must be at most 20000 numbers"),
    ],
)  # fmt: skip
def test_invalid_wavelengths_are_explained(value, message):
    with pytest.raises(ValueError) as error:
        check_wavelengths("wavelength_nm", value)
    assert str(error.value).startswith(message) or str(error.value).endswith(message)


def test_unsorted_wavelengths_are_reported_by_the_first_pair():
    values = [*range(400, 2500, 2), 2400]
    with pytest.raises(ValueError) as error:
        check_wavelengths("wavelength_nm", values)
    assert str(error.value) == (
        "wavelength_nm = [2498.0, 2400.0]: must be strictly increasing (numbers 1050 and 1051 of "
        "1051)"
    )


@pytest.mark.parametrize(
    ("value", "hint"),
    [
        ([0, 30], "one call for each angle, or an experiment with a grid"),
        (np.array([0.0, 30.0]), "one call for each angle, or an experiment with a grid"),
        ("30", "write 30, without quotes"),
        ("difuse", "did you mean diffuse?"),
    ],
)
def test_invalid_angles_get_a_hint(value, hint):
    for call in (
        lambda: splits.spectrophotometer(splits.Snow(), [500], value),
        lambda: splits.goniophotometer(splits.Snow(), [500], value),
    ):
        with pytest.raises(ValueError, match=r"^incidence_deg = ") as error:
            call()
        assert str(error.value).endswith(f"({hint})")


@pytest.mark.parametrize(
    ("medium", "keyword", "message"),
    [
        (splits.Snow, "grain_size", "(did you mean grain_size_um?)"),
        (splits.Snow, "ssa", "must be one of grain_size_um, facetness, sphericity, saturation"),
        (splits.Sand, "irn_oxide", "(did you mean iron_oxide?)"),
        (splits.ParticleLayer, "optical_depth", "must be one of optical_thickness"),
        (splits.Interpretation, "entri", "(did you mean entry_point?)"),
        (splits.SandInterpretation, "mixin", "(did you mean mixing?)"),
    ],
)
def test_unknown_keywords_are_reported_with_valid_ones(medium, keyword, message):
    with pytest.raises(TypeError, match=f"^{keyword}: unknown key") as error:
        medium(**{keyword: 1})
    assert message in str(error.value)


def test_media_keep_their_signatures():
    import inspect

    assert list(inspect.signature(splits.Snow).parameters)[:2] == ["grain_size_um", "facetness"]


def test_values_in_messages_are_short_and_one_line():
    assert short_repr(list(range(10_000))) == "[0, 1, 2, 3, 4, 5, 6, 7, ...]"
    assert short_repr({"b": 1, "a": 2}) == "{'b': 1, 'a': 2}"
    assert short_repr(np.float64(1.5)) == "1.5"
    assert len(short_repr("x" * 10_000)) < 100
    assert "\n" not in short_repr(np.zeros((50, 50)))
    with pytest.raises(ValueError, match=r"^x = 1000") as error:
        check_number("x", 10**400)
    assert len(str(error.value)) < 200


def test_too_many_wavelengths_for_memory_are_rejected():
    wavelengths = np.arange(300.0, 10_300.0)
    with pytest.raises(ValueError, match=r"^wavelength_nm = '10000 wavelengths': must be at most"):
        splits.goniophotometer(splits.Snow(), wavelengths[:10_000])


def test_too_many_independent_wavelengths_are_rejected():
    wavelengths = np.arange(400.0, 2500.0, 0.5)
    with pytest.raises(ValueError, match=r"^wavelength_nm = '4200 wavelengths': must be at most"):
        splits.spectrophotometer(splits.Snow(), wavelengths, max_stderr=1e-6, max_rays=1)


@pytest.mark.parametrize(
    ("instrument", "misspelt", "suggestion"),
    [
        (splits.spectrophotometer, "incidence", "incidence_deg"),
        (splits.goniophotometer, "relative_error", "relative_stderr"),
        (splits.irradiance_profile, "depths_m", "depth_m"),
        (splits.single_scattering, "ray", "rays"),
        (splits.albedo, "band", "bands"),
    ],
)
def test_misspelt_arguments_of_instruments_get_a_suggestion(instrument, misspelt, suggestion):
    with pytest.raises(TypeError, match=rf"^{misspelt}: unknown key.*did you mean {suggestion}\?"):
        instrument(splits.Snow(), [500.0], **{misspelt: 1})
    assert suggestion in inspect.signature(instrument).parameters


BOTH_SPELLINGS = {"sza": 30.0, "incidence_deg": 50.0}
POINT = {SIZE: 100.0, SOOT: 64.0}
MEASURED = (W, evaluate_spectrum(200.0, 64.0))
NATURAL_SNOW = splits.Snow.natural(specific_surface_area_m2_kg=20)
ANGLE_TABLE = make_table(
    lambda size, angle, _: evaluate_spectrum(size, 0.0),
    {SIZE: [50.0, 100.0], "incidence_deg": [0.0, 60.0], "depth_m": [1.0, 2.0]},
).dataset

GIVEN_TWICE = {
    "interp": lambda: TABLE.interp(**POINT, **BOTH_SPELLINGS),
    "derivatives": lambda: TABLE.derivatives([SIZE], **POINT, **BOTH_SPELLINGS),
    "interpolation_errors": lambda: TABLE.interpolation_errors("reflectance", **POINT,
                                                               **BOTH_SPELLINGS),
    "retrieve": lambda: splits.retrieve(MEASURED, TABLE, [SIZE], 0.1,
                                        fixed={SOOT: 64.0} | BOTH_SPELLINGS),
    "fixed of a medium": lambda: check_measurement_incidence(BOTH_SPELLINGS, {}),
    "table": lambda: splits.build_table(
        splits.Snow.natural, {SIZE: [100, 200], "incidence_deg": [0, 60]}, [500], 30.0
    ).dataset,
    "experiment": lambda: ExperimentConfig(
        name="made", medium={"kind": "snow"}, grid={"incidence_deg": [0, 60]},
        instrument={"wavelength_nm": [500], "incidence_deg": 30},
    ),
    "Snow": lambda: splits.Snow(saturation=0.1, liquid_water_content=0.1),
    "Snow.natural": lambda: splits.Snow.natural(
        specific_surface_area_m2_kg=20, optical_radius_um=100
    ),
    "free": lambda: make_medium_state_vector(
        NATURAL_SNOW, {SIZE: (50, 500), "specific_surface_area_m2_kg": (5, 50)}, None, 0.0
    ),
    "free of a layer": lambda: make_medium_state_vector(
        splits.Stack([NATURAL_SNOW]),
        {"layers.0.saturation": (0, 0.2), "layers.0.liquid_water_content": (0, 0.1)}, None, 0.0,
    ),
}  # fmt: skip
IGNORED_ALIASES = {
    "interpolation_errors": lambda: TABLE.interpolation_errors("reflectance", **POINT, szaa=3),
    "isofit": lambda: convert_to_isofit(ANGLE_TABLE, depth=1.0),
    "isofit free": lambda: convert_to_isofit(ANGLE_TABLE, depth_m=1.0, incidence_deg=30.0),
}


@pytest.mark.parametrize("name", GIVEN_TWICE)
def test_parameters_given_twice_are_rejected(name):
    with pytest.raises(ValueError, match=r"left out(, because| where)"):
        GIVEN_TWICE[name]()


@pytest.mark.parametrize("name", IGNORED_ALIASES)
def test_keywords_without_effect_are_rejected(name):
    with pytest.raises(InvalidValue, match=r"unknown key|left out, as it is free"):
        IGNORED_ALIASES[name]()


def test_aliases_are_accepted_for_all_axes():
    full_name, alias = {"incidence_deg": 30.0}, {"sza": 30.0}
    for evaluate in (
        lambda angle: TABLE.interp(**POINT, **angle).reflectance,
        lambda angle: TABLE.derivatives([SIZE], **POINT, **angle).reflectance_jacobian,
        lambda angle: TABLE.interpolation_errors("reflectance", **POINT, **angle),
        lambda angle: (
            splits.retrieve(MEASURED, TABLE, [SIZE], 0.1, fixed={SOOT: 64.0} | angle).dataset.value
        ),
    ):
        assert (abs(evaluate(full_name) - evaluate(alias)) == 0.0).all()
    assert FIXED["incidence_deg"] == 30.0


def test_equivalent_parameters_of_two_layers_are_accepted():
    stack = splits.Stack(
        [splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1), NATURAL_SNOW]
    )
    ranges = {"layers.0.saturation": (0, 0.2), "layers.1.liquid_water_content": (0, 0.1)}
    assert make_medium_state_vector(stack, ranges, None, 0.0).names == tuple(ranges)
