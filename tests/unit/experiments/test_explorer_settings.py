"""Settings of the explorer in the main configuration: validation."""

from pathlib import Path

import pytest

from splits.core.validation import ConfigError
from splits.experiments import load_experiments, load_settings

EXPERIMENTS = {
    "one": """
medium: {kind: natural_snow}
instrument: {kind: table}
grid: {optical_radius_um: [100, 200], incidence_deg: [60]}
""",
    "texts": """
medium: {kind: natural_snow, depth_m: 0.1}
instrument: {kind: table, wavelength_nm: [500, 900]}
grid: {optical_radius_um: [100, 200], ground: [camborthid, open]}
""",
    "deep": """
title: A table
medium: {kind: natural_snow}
instrument: {kind: table}
grid: {optical_radius_um: [100, 200], incidence_deg: [0, 60]}
""",
    "thin": """
medium: {kind: natural_snow, depth_m: 0.1}
instrument: {kind: table, quantities: [transmittance]}
grid: {optical_radius_um: [100, 200], incidence_deg: [0, 60]}
figure: {quantity: transmittance}
""",
    "spectra": """
title: Spectra
medium: {kind: natural_snow, optical_radius_um: 100}
""",
    "where": """
title: Directions
medium: {kind: natural_snow, depth_m: 0.1}
instrument: {kind: goniophotometer, wavelength_nm: [600]}
grid: {optical_radius_um: [100, 200], incidence_deg: [0, 60]}
""",
    "elsewhere": """
title: Directions over another axis
medium: {kind: natural_snow, depth_m: 0.1, optical_radius_um: 100}
instrument: {kind: goniophotometer, wavelength_nm: [600]}
grid: {incidence_deg: [0, 60]}
""",
}


@pytest.fixture(scope="module")
def available(tmp_path_factory):
    folder = tmp_path_factory.mktemp("experiments")
    for name, text in EXPERIMENTS.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return load_experiments(folder, Path(folder / "media"))


def select_experiments(available, **settings):
    content = {"accuracies": {"standard": {"max_stderr": 0.01, "relative_stderr": 0.1}}, **settings}
    return load_settings(content).select_experiments(available)


def test_tables_and_directions_are_accepted(available):
    settings = {"explorer": {"snow": "deep"}, "explorer_directions": {"snow": "where"}}
    assert select_experiments(available, **settings) == available


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"explorer": {"snow": "spectra"}}, r"explorer.snow = 'spectra': must be a table"),
        ({"explorer": {"snow": "thin"}}, r"explorer.snow = 'thin': must be a table of reflectance"),
        ({"explorer": {"snow": "one"}}, ".*its axis incidence_deg must have at least two numbers"),
        ({"explorer": {"snow": "texts"}}, ".*its axis ground must have at least two numbers"),
        (
            {"explorer": {"snow": "deep"}, "explorer_directions": {"sand": "where"}},
            r"explorer_directions.sand = 'where': must have the name of a table",
        ),
        (
            {"explorer": {"snow": "deep"}, "explorer_directions": {"snow": "elsewhere"}},
            r"explorer_directions.snow = 'elsewhere': must be a goniophotometer over",
        ),
        (
            {"explorer": {"snow": "deep"}, "explorer_directions": {"snow": "spectra"}},
            r"explorer_directions.snow = 'spectra': must be a goniophotometer over",
        ),
    ],
)
def test_invalid_experiments_of_the_explorer_are_rejected(available, settings, message):
    with pytest.raises(ConfigError, match=f"^{message}"):
        select_experiments(available, **settings)
