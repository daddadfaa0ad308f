"""Colours of the named sands: those that their names state."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.analysis.colour import make_colour_table

WAVELENGTHS = np.arange(400.0, 781.0, 10.0)


def compute_colour(name, **keywords):
    """Return L*, chroma and hue angle (°) of a named sand."""
    sand = splits.load_medium(name, **keywords)
    dataset = splits.spectrophotometer(sand, WAVELENGTHS, max_stderr=0.005)
    colour = make_colour_table(dataset).iloc[0]
    assert colour.L_stderr < 1.0 and max(colour.a_stderr, colour.b_stderr) < 1.5
    return colour.L, np.hypot(colour.a, colour.b), np.degrees(np.arctan2(colour.b, colour.a))


@NEEDS_JIT
@pytest.mark.parametrize(
    ("name", "lightness", "chroma", "hue_deg"),
    [
        ("white_quartz", (90, 98), (0, 10), (60, 100)),
        ("yellow_dune", (65, 80), (15, 30), (70, 90)),
        ("red_dune", (45, 60), (25, 45), (45, 65)),
        ("black_magnetite", (20, 40), (0, 4), (-180, 180)),
    ],
)
def test_named_sands_have_the_colours_of_their_names(name, lightness, chroma, hue_deg):
    limits = (lightness, chroma, hue_deg)
    for value, (low, high) in zip(compute_colour(name), limits, strict=True):
        assert low <= value <= high


@NEEDS_JIT
def test_the_wet_beach_is_darker_and_browner_than_the_dry_one():
    wet, dry = compute_colour("wet_beach"), compute_colour("wet_beach", saturation=0)
    assert wet[0] < dry[0] - 8.0
    # Brown is a dark orange: the chroma relative to the lightness increases.
    assert wet[1] / wet[0] > 1.2 * dry[1] / dry[0]
