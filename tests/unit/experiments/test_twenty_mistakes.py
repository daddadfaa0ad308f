"""A file with 20 mistakes, corrected one after the other, and those that its schema reports."""

import pytest
from jsonschema import Draft202012Validator
from shipped import CONFIG

from splits import cli
from splits.core.validation import ConfigError
from splits.core.yaml import read_yaml
from splits.experiments import load_experiment
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.schema import make_schema
from splits.plotting.figure import FIGURES

MEDIA = CONFIG / "media"
WRONG = """name: Mine
title: 2024
captoin: BRDF
medium:
  kind: snow
  densty_kg_m3: 300
  depth_m: -0.1
  grain_size_um: [750, 300]
instrument:
  kind: goniophotometre
  wavelength_nm: 550 nm
  incidence_deg: 95
  radius_m: 3
  target: brfd
  azimuth_deg: [180, 0]
  n_bins: [18, 72]
grid:
  saturaton: [0, 0.1]
  temperature_c: []
figure:
  kind: principal_plan
  quantity: reflectance
  legend: $x^$
  ylim: [1, 0]
title: again
"""
IN_SCHEMA = "the schema reports it"
NOT_PARSED = "parsers report duplicate keys or keep one of them; a schema has the parsed content"
NO_FORMULAS = "a schema cannot typeset formulas"
NO_ORDER = "a schema cannot compare two numbers"
NO_COMPARISON = "the value is valid, but not beside that of another key"
NO_RANGE = "only the medium knows the range, which depends on several numbers"
FIGURE_KINDS = sorted(["none", *(kind for kind, one in FIGURES.items() if one.instruments)])
MISTAKES = [
    ("title: again\n", "", "line 25: not YAML ('title' given twice, in lines 2 and 25)",
     NOT_PARSED),
    ("captoin", "caption", "line 3: captoin: unknown key, must be one of name, medium, "
     "instrument, grid, group, reproduces, title, caption, figure, retrieve, "
     "retrieve_return (did you mean caption?)",
     IN_SCHEMA),
    ("Mine", "mine", "line 1: name = 'Mine': must be lower-case letters, digits and underscores, a "
     "letter first, no device such as con or nul", IN_SCHEMA),
    ("metre", "meter", "line 10: instrument.kind = 'goniophotometre': must be one of "
     "albedo, beam_spread, goniophotometer, hdrf, irradiance_profile, lens, radiation_profile, "
     "refractive_index, return_table, single_scattering, spectrophotometer, surface_map, table, "
     "time_of_flight (did you mean goniophotometer?)",
     IN_SCHEMA),
    ("550 nm", "550", "line 11: instrument.wavelength_nm = '550 nm': must be numbers in nanometres "
     "(this is text, not a number)", IN_SCHEMA),
    ("95", "45", "line 12: instrument.incidence_deg = 95: must be in [0, 89.9999] degrees",
     IN_SCHEMA),
    ("  radius_m: 3\n", "", "line 13: instrument.radius_m = 3: must be left out for "
     "goniophotometer (it belongs to lens)", IN_SCHEMA),
    ("brfd", "brdf", "line 13: instrument.target = 'brfd': must be one of brdf, btdf (did you "
     "mean brdf?)", IN_SCHEMA),
    ("[180, 0]", "[0, 180]", "line 14: instrument.azimuth_deg = [180.0, 0.0]: must be strictly "
     "increasing (numbers 1 and 2 of 2)", NO_ORDER),
    ("  n_bins: [18, 72]\n", "", "line 15: instrument.n_bins = [18, 72]: must be left out without "
     "estimator = bins", NO_COMPARISON),
    ("[]", "[-5]", "line 17: grid.temperature_c = []: must be a list of at least one value",
     IN_SCHEMA),
    ("2024", '"2024"', "line 2: title = 2024: must be text (put it into quotes)", IN_SCHEMA),
    ("plan\n", "plane\n", "line 19: figure.kind = 'principal_plan': must be one of "
     f"{', '.join(FIGURE_KINDS)} (did you mean principal_plane?)",
     IN_SCHEMA),
    ("$x^$", "$x^2$", "line 21: figure.legend = '$x^$': must be text that matplotlib can typeset "
     "(write \\$ for a dollar sign)", NO_FORMULAS),
    ("[1, 0]", "[0, 1]", "line 22: figure.ylim = [1.0, 0.0]: must be low < high", NO_ORDER),
    ("densty", "density", "line 6: medium.densty_kg_m3: unknown key, must be one of "
     "grain_size_um, facetness, sphericity, saturation, density_kg_m3, temperature_c, depth_m, "
     "refractive_index, interpretation, ground, pores, impurities_ng_g, algae_cells_ml, "
     "impurities_in, specific_surface_area_m2_kg, optical_radius_um, liquid_water_content (did "
     "you mean density_kg_m3?)", IN_SCHEMA),
    ("saturaton", "saturation", "line 16: grid.saturaton: unknown key, must be one of "
     "grain_size_um, facetness, sphericity, saturation, density_kg_m3, temperature_c, depth_m, "
     "refractive_index, interpretation, ground, pores, impurities_ng_g, algae_cells_ml, "
     "impurities_in, specific_surface_area_m2_kg, optical_radius_um, liquid_water_content, "
     "incidence_deg, medium (did you mean saturation?)", IN_SCHEMA),
    ("[750, 300]", "[300, 750]", "line 8: medium.grain_size_um = [750, 300]: must be 1 <= min <= "
     "max <= 100000 micrometres", NO_ORDER),
    ("-0.1", "0.1", "line 7: medium.depth_m = -0.1: must be in (0, 10000] m (or infinite: .inf in "
     "YAML, math.inf in Python)", IN_SCHEMA),
    ("reflectance", "brdf", "line 20: figure.quantity = 'reflectance': must be one of "
     "anisotropy_factor, brdf, brdf_dolp, btdf, reflectance_factor (did you mean "
     "reflectance_factor?)",
     NO_COMPARISON),
]  # fmt: skip
"""Wrong texts in the order of the messages, corrections, messages, and what the schema does."""


def test_each_run_reports_one_mistake(tmp_path, capsys):
    path, text = tmp_path / "mine.yaml", WRONG
    for wrong, right, message, _ in MISTAKES:
        assert text.count(wrong) == 1
        path.write_text(text, encoding="utf-8")
        assert cli.main(["run", str(path), "--output", str(tmp_path), "--media", str(MEDIA)]) == 1
        output = capsys.readouterr()
        assert output.err == f"splits: {path}, {message}\n" and not output.out
        text = text.replace(wrong, right)
    path.write_text(text, encoding="utf-8")
    assert load_experiment(path, MEDIA).name == "mine"


@pytest.mark.parametrize("number", range(len(MISTAKES)))
def test_the_schema_reports_what_it_can(tmp_path, number):
    """Each mistake is the only one of its file."""
    text = WRONG
    for other, (wrong, right, *_) in enumerate(MISTAKES):
        text = text if other == number else text.replace(wrong, right)
    path, reason = tmp_path / "mine.yaml", MISTAKES[number][-1]
    path.write_text(text, encoding="utf-8")
    if reason is NOT_PARSED:
        with pytest.raises(ConfigError, match="given twice"):
            read_yaml(path)
    else:
        schema = Draft202012Validator(make_schema(ExperimentConfig))
        assert schema.is_valid(read_yaml(path)) == (reason is not IN_SCHEMA)
