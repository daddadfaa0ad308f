"""Stacks with a rough top: particle-layer kernel, subdivision, energy balance, reciprocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chi2 import judge_z

import splits
from splits.core.validation import InvalidValue
from splits.kernels.rough_surface.realization import BOUND_SIGMA
from splits.kernels.transport.events import MAX_HEIGHT_SIGMA

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


def make_layer(fraction=1.0, surface=None, **settings):
    """Return a particle layer with a fraction of the optical thickness and of the depth."""
    settings = {**SETTINGS, **settings}
    thickness = settings.pop("optical_thickness") * fraction
    return splits.ParticleLayer(
        **settings, optical_thickness=thickness, bottom_albedo=None, depth_m=DEPTH * fraction,
        surface=surface,
    )  # fmt: skip


def measure(medium, incidence, seed, max_stderr=0.002, **settings):
    """Return R, T and A and their standard errors, shape (2, 3)."""
    ds = splits.spectrophotometer(medium, [550.0], incidence, max_stderr, seed, **settings)
    names = ("reflectance", "transmittance", "absorptance")
    return np.array([[ds[n][0] for n in names], [ds[f"{n}_stderr"][0] for n in names]])


def compute_z(one, other):
    """Return the differences of two measurements in units of their standard errors."""
    return (one[0] - other[0]) / np.hypot(one[1], other[1])


@pytest.mark.long
@pytest.mark.parametrize("incidence", [0.0, 70.0, "diffuse"])
def test_rough_layer_in_stack_equals_the_layer(incidence):
    """Stacks of one and of two sublayers agree with the independent particle-layer kernel."""
    reference = measure(make_layer(surface=WAVES), incidence, 1)
    undivided = splits.Stack([make_layer(surface=WAVES)])
    subdivided = splits.Stack([make_layer(0.6, WAVES), make_layer(0.4)])
    z = [
        compute_z(measure(undivided, incidence, 2), reference),
        compute_z(measure(subdivided, incidence, 3), reference),
    ]
    judge_z(np.concatenate(z), independent=2)


@pytest.mark.long
def test_brdf_of_stack_equals_that_of_the_layer():
    view = {"polar_deg": [15.0, 45.0, 70.0], "azimuth_deg": [0.0, 90.0, 180.0], "rays": 200_000}
    one, other = (
        splits.goniophotometer(medium, 550.0, 45.0, seed=seed, **view)
        for seed, medium in enumerate(
            (make_layer(surface=WAVES), splits.Stack([make_layer(surface=WAVES)]))
        )
    )
    error = np.hypot(one.brdf_stderr, other.brdf_stderr)
    judge_z(((one.brdf - other.brdf) / error).values.ravel(), independent=4, bound_added=True)


@pytest.mark.long
def test_waves_of_zero_height_have_no_effect():
    flat = splits.Stack([make_layer(surface={**WAVES, "rms_height_m": 0.0}), SNOW])
    assert (measure(flat, 30.0, 4) == measure(splits.Stack([make_layer(), SNOW]), 30.0, 4)).all()


@pytest.mark.parametrize("ground", [None, 1.0])
def test_energy_is_conserved_without_absorption(ground):
    transparent = splits.Snow(
        depth_m=0.003, saturation=0.2, refractive_index={"ice": 1.31, "water": 1.33}
    )
    conservative = make_layer(surface=WAVES, single_scattering_albedo=1.0)
    balance = measure(splits.Stack([conservative, transparent], ground=ground), 70.0, 5)[0]
    assert balance[:2].sum() == pytest.approx(1.0, abs=1e-12)
    assert balance[2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("incidence", [0.0, 70.0, "diffuse"])
def test_small_roughness_approaches_the_flat_surface(incidence):
    """Small slopes over wet snow, sand and a ground: all code paths of a rough top are used."""
    waves = {**WAVES, "rms_height_m": 1e-4 * WAVES["rms_height_m"]}
    thin = {"optical_thickness": 1.0}
    rough, smooth = (
        measure(
            splits.Stack([make_layer(surface=s, **thin), WET, SAND], ground=0.3),
            incidence,
            seed,
        )
        for seed, s in ((20, waves), (21, None))
    )
    judge_z(compute_z(rough, smooth), independent=1)


def test_rough_layer_of_zero_thickness_has_no_effect():
    """Rays start high above the layer and cross it into the snow in a single segment."""
    tall = {**WAVES, "rms_height_m": 0.03}
    empty = make_layer(1.0, tall, optical_thickness=0.0, refractive_index=1.0)
    # Grains that reach into the top layer are kept, so the reference keeps those above z = 0 too.
    settings = {"interpretation": {"set": "splitsnow_2021", "overlap_with_boundary": "keep"}}
    below = [splits.Snow(depth_m=0.006, **settings), splits.Sand(depth_m=0.004, **settings)]
    with_layer, without = (
        measure(splits.Stack(layers, ground=0.3), 0.0, seed)
        for seed, layers in ((32, [empty, *below]), (33, below))
    )
    judge_z(compute_z(with_layer, without), independent=1)


def test_grains_below_a_rough_layer_are_bounded_by_z_0():
    """Grains that cross z = 0 are rejected below a thinner top layer, whether rough or not."""
    waves = {**WAVES, "rms_height_m": 1e-6}
    thin = splits.ParticleLayer(
        refractive_index=1.0, optical_thickness=0.01, bottom_albedo=None, depth_m=2e-5,
        surface=waves,
    )  # fmt: skip
    plain = replace(thin, surface=None)
    coarse = splits.Snow(grain_size_um=(300, 750), saturation=0.0, depth_m=0.004)
    rough, smooth = (
        measure(splits.Stack([top, coarse]), 50.0, seed) for seed, top in ((22, thin), (23, plain))
    )
    judge_z(compute_z(rough, smooth), independent=1)


def test_ground_reflections_follow_the_adding_series():
    """R(ρ) = R + T ρ T′/(1 − ρ R′); under diffuse light in air, T′ = T by reciprocity.

    A stack with a rough top cannot be lit from below, so R′ is estimated from three ground
    albedos, which leaves two degrees of freedom for the check.
    """
    layers = [make_layer(1.0, WAVES, optical_thickness=1.0), make_layer(0.3, asymmetry=0.2)]
    measurements = [
        measure(splits.Stack(layers, ground=albedo), "diffuse", seed)
        for seed, albedo in enumerate((0.0, 0.3, 0.6, 0.9), start=7)
    ]
    (reflectance, transmittance, _), (reflectance_error, transmittance_error, _) = measurements[0]
    albedo = np.array([0.3, 0.6, 0.9])
    gain = np.array([one[0, 0] for one in measurements[1:]]) - reflectance
    error = np.hypot([one[1, 0] for one in measurements[1:]], reflectance_error)
    # R′ = 1/ρ − T²/gain; the errors of T and of the gain propagate to it.
    reflectance_below = 1.0 / albedo - transmittance**2 / gain
    slope = transmittance**2 / gain**2
    gain_error = slope * error
    weight = gain_error**-2 / (gain_error**-2).sum()
    mean = (weight * reflectance_below).sum()
    common = 2.0 * transmittance * transmittance_error / gain
    z = (reflectance_below - mean) / np.hypot(gain_error, common - (weight * common).sum())
    judge_z(z, "grounds", independent=2)
    assert 0.0 < mean < 1.0


def test_beam_spread_equals_that_of_the_layer():
    one, other = (
        splits.beam_spread(medium, [550.0], 30.0, rays=100_000, seed=seed)
        for seed, medium in (
            (30, make_layer(surface=WAVES)),
            (31, splits.Stack([make_layer(surface=WAVES)])),
        )
    )
    error = np.hypot(one.quantile_radius_stderr, other.quantile_radius_stderr)
    z = ((one.quantile_radius - other.quantile_radius) / error).values[error.values > 0.0]
    judge_z(z, "radii", independent=2)


@pytest.mark.parametrize(
    "instrument",
    [
        lambda stack: splits.irradiance_profile(stack, [550.0], [0.1]),
        lambda stack: splits.single_scattering(stack, [550.0]),
        lambda stack: splits.surface_map(stack, half_width_m=0.1),
        lambda stack: splits.goniophotometer(stack, [550.0], estimator="next_event"),
    ],
)
def test_other_instruments_reject_a_rough_top(instrument):
    with pytest.raises(InvalidValue, match="must be"):
        instrument(splits.Stack([make_layer(surface=WAVES), SNOW]))


def test_bound_of_realizations_fits_into_the_scene():
    """The smallest uniform number has 53 bits: 2⁻⁵³."""
    assert BOUND_SIGMA * np.sqrt(53.0 * np.log(2.0)) <= MAX_HEIGHT_SIGMA


def test_spectral_and_analog_estimators_agree():
    stack = splits.Stack([make_layer(surface=WAVES), SNOW, SAND], ground=0.3)
    one, other = measure(stack, 30.0, 12), measure(stack, 30.0, 13, estimator="analog")
    judge_z(compute_z(one, other), independent=1, bound_added=True)
