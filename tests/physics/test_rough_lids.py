"""A rough surface on top of a stack: the layer's own kernel, cuts, energy, reciprocal light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chi2 import judge_z

import splits
from splits.core.validation import InvalidValue
from splits.kernels.grains.rough_top import MAX_HEIGHT_SIGMA
from splits.kernels.rough_surface.bands import BOUND_SIGMA

WAVES = {"rms_height_m": 0.02, "wave_number_per_m": 20.0, "correlation": "gaussian", "waves": 24}
SETTINGS = {
    "optical_thickness": 3.0,
    "single_scattering_albedo": 0.97,
    "asymmetry": 0.6,
    "refractive_index": 1.33,
}
DEPTH = 0.3
SNOW = splits.Snow(depth_m=0.006, saturation=0.0)
WET = splits.Snow(depth_m=0.006, saturation=0.3)
SAND = splits.Sand(depth_m=0.004, interpretation="splitsnow_2021")


def lid(share=1.0, surface=None, **settings):
    """Return a part of the layer, of that share of its depth."""
    settings = {**SETTINGS, **settings}
    thickness = settings.pop("optical_thickness") * share
    return splits.ParticleLayer(
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
    judge_z(np.concatenate(z), independent=2)


def test_its_brdf_is_that_of_the_layer():
    view = {"polar_deg": [15.0, 45.0, 70.0], "azimuth_deg": [0.0, 90.0, 180.0], "rays": 200_000}
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


@pytest.mark.parametrize("incidence", [0.0, 70.0, "diffuse"])
def test_a_flattening_surface_becomes_the_flat_one(incidence):
    """Over wet snow, sand and a ground: all that a rough surface touches, without its slopes."""
    waves = {**WAVES, "rms_height_m": 1e-4 * WAVES["rms_height_m"]}
    thin = {"optical_thickness": 1.0}
    rough, smooth = (
        measured(
            splits.Stack([lid(surface=s, **thin), WET, SAND], ground=0.3),
            incidence,
            seed,
        )
        for seed, s in ((20, waves), (21, None))
    )
    judge_z(apart(rough, smooth), independent=1)


def test_a_rough_lid_of_nothing_changes_nothing():
    """Rays fly from high above through it into the snow in one leg."""
    tall = {**WAVES, "rms_height_m": 0.03}
    nothing = lid(1.0, tall, optical_thickness=0.0, refractive_index=1.0)
    # A grain that reaches into the lid is kept, so those that reach above the snow are, too.
    kept = {"interpretation": {"set": "splitsnow_2021", "overlap_with_boundary": "keep"}}
    below = [splits.Snow(depth_m=0.006, **kept), splits.Sand(depth_m=0.004, **kept)]
    with_lid, without = (
        measured(splits.Stack(layers, ground=0.3), 0.0, seed)
        for seed, layers in ((32, [nothing, *below]), (33, below))
    )
    judge_z(apart(with_lid, without), independent=1)


def test_grains_below_a_rough_lid_do_not_reach_above_its_mean_height():
    """A lid thinner than grains: those that cross z = 0 are refused, however rough it is."""
    waves = {**WAVES, "rms_height_m": 1e-6}
    thin = splits.ParticleLayer(
        refractive_index=1.0, optical_thickness=0.01, bottom_albedo=None, depth_m=2e-5,
        surface=waves,
    )  # fmt: skip
    plain = replace(thin, surface=None)
    coarse = splits.Snow(grain_size_um=(300, 750), saturation=0.0, depth_m=0.004)
    rough, smooth = (
        measured(splits.Stack([top, coarse]), 50.0, seed) for seed, top in ((22, thin), (23, plain))
    )
    judge_z(apart(rough, smooth), independent=1)


def test_light_goes_to_and_fro_between_a_rough_stack_and_the_ground():
    """R(ρ) = R + T ρ T′/(1 − ρ R′); in diffuse light reciprocity makes T′ = T, with air around.

    Light cannot come from below here, where a rough surface is a stack's top: R′ is found from
    what three grounds add, which leaves two of these as checks.
    """
    pack = [lid(1.0, WAVES, optical_thickness=1.0), lid(0.3, asymmetry=0.2)]
    found = [
        measured(splits.Stack(pack, ground=albedo), "diffuse", seed)
        for seed, albedo in enumerate((0.0, 0.3, 0.6, 0.9), start=7)
    ]
    (dark, through, _), (dark_error, through_error, _) = found[0]
    albedo = np.array([0.3, 0.6, 0.9])
    gain = np.array([one[0, 0] for one in found[1:]]) - dark
    error = np.hypot([one[1, 0] for one in found[1:]], dark_error)
    # R′ = 1/ρ − T²/gain, and its error by those of T and of the gain.
    back = 1.0 / albedo - through**2 / gain
    slope = through**2 / gain**2
    off = slope * error
    weight = off**-2 / (off**-2).sum()
    mean = (weight * back).sum()
    common = 2.0 * through * through_error / gain
    z = (back - mean) / np.hypot(off, common - (weight * common).sum())
    judge_z(z, "grounds", independent=2)
    assert 0.0 < mean < 1.0


def test_light_leaves_as_far_from_the_entry_as_from_the_layer():
    one, other = (
        splits.beam_spread(medium, [550.0], 30.0, rays=100_000, seed=seed)
        for seed, medium in ((30, lid(surface=WAVES)), (31, splits.Stack([lid(surface=WAVES)])))
    )
    error = np.hypot(one.quantile_radius_stderr, other.quantile_radius_stderr)
    z = ((one.quantile_radius - other.quantile_radius) / error).values[error.values > 0.0]
    judge_z(z, "radii", independent=2)


@pytest.mark.parametrize(
    "instrument",
    [
        lambda stack: splits.irradiance_profile(stack, [550.0], [0.1]),
        lambda stack: splits.deep_transmittance(stack, [550.0]),
        lambda stack: splits.single_scattering(stack, [550.0]),
        lambda stack: splits.surface_map(stack, half_width_m=0.1),
        lambda stack: splits.goniophotometer(stack, [550.0], estimator="next_event"),
    ],
)
def test_other_instruments_refuse_such_a_stack(instrument):
    with pytest.raises(InvalidValue, match="must be"):
        instrument(splits.Stack([lid(surface=WAVES), SNOW]))


def test_no_realization_is_higher_than_the_scene():
    """53 bits: the least uniform number is 2⁻⁵³."""
    assert BOUND_SIGMA * np.sqrt(53.0 * np.log(2.0)) <= MAX_HEIGHT_SIGMA


def test_coin_tosses_and_weights_agree():
    stack = splits.Stack([lid(surface=WAVES), SNOW, SAND], ground=0.3)
    one, other = measured(stack, 30.0, 12), measured(stack, 30.0, 13, estimator="analog")
    judge_z(apart(one, other), independent=1, bound_added=True)
