"""Steps in which weights decrease inside media: lengths and rates of the path through pores."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits.instruments.absorption_steps import (
    MAX_RATE_ERROR,
    AbsorptionSteps,
    compute_absorption_steps,
    estimate_rare_path_error,
)
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


def test_actinic_flux_is_compared_with_the_absorptance():
    rate, flux = np.array([[10.0, 10.0, 10.0, 0.0]]), np.array([[1.0, 0.0, 3.0, 2.0]])
    steps = AbsorptionSteps(0.1 * rate, 0.0 * rate, rate, 2.0 * rate)
    error = estimate_rare_path_error(steps, flux, np.array([[15.0, 15.0, 15.0, 0.0]]))
    shortest, longest = 0.75 * (1.0 - MAX_RATE_ERROR), 1.5 * (1.0 + MAX_RATE_ERROR)
    np.testing.assert_allclose(error, [[0.0, shortest, 3.0 - longest, 0.0]])
