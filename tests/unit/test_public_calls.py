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
AXES_ARE_KEYWORDS = {f"Table.{name}" for name in (
    "derivatives", "deviations", "interp", "interpolation_errors", "to_isofit", "to_spires",
)}  # fmt: skip
"""What takes the axes of a table as keywords, which differ from table to table."""


def list_public_callables():
    """Return all public callables by name: functions, classes, and methods of classes."""
    found = {name: getattr(splits, name) for name in splits.__all__ if name != "__version__"}
    for kind in [one for one in found.values() if inspect.isclass(one)]:
        for name in vars(kind):
            if not name.startswith("_") and callable(getattr(kind, name)):
                found[f"{kind.__name__}.{name}"] = getattr(kind, name)
    return found


@pytest.mark.parametrize("name", list_public_callables())
def test_every_public_callable_names_what_it_takes(name):
    parameters = inspect.signature(list_public_callables()[name]).parameters.values()
    kinds = {one.kind for one in parameters}
    assert Parameter.VAR_POSITIONAL not in kinds
    assert (Parameter.VAR_KEYWORD in kinds) == (name in AXES_ARE_KEYWORDS)
    assert all(one.annotation is not Parameter.empty for one in parameters if one.name != "self")


@pytest.mark.parametrize("name", ["Snow", "Snow.natural"])
def test_snow_names_all_keywords_that_it_takes(name):
    taken = {*inspect.signature(splits.Snow).parameters}
    assert {"specific_surface_area_m2_kg", "optical_radius_um", "liquid_water_content"} < taken
    assert {*inspect.signature(list_public_callables()[name]).parameters} == taken


def test_type_checkers_see_the_same_parameters(tmp_path):
    pytest.importorskip("mypy")
    program = tmp_path / "program.py"
    lines = [f"reveal_type(splits.{name})" for name in list_public_callables()]
    program.write_text("\n".join(["import splits", *lines]), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", str(program)], cwd=ROOT, capture_output=True, text=True
    )
    seen = re.findall(r'program\.py:\d+: note: Revealed type is "def (.*)"', done.stdout)
    assert len(seen) == len(list_public_callables()), done.stdout + done.stderr
    for name, text in zip(list_public_callables(), seen, strict=True):
        parameters = list(inspect.signature(list_public_callables()[name]).parameters)
        assert re.findall(r"(?:^\(|, |\*\*)(\w+): ", text) == parameters, name


# --- mistakes -------------------------------------------------------------------------------------

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
    "select_bands": lambda: splits.select_bands(3, [(400, 500)], {}, 0.1),
    "beam_spread": lambda: splits.beam_spread(SNOW, "x"),
    "deep_transmittance": lambda: splits.deep_transmittance(SNOW, "x"),
    "goniophotometer": lambda: splits.goniophotometer(SNOW, [500], 95),
    "hdrf": lambda: splits.hdrf(SNOW, "midlatitude", [500]),
    "lens": lambda: splits.lens(LAYER, [1], -1),
    "radiation_profile": lambda: splits.radiation_profile(SNOW, {"direct": [1]}, [0.1]),
    "load": lambda: splits.load("there/is/none.nc"),
    "open_table": lambda: splits.open_table("there/is/none.nc"),
    "phase_function": lambda: splits.phase_function(3),
    "irradiance_profile": lambda: splits.irradiance_profile(SNOW, [500], [-1]),
    "retrieve": lambda: splits.retrieve([1, 2], SNOW, {}),
    "retrieve_map": lambda: splits.retrieve_map(3, 3, {}, 3),
    "save": lambda: splits.save(EMPTY, "x.txt"),
    "save_brdf": lambda: splits.save_brdf(EMPTY, "x", {}),
    "sensor_bands": lambda: splits.sensor_bands("x"),
    "single_scattering": lambda: splits.single_scattering(SNOW, "x"),
    "sky": lambda: splits.sky("clear", zenith_deg=100),
    "sobol_indices": lambda: splits.sobol_indices(3, {}),
    "spectrophotometer": lambda: splits.spectrophotometer(SNOW, [500], progress=3),
    "surface_map": lambda: splits.surface_map(LAYER, -1),
    "build_table": lambda: splits.build_table(splits.Snow.natural, {"depth_m": [1, 2]}, "x"),
    "with_diffraction": lambda: splits.with_diffraction(EMPTY, -1),
}
NO_INVALID_VALUES = {"Progress", "ProgressBar", "Sky"}
"""What instruments and `splits.sky` make, or what shows any text."""


def test_every_public_function_and_class_has_its_mistake():
    names = {name for name in list_public_callables() if "." not in name} | {"Snow.natural"}
    assert set(INVALID_CALLS) == names - NO_INVALID_VALUES


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_an_error_is_raised_at_the_line_of_the_call(name):
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        INVALID_CALLS[name]()
    assert "\n" not in str(caught.value)
    frames = traceback.extract_tb(caught.value.__traceback__)
    inner = [frame for frame in frames if frame.filename != __file__]
    assert {Path(frame.filename).name for frame in inner} == {"validation.py"}
    assert len(inner) == 2
    assert caught.value.__cause__ is None and caught.value.__suppress_context__
