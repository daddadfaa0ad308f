"""The documented table of instruments that accept an infinite depth is that of the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from chi2 import NEEDS_JIT

import splits
from splits.core.validation import InvalidValue

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "snow.md"
SKY = splits.sky("summit_greenland")
SNOW = splits.Snow.natural(specific_surface_area_m2_kg=20)
VIEW = {"polar_deg": [0.0], "azimuth_deg": [0.0], "relative_stderr": 0.3}
CALLS = {
    "spectrophotometer": lambda **k: splits.spectrophotometer(SNOW, [1300], 0.0, 0.1, **k),
    "albedo": lambda **k: splits.albedo(SNOW, SKY, [1300, 1400], max_stderr=0.1, **k),
    "irradiance_profile": lambda **k: splits.irradiance_profile(
        SNOW, [1300], [0.01], max_stderr=0.1, **k
    ),
    "radiation_profile": lambda **k: splits.radiation_profile(
        SNOW, SKY, [0.01], [1300, 1400], max_stderr=0.1, total_w_m2=100.0, **k
    ),
    "time_of_flight": lambda: splits.time_of_flight(SNOW, [1300], rays=100),
    "single_scattering": lambda: splits.single_scattering(SNOW, [1300], rays=1000),
    "goniophotometer": lambda **k: splits.goniophotometer(SNOW, [1300], **VIEW, **k),
    "hdrf": lambda **k: splits.hdrf(SNOW, SKY, [1300], **VIEW, **k),
    "beam_spread": lambda: splits.beam_spread(SNOW, [1300], rays=100),
}
WITHOUT_SOLVER = ("time_of_flight", "single_scattering", "beam_spread")


def read_table():
    """Return the documented statement by instrument."""
    table = re.search(r"\| function \| infinite depth \|\n.*?\n\n", PAGE.read_text("utf-8"), re.S)[
        0
    ]
    rows = [row.split("|")[1:3] for row in table.splitlines()[2:] if row]
    return {name: text.strip() for names, text in rows for name in re.findall(r"`(\w+)`", names)}


def accepts(instrument, **keywords):
    try:
        CALLS[instrument](**keywords)
    except InvalidValue as error:
        assert str(error).startswith("depth_m = inf: must be finite")
        return False
    return True


@NEEDS_JIT
@pytest.mark.parametrize("instrument", CALLS)
def test_table_of_infinite_depths_is_that_of_the_code(instrument):
    expected = read_table()[instrument]
    assert accepts(instrument) == (expected != "no")
    if instrument not in WITHOUT_SOLVER:
        assert accepts(instrument, solver="monte_carlo") == (expected == "yes")


def test_table_has_all_instruments():
    assert set(read_table()) == set(CALLS)
    tables = {"build_table", "build_return_table", "lens", "surface_map"}
    names = {name for name in splits.__all__ if hasattr(getattr(splits, name), "__module__")}
    public = {n for n in names if getattr(splits, n).__module__.startswith("splits.instruments")}
    assert public - tables <= set(CALLS)
