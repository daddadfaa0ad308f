"""Errors of experiment files: key with its full path, value, allowed values, hint."""

import re
from pathlib import Path

import pytest
import yaml
from shipped import CONFIG

from splits.core.validation import ConfigError, InvalidValue
from splits.experiments import load_experiment, load_experiments, load_settings
from splits.experiments.config.load import read_yaml
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run

ROOT = Path(__file__).parents[3]
MEDIA = CONFIG / "media"
WAVES = {"rms_height_m": 1, "wave_number_per_m": 0.1, "waves": 8, "correlation": "gaussian"}
ROUGH = {"medium": {"kind": "particle_layer", "depth_m": 100, "surface": WAVES}}
ONE_LAYER = {"wavelength_nm": [550]}


def read_message(tmp_path, content):
    """Return the error message of a file without its path and line."""
    path = tmp_path / "wrong.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content), "utf-8")
    with pytest.raises(ConfigError) as error:
        load_experiment(path, MEDIA)
    text = str(error.value)
    position, message = re.fullmatch(rf"{re.escape(str(path))}(, line \d+): (.*)", text).groups()
    assert position
    return message


WRONG_TYPES = {
    "instrument: {wavelength_nm: [500, blue]}":
        "instrument.wavelength_nm = 'blue': must be numbers in nanometres (this is text, not a "
        "number)",
    "instrument: {wavelength_nm: {start: 400, stop: .inf, step: 1}}":
        "instrument.wavelength_nm.stop = inf: must be a finite number",
    "instrument: {wavelength_nm: {start: 400, stop: 500, stepp: 1}}":
        "instrument.wavelength_nm.stepp: unknown key, must be one of start, stop, step, also "
        "(did you mean step?)",
    "grid: {density_kg_m3: {start: 300, stop: 400, stepp: 50}}":
        "grid.density_kg_m3.stepp = 50: must be left out (did you mean step?)",
    "grid: {density_kg_m3: {strat: 300, stop: 400, step: 50}}":
        "grid.density_kg_m3.strat = 300: must be left out (did you mean start?)",
    "grid: {density_kg_m3: {start: 300, end: 400}}":
        "grid.density_kg_m3.end = 400: must be left out (did you mean stop?)",
    "grid: {density_kg_m3: {stop: 400, step: 50}}":
        "grid.density_kg_m3.start = None: must be given (start, stop and step give evenly spaced "
        "values; label others otherwise)",
    "grid: {density_kg_m3: {geomspace: [300, 400, 3], also: 500}}":
        "grid.density_kg_m3 = {'geomspace': [300, 400, 3], 'also': 500}: must be geomspace without "
        "other keys",
    "grid: {density_kg_m3: {start: 300, stop: 410, step: 50}}":
        "grid.density_kg_m3.stop = 410.0: must be a whole number of steps from start, such as "
        "400 or 450",
    "medium: {kind: snow, interpretation: [a]}\ngrid: {interpretation: [geometric]}":
        "medium.interpretation = ['a']: must be a mapping of named choices, or the name of a set",
    "medium: {kind: snow, facetness: [[0.1, 0.2, 0.1, 0.1], [0.2, 0.3, 0.2, 0.1]]}":
        "medium.facetness = [[0.1, 0.2, 0.1, 0.1], [0.2, 0.3, 0.2, 0.1]]: must be 4 numbers (min, "
        "max, mean, sd) (several values belong under grid)",
    "medium: {kind: sand}\ngrid: {texture.silt: [0, 0.5]}":
        "grid.texture.silt = 0.5: must be silt + 1.5 clay at most 0.15 (more is not a sand)",
    "instrument: {kind: lens, radius_m: 1, screen_depth_m: 0}":
        "instrument.screen_depth_m = 0.0: must be in (0, 1e+09] m",
    "instrument: {kind: beam_spread, rays: 1.5}":
        "instrument.rays = 1.5: must be a whole number of at least 1",
    "instrument: {kind: beam_spread, rays: many}":
        "instrument.rays = 'many': must be a whole number of at least 1",
    "instrument: {kind: beam_spread, rays: true}":
        "instrument.rays = True: must be a whole number of at least 1",
    "instrument: {kind: goniophotometer, polar_deg: [true, 10]}":
        "instrument.polar_deg = True: must be numbers in degrees",
    "instrument: {wavelength_nm: [true, 500]}":
        "instrument.wavelength_nm = True: must be numbers in nanometres",
    "retrieve: {measured: a.csv, free: [depth_m], prior: {depth_m: [false, true]}}":
        "retrieve.prior.depth_m[0] = False: must be a number",
    "figure: {quantity: [brdf, brdf]}":
        "figure.quantity = ['brdf', 'brdf']: must be at least one, without repetition",
    "instrument: {kind: table, quantities: [reflectance, reflectance]}":
        "instrument.quantities = ['reflectance', 'reflectance']: must be a list of different "
        "reflectance or transmittance",
    "instrument: {kind: table, quantities: [transmittance]}\n"
    "medium: {kind: natural_snow, depth_m: 1}\ngrid: {optical_radius_um: [100, 200]}\n"
    "figure: {quantity: reflectance}":
        "figure.quantity = 'reflectance': must be one of transmittance",
    "instrument: {kind: beam_spread, rays: 0}":
        "instrument.rays = 0: must be a whole number of at least 1",
    "instrument: {kind: goniophotometre}":
        "instrument.kind = 'goniophotometre': must be one of albedo, beam_spread, "
        "goniophotometer, hdrf, irradiance_profile, lens, radiation_profile, refractive_index, "
        "return_table, single_scattering, spectrophotometer, surface_map, table, time_of_flight "
        "(did you mean goniophotometer?)",
    "instrument: {kind: goniophotometer, n_bins: [5]}":
        "instrument.n_bins = [5]: must be two whole numbers from 1 to 1000",
    "instrument: {kind: table, radius_m: 3}":
        "instrument.radius_m = 3: must be left out for table (it belongs to lens)",
    "instrument: 5": "instrument = 5: must be a mapping of keys to values",
    "figure: {ylim: [0, 1, 2]}": "figure.ylim = [0, 1, 2]: must be a list of 2 values",
    "figure: {select: {saturation: [0]}}":
        "figure.select.saturation = [0]: must be a number or text",
    "title: 2024": "title = 2024: must be text (put it into quotes)",
    "retrieve: 5": "retrieve = 5: must be a mapping of keys to values",
    "5: 6": "5: unknown key, must be one of name, medium, instrument, grid, group, "
        "reproduces, title, caption, figure, retrieve, retrieve_return",
}  # fmt: skip


@pytest.mark.parametrize("text", WRONG_TYPES)
def test_wrong_types_are_described(tmp_path, text):
    assert read_message(tmp_path, text) == WRONG_TYPES[text]


def test_a_misspelt_figure_is_reported(tmp_path):
    text = read_message(tmp_path, "figure: {kind: swatchs}")
    assert text.startswith("figure.kind = 'swatchs': must be one of bins, ")
    assert text.endswith("(did you mean swatches?)")


@pytest.mark.parametrize("rays", ["1e5", "1.0e5", "1E+5", "100_000"])
def test_whole_numbers_may_be_written_with_an_exponent(tmp_path, rays):
    path = tmp_path / "made.yaml"
    path.write_text(
        f"instrument: {{kind: beam_spread, wavelength_nm: [500], rays: {rays}}}\n", "utf-8"
    )
    assert load_experiment(path, MEDIA).instrument.get("rays") == 100_000


@pytest.mark.parametrize(
    "content",
    [
        {"medium": {"saturation": [0, 0.1]}},
        {"medium": {"grain_size_um": [[100, 200], [300, 400]]}},
        {"medium": {"kind": "particle_layer", "polarized": [False, True]}, "instrument": ONE_LAYER},
        {"instrument": {"incidence_deg": [0, 30]}},
    ],
)
def test_lists_of_values_belong_under_grid(tmp_path, content):
    assert read_message(tmp_path, content).endswith("(several values belong under grid)")


KEY_LOCATIONS = [
    ({"medium": {"saturation": 2}}, "medium.saturation = 2: must be in [0, 1]"),
    ({"medium": {"depth_m": -1}}, "medium.depth_m = -1: must be"),
    ({"grid": {"saturation": [0, 2]}}, "grid.saturation = 2: must be in [0, 1]"),
    ({"grid": {"medium": {"wet": {"saturation": 2}}}}, "grid.medium.wet.saturation = 2: must"),
    ({"grid": {"incidence_deg": [0, 95]}}, "grid.incidence_deg = 95: must be in [0, 89.9999]"),
    ({"instrument": {"incidence_deg": 95}}, "instrument.incidence_deg = 95: must be in"),
    ({"instrument": {"wavelength_nm": [100]}}, "instrument.wavelength_nm = 100.0: must be in"),
    ({"instrument": {"wavelength_nm": [500, 400]}}, "instrument.wavelength_nm = [500.0, 400.0]"),
    ({"instrument": {"kind": "goniophotometer", "estimator": "bins", "n_bins": [0, 2]}},
     "instrument.n_bins = [0, 2]: must be"),
    ({"medium": {"kind": "sand"}, "grid": {"partition.coated": [0, 2]}},
     "grid.partition.coated = 2.0: must be in"),
    ({"medium": {"kind": "sand"}, "grid": {"partition.coatd": [0, 1]}},
     "grid.partition = 'coatd': must be one of coated, mixed, pure (did you mean coated?)"),
    ({"medium": {"kind": "sand"}, "grid": {"partition.pure": [0, 1], "partition.coated": [0, 1]}},
     "grid.partition.pure = 'given': must be left out (partition.coated is given, and"),
    ({"medium": {"kind": "snow"}, "grid": {"partition.coated": [0, 1]}},
     "grid.partition.coated: unknown key"),
    ({"medium": {"kind": "particle_layer", "surface": {"rms_height_m": 1, "wave_number_per_m": 1}}},
     "medium.surface.band_limit_per_m = None: must be given"),
]  # fmt: skip


@pytest.mark.parametrize(("content", "message"), KEY_LOCATIONS)
def test_messages_begin_with_the_full_key(tmp_path, content, message):
    assert read_message(tmp_path, content).startswith(message)


def make_instrument_section(kind, **settings):
    required = {
        "lens": {"radius_m": 1, "screen_depth_m": [1], "centre_on": "origin"},
        "surface_map": {"half_width_m": 1},
    }
    return {"kind": kind, **required.get(kind, {}), **settings}


UNUSED_SETTINGS = [
    *(({**ROUGH, "instrument": make_instrument_section(kind, **{key: value})}, f"instrument.{key}")
      for kind in ("lens", "surface_map")
      for key, value in (("wavelength_nm", [550]), ("incidence_deg", 30), ("stderr_scale", 2))),
    ({"instrument": make_instrument_section("refractive_index", incidence_deg=30)},
     "instrument.incidence_deg"),
    ({"instrument": make_instrument_section("refractive_index"), "grid": {"saturation": [0, 1]}},
     "grid"),
    ({"instrument": make_instrument_section("beam_spread", rays=10, stderr_scale=2)},
     "instrument.stderr_scale"),
    ({"instrument": make_instrument_section("goniophotometer", rays=10, stderr_scale=2)},
     "instrument.stderr_scale"),
    ({"instrument": make_instrument_section("goniophotometer", estimator="bins", stderr_scale=2)},
     "instrument.stderr_scale"),
]  # fmt: skip


@pytest.mark.parametrize(("content", "key"), UNUSED_SETTINGS)
def test_settings_without_effect_are_rejected(tmp_path, content, key):
    text = read_message(tmp_path, content)
    assert re.match(rf"{re.escape(key)} = .*: must be (left out|of one value)", text), text


MISTAKES_OF_RUNS = [
    ({"medium": {"kind": "sand"}, "instrument": {"wavelength_nm": [2500]}},
     "instrument.wavelength_nm = 2500.0: must be in"),
    ({**ROUGH, "instrument": {"kind": "lens", "radius_m": 1, "screen_depth_m": [1]}},
     "instrument.half_width_m = None: must be given"),
    ({"instrument": {"wavelength_nm": [500]}, "grid": {"saturation": [0, 0.1], "depth_m":
      [3e-4, 1]}}, "grid.depth_m = 0.0003: must be more than the largest grain"),
    ({"medium": {"kind": "sand"}, "instrument": {"kind": "lens", "radius_m": 1,
      "screen_depth_m": [1], "centre_on": "origin"}}, "medium = 'sand': must be"),
    ({"instrument": {"kind": "spectrophotometer", "solver": "discrete_ordinates",
      "estimator": "analog"}}, "instrument.solver = 'discrete_ordinates': must be"),
    ({"medium": {"depth_m": float("inf")}, "instrument": {"kind": "beam_spread",
      "wavelength_nm": [500]}}, "medium.depth_m = inf: must be finite"),
]  # fmt: skip


@pytest.mark.parametrize(("content", "message"), MISTAKES_OF_RUNS)
def test_instruments_reject_their_medium_with_the_key_of_the_file(tmp_path, content, message):
    """The job of the experiment raises the error before it traces a ray."""
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(content), "utf-8")
    experiment = load_experiment(path, MEDIA)
    with pytest.raises(InvalidValue) as error:
        run(experiment, Accuracy(max_stderr=0.5, max_rays=1), threads=1)
    assert str(error.value).startswith(message)


def test_all_invalid_files_are_reported_at_once(tmp_path):
    for name, text in (("a", "titel: x"), ("b", "title: x"), ("c", "name: b"), ("d", "[")):
        (tmp_path / f"{name}.yaml").write_text(text, "utf-8")
    with pytest.raises(ConfigError) as error:
        load_experiments(tmp_path)
    lines = str(error.value).splitlines()
    starts = (
        "a.yaml, line 1: titel: unknown", "c.yaml, line 1: name = 'b': already",
        "d.yaml, line 2: not YAML",
    )  # fmt: skip
    assert len(lines) == len(starts)
    for line, start in zip(lines, starts, strict=True):
        assert line.startswith(str(tmp_path / start))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"experiments": 5}, 'experiments = 5: must be "everything" or a list'),
        ({"seed": True}, "seed = True: must be a whole number"),
        ({"accuracies": {"standard": {"max_stderr": "low"}}},
         "accuracies.standard.max_stderr = 'low': must be in [1e-06, 0.5] (this is text, "
         "not a number)"),
        ({"accuracies": {"standard": {"max_stderr": 2}}},
         "accuracies.standard.max_stderr = 2: must be in [1e-06, 0.5]"),
    ],
)  # fmt: skip
def test_settings_of_wrong_types_are_described(change, message):
    settings = {**read_yaml(CONFIG / "config.yaml"), **change}
    with pytest.raises(ConfigError, match=f"^config/config.yaml: {re.escape(message)}"):
        load_settings(settings)


def test_settings_of_the_file_are_located(tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text("seed: 1\naccuracies:\n  standard: {max_stderr: 2}\n", "utf-8")
    content = read_yaml(path)
    message = "accuracies.standard.max_stderr = 2: must be in [1e-06, 0.5]"
    with pytest.raises(ConfigError, match=f"^{re.escape(f'{path}, line 3: {message}')}"):
        load_settings(content, str(path))
    with pytest.raises(ConfigError, match=f"^{re.escape(str(path))}: seed = -1"):
        load_settings({**content, "seed": -1, "accuracies": {}}, str(path))
