"""Steps in which weights decrease inside media: lengths and rates of the path through pores."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits.instruments.absorption_steps import compute_absorption_steps
from splits.simulation.scene import compute_optical_constants

WAVELENGTHS = np.array([900.0, 1500.0])
MEDIA = {
    "snow": splits.Snow(depth_m=0.1),
    "wet snow": splits.Snow(depth_m=0.1, saturation=0.3),
    "natural snow": splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1),
}


@pytest.mark.parametrize("name", MEDIA)
def test_steps_are_those_of_one_segment_and_one_grain(name):
    """Of a segment between grains, the pore fraction is path; each grain absorbs on its chord."""
    medium = MEDIA[name]
    absorption = compute_optical_constants(medium, WAVELENGTHS).absorption
    steps = compute_absorption_steps(medium, absorption, np.array([0.0, 0.05, 0.1]))
    segment = medium.mean_free_path_m
    path = segment * medium.pore_fraction
    chord = medium.mean_grain_distance_m * (1.0 - medium.porosity)
    fractions = [1.0 - medium.wet_fraction, medium.wet_fraction, 1.0]
    lengths = [segment, segment, chord]
    absorbed = np.array(fractions) @ -np.expm1(-np.array(lengths)[:, np.newaxis] * absorption.T)
    np.testing.assert_allclose(steps.unscored_path_m, [path * absorbed] * 2, rtol=1e-12)
    np.testing.assert_allclose(steps.absorption_rate, [absorbed / path] * 2, rtol=1e-12)
    assert (steps.unscored_path_m < segment).all()
