"""Light in wet sand, wherever its water is."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits

READINGS = ("whole_pores", "narrow_pores", "film")


def measured(reading, seed, error=0.003, **settings):
    """Return a spectrum of sand at three wavelengths."""
    sand = splits.Sand(interpretation={"water": reading}, **settings)
    return splits.spectrophotometer(sand, [600.0, 860.0, 1450.0], 40, error, seed)


@NEEDS_JIT
def test_water_that_only_absorbs_a_little_absorbs_alike_in_any_pores():
    """Of the index of air: legs are as before, and of their length as much is water."""
    z = []
    for number, saturation in enumerate((0.1, 0.5)):
        both = []
        for i, reading in enumerate(READINGS[:2]):
            found = measured(
                reading, 10 * number + i, 0.002, saturation=saturation, iron_oxide=0.0,
                refractive_index={"water": 1.0 + 3e-5j},
            )  # fmt: skip
            dry = measured(
                reading, 100 + 10 * number + i, 0.002, saturation=0.0, iron_oxide=0.0,
                refractive_index={"water": 1.0 + 3e-5j},
            )  # fmt: skip
            # It has to show: water takes a good part.
            assert float(found.reflectance[1]) < float(dry.reflectance[1]) - 0.02
            both.append(found.isel(wavelength=1))
        error = np.hypot(*(float(one.reflectance_stderr) for one in both))
        z.append(float(both[0].reflectance - both[1].reflectance) / error)
    judge_z(np.array(z), bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("reading", READINGS)
def test_nothing_is_lost_where_nothing_absorbs(reading):
    clear = {"quartz": 1.54, "kaolinite": 1.56, "water": 1.33}
    found = measured(
        reading, 5, saturation=0.2, iron_oxide=0.0, depth_m=0.003, refractive_index=clear
    )
    total = (found.reflectance + found.transmittance).values
    np.testing.assert_allclose(total, 1.0, atol=1e-6)


@NEEDS_JIT
def test_the_first_water_darkens_more_in_narrow_pores():
    dry, *wet = (measured(r, 3, saturation=s) for r, s in
                 [("whole_pores", 0.0), *((r, 0.1) for r in READINGS)])  # fmt: skip
    whole, narrow, film = (one.reflectance.values / dry.reflectance.values for one in wet)
    assert (narrow < whole - 0.05).all()
    # Light goes through a film as if it was not there, but for what that absorbs.
    assert (film[:2] > whole[:2]).all()


@NEEDS_JIT
def test_a_film_of_air_is_none():
    """A coating of the index of what surrounds it."""
    air = {"water": 1.0}
    found = [
        measured(reading, seed, saturation=0.2, refractive_index=air).isel(wavelength=1)
        for seed, reading in enumerate(("film", "whole_pores"))
    ]
    error = np.hypot(*(float(one.reflectance_stderr) for one in found))
    judge_z(np.array([float(found[0].reflectance - found[1].reflectance) / error]))
