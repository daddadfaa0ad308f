"""Random snowpacks, and media of other grains, by discrete ordinates against paths.

    SNOWPACKS=200 pytest -s tests/campaigns/test_ordinates.py

compares 200 snowpacks to an error of 0.0015 each, in about ten minutes, and as many media of point
and of finite grains.
"""

import os

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z
from test_ordinates_profile import compare_profiles
from test_ordinates_snow import FINITE, compare_media, compare_snowpacks

SNOWPACKS = os.environ.get("SNOWPACKS")
FEW = 12


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_random_snowpacks_agree_with_paths():
    number = int(SNOWPACKS or FEW)
    z = compare_snowpacks(range(1000, 1000 + number), 0.0015 if SNOWPACKS else 0.004)
    judge_z(z, "reflectance and transmittance", independent=number, bound_added=True)
    reflectance = z[:, 0][z[:, 0] != 0.0]
    print(f"rms z of reflectance {np.sqrt((reflectance**2).mean()):.2f}")


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_random_wet_snowpacks_agree_with_paths():
    """Up to half of the pores are wet; with SNOWPACKS=100, the rms z is 0.8 to 1.2."""
    number = int(SNOWPACKS or FEW)
    error = 0.001 if SNOWPACKS else 0.004
    z = compare_snowpacks(range(5000, 5000 + number), error, only_wet=True)
    judge_z(z, "reflectance and transmittance", independent=number, bound_added=True)
    rms = np.sqrt((z[:, 0] ** 2).mean())
    print(f"rms z of reflectance {rms:.2f}")
    assert rms < 1.2


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("interpretation", ["radiative_transfer", FINITE], ids=["points", "finite"])
def test_random_media_agree_with_paths(interpretation):
    number = int(SNOWPACKS or FEW)
    seeds, error = range(3000, 3000 + number), 0.0015 if SNOWPACKS else 0.004
    is_point = interpretation != FINITE
    z = compare_media(seeds, error, lambda seed: is_point and seed % 3 == 0, interpretation)
    judge_z(z, "reflectance and transmittance", independent=number, bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.skipif(SNOWPACKS is None, reason="set SNOWPACKS to a number of snowpacks")
def test_profiles_of_random_snowpacks_agree_with_paths():
    number = max(int(SNOWPACKS) // 5, 1)
    for name, values in compare_profiles(range(2000, 2000 + number), 0.003).items():
        judge_z(values, name, independent=number, bound_added=True)
