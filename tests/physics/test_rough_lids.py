"""A rough surface on top of a stack: the layer's own kernel, cuts, energy, reciprocal light."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import judge_z

import splits

WAVES = {"rms_height_m": 0.02, "wave_number_per_m": 20.0, "correlation": "gaussian", "waves": 24}
SETTINGS = {
    "optical_thickness": 3.0,
    "single_scattering_albedo": 0.97,
    "asymmetry": 0.6,
    "refractive_index": 1.33,
}
DEPTH = 0.3
SNOW = splits.Snow(depth_m=0.006, saturation=0.0)
SAND = splits.Sand(depth_m=0.004)


def lid(share=1.0, surface=None, **settings):
    """Return a part of the layer, of that share of its depth."""
    settings = {**SETTINGS, **settings}
    thickness = settings.pop("optical_thickness") * share
    return splits.Layer(
        **settings, optical_thickness=thickness, bottom_albedo=None, depth_m=DEPTH * share,
        surface=surface,
    )  # fmt: skip


def measured(medium, incidence, seed, max_stderr=0.002, **settings):
    """Return R, T and A, and their errors, shape (2, 3)."""
    ds = splits.spectrophotometer(medium, [550.0], incidence, max_stderr, seed, **settings)
    names = ("reflectance", "transmittance", "absorptance")
    return np.array([[ds[n][0] for n in names], [ds[f"{n}_stderr"][0] for n in names]])


def apart(one, other):
    """Return the differences of two measurements in units of their errors."""
    return (one[0] - other[0]) / np.hypot(one[1], other[1])


@pytest.mark.parametrize("incidence", [0.0, 70.0, "diffuse"])
def test_a_rough_layer_in_a_stack_is_that_layer(incidence):
    """Against the kernel of layers, which shares nothing of a ray's way; whole, and cut in two."""
    own = measured(lid(surface=WAVES), incidence, 1)
    whole = splits.Stack([lid(surface=WAVES)])
    cut = splits.Stack([lid(0.6, WAVES), lid(0.4)])
    z = [apart(measured(whole, incidence, 2), own), apart(measured(cut, incidence, 3), own)]
    judge_z(np.concatenate(z), independent=1, bound_added=True)


def test_its_brdf_is_that_of_the_layer():
    view = {"polar_deg": [15.0, 45.0, 70.0], "azimuth_deg": [0.0, 90.0, 180.0], "rays": 400_000}
    one, other = (
        splits.goniophotometer(medium, 550.0, 45.0, seed=seed, **view)
        for seed, medium in enumerate((lid(surface=WAVES), splits.Stack([lid(surface=WAVES)])))
    )
    error = np.hypot(one.brdf_stderr, other.brdf_stderr)
    judge_z(((one.brdf - other.brdf) / error).values.ravel(), independent=4, bound_added=True)


def test_waves_without_height_change_nothing():
    flat = splits.Stack([lid(surface={**WAVES, "rms_height_m": 0.0}), SNOW])
    assert (measured(flat, 30.0, 4) == measured(splits.Stack([lid(), SNOW]), 30.0, 4)).all()


@pytest.mark.parametrize("ground", [None, 1.0])
def test_nothing_is_lost_where_nothing_absorbs(ground):
    clear = splits.Snow(
        depth_m=0.003, saturation=0.2, refractive_index={"ice": 1.31, "water": 1.33}
    )
    white = lid(surface=WAVES, single_scattering_albedo=1.0)
    found = measured(splits.Stack([white, clear], ground=ground), 70.0, 5)[0]
    assert found[:2].sum() == pytest.approx(1.0, abs=1e-12)
    assert found[2] == pytest.approx(0.0, abs=1e-12)


def test_light_goes_to_and_fro_between_a_rough_lid_on_snow_on_sand_and_the_ground():
    """R(ρ) = R + T ρ T' / (1 − ρ R'), where T' is found from two grounds and tells two others.

    Light cannot come from below here: the rough surface is a stack's top.
    """
    pack = [lid(surface=WAVES, optical_thickness=1.0), SNOW]
    below = measured(splits.Stack([SNOW, lid(optical_thickness=1.0)]), "diffuse", 6, 0.001)
    found = {
        albedo: measured(splits.Stack(pack, ground=albedo), 40.0, seed, 0.001)
        for seed, albedo in enumerate((0.0, 0.3, 0.6, 0.9), start=7)
    }
    black = found.pop(0.0)
    # R' of the pack with a smooth surface: a few times 1e-3 off, within the differences' errors
    # only where ρ is small; so it is fitted with T T' to the three grounds, which leaves one check.
    albedo = np.array(list(found))
    gain = np.array([one[0, 0] for one in found.values()]) - black[0, 0]
    error = np.hypot([one[1, 0] for one in found.values()], black[1, 0])
    # gain (1 − ρ R') = ρ T T'  is linear in R' and T T'.
    (back, through), *_ = np.linalg.lstsq(
        np.column_stack([albedo * gain, albedo]) / error[:, np.newaxis], gain / error, rcond=None
    )
    left = gain - albedo * through / (1.0 - albedo * back)
    assert (np.abs(left) < 3.5 * error).all()
    assert back == pytest.approx(below[0, 0], abs=0.05)


def test_coin_tosses_and_weights_agree():
    stack = splits.Stack([lid(surface=WAVES), SNOW, SAND], ground=0.3)
    one, other = measured(stack, 30.0, 12), measured(stack, 30.0, 13, estimator="analog")
    judge_z(apart(one, other), independent=1, bound_added=True)
