"""Public callables: complete signatures, and errors raised at the line of the call."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import traceback
from inspect import Parameter
from pathlib import Path

import pytest
import xarray as xr

import splits

ROOT = Path(__file__).parents[2]
TAKES_OTHER_KEYWORDS = {f"Table.{name}" for name in (
    "derivatives", "deviations", "interp", "interpolation_errors", "to_eradiate", "to_isofit",
)} | {"load_medium"}  # fmt: skip
"""Callables whose keywords are the axes of a table, or the keywords of a medium."""


def list_public_callables():
    """Return all public callables by name: functions, classes, and methods of classes."""
    callables = {name: getattr(splits, name) for name in splits.__all__ if name != "__version__"}
    for cls in [item for item in callables.values() if inspect.isclass(item)]:
        for name in vars(cls):
            if not name.startswith("_") and callable(getattr(cls, name)):
                callables[f"{cls.__name__}.{name}"] = getattr(cls, name)
    return callables


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
    lines = [f"reveal_type(splits.{name})" for name in list_public_callables()]
    program.write_text("\n".join(["import splits", *lines]), encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "-m", "mypy", str(program)], cwd=ROOT, capture_output=True, text=True
    )
    signatures = re.findall(r'program\.py:\d+: note: Revealed type is "def (.*)"', result.stdout)
    assert len(signatures) == len(list_public_callables()), result.stdout + result.stderr
    for name, text in zip(list_public_callables(), signatures, strict=True):
        parameters = list(inspect.signature(list_public_callables()[name]).parameters)
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
    "compute_mie_matrix": lambda: splits.compute_mie_matrix([500], 1.33, 10.0, 2.0),
    "goniophotometer": lambda: splits.goniophotometer(SNOW, [500], 95),
    "hdrf": lambda: splits.hdrf(SNOW, "midlatitude", [500]),
    "lens": lambda: splits.lens(LAYER, [1], -1),
    "radiation_profile": lambda: splits.radiation_profile(SNOW, {"direct": [1]}, [0.1]),
    "load": lambda: splits.load("there/is/none.nc"),
    "load_medium": lambda: splits.load_medium("red_dune", saturation=2),
    "open_table": lambda: splits.open_table("there/is/none.nc"),
    "phase_function": lambda: splits.phase_function(3),
    "irradiance_profile": lambda: splits.irradiance_profile(SNOW, [500], [-1]),
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
    "surface_map": lambda: splits.surface_map(LAYER, -1),
    "time_of_flight": lambda: splits.time_of_flight(SNOW, "x"),
    "build_table": lambda: splits.build_table(splits.Snow.natural, {"depth_m": [1, 2]}, "x"),
    "build_return_table": lambda: splits.build_return_table(splits.Snow.natural, {}, 532),
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
    assert {Path(frame.filename).name for frame in inner} == {"keywords.py"}
    assert len(inner) == 1
    assert error.value.__cause__ is None and error.value.__suppress_context__
