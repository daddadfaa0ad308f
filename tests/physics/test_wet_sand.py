"""Reflectance of wet sand for the three interpretations of where its water is."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits

INTERPRETATIONS = ("whole_pores", "narrow_pores", "film")


def measure(interpretation, seed, error=0.003, **settings):
    """Return a spectrum of sand at three wavelengths."""
    sand = splits.Sand(interpretation={"water": interpretation}, **settings)
    return splits.spectrophotometer(sand, [600.0, 860.0, 1450.0], 40, error, seed)


@NEEDS_JIT
def test_weakly_absorbing_water_absorbs_equally_in_all_pores():
    """Water of the index of air does not change segments, only their absorption."""
    z = []
    for number, saturation in enumerate((0.1, 0.5)):
        pair = []
        for i, interpretation in enumerate(INTERPRETATIONS[:2]):
            wet = measure(
                interpretation, 10 * number + i, 0.002, saturation=saturation, iron_oxide=0.0,
                refractive_index={"water": 1.0 + 3e-5j},
            )  # fmt: skip
            dry = measure(
                interpretation, 100 + 10 * number + i, 0.002, saturation=0.0, iron_oxide=0.0,
                refractive_index={"water": 1.0 + 3e-5j},
            )  # fmt: skip
            # The test has power only if water absorbs a significant fraction.
            assert float(wet.reflectance[1]) < float(dry.reflectance[1]) - 0.02
            pair.append(wet.isel(wavelength=1))
        error = np.hypot(*(float(one.reflectance_stderr) for one in pair))
        z.append(float(pair[0].reflectance - pair[1].reflectance) / error)
    judge_z(np.array(z), bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("interpretation", INTERPRETATIONS)
def test_energy_is_conserved_without_absorption(interpretation):
    transparent = {"quartz": 1.54, "kaolinite": 1.56, "water": 1.33}
    spectrum = measure(
        interpretation,
        5,
        saturation=0.2,
        iron_oxide=0.0,
        depth_m=0.003,
        refractive_index=transparent,
    )
    total = (spectrum.reflectance + spectrum.transmittance).values
    np.testing.assert_allclose(total, 1.0, atol=1e-6)


@NEEDS_JIT
def test_first_water_reduces_reflectance_more_in_narrow_pores():
    dry, *wet = (measure(r, 3, saturation=s) for r, s in
                 [("whole_pores", 0.0), *((r, 0.1) for r in INTERPRETATIONS)])  # fmt: skip
    whole, narrow, film = (one.reflectance.values / dry.reflectance.values for one in wet)
    assert (narrow < whole - 0.05).all()
    # A film transmits light except for its weak absorption.
    assert (film[:2] > whole[:2]).all()


@NEEDS_JIT
def test_film_of_air_has_no_effect():
    """A coating with the index of its surroundings does not change the reflectance."""
    air = {"water": 1.0}
    pair = [
        measure(interpretation, seed, saturation=0.2, refractive_index=air).isel(wavelength=1)
        for seed, interpretation in enumerate(("film", "whole_pores"))
    ]
    error = np.hypot(*(float(one.reflectance_stderr) for one in pair))
    judge_z(np.array([float(pair[0].reflectance - pair[1].reflectance) / error]))
