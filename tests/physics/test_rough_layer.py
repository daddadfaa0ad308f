"""Particle layers with rough surfaces: energy, limits, reciprocity, geometric optics, lens."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import compute_p_of_counts, judge_p, judge_z

import splits
from splits.instruments.rough_surfaces import lens

NM = [550.0]


def make_gaussian_surface(slope: float, length_m: float = 0.05, waves: int = 16) -> dict:
    """Return a surface of Gaussian correlation with a given rms slope."""
    return {
        "rms_height_m": 0.5 * slope * length_m,
        "wave_number_per_m": 1.0 / length_m,
        "waves": waves,
        "correlation": "gaussian",
    }


@pytest.mark.parametrize("polarized", [False, True])
@pytest.mark.parametrize("incidence", [0.0, 60.0, 89.9])
def test_rough_surface_conserves_energy(incidence, polarized):
    layer = splits.ParticleLayer(
        optical_thickness=2.0, single_scattering_albedo=1.0, bottom_albedo=1.0,
        surface=make_gaussian_surface(2.0), polarized=polarized,
    )  # fmt: skip
    ds = splits.spectrophotometer(layer, NM, incidence, 0.5)
    assert float(ds.reflectance[0]) == pytest.approx(1.0, abs=1e-10)


def test_rough_surface_without_contrast_has_no_effect():
    plain = {"optical_thickness": 2.0, "refractive_index": 1.0, "bottom_albedo": 0.0}
    rough, smooth = (
        splits.spectrophotometer(splits.ParticleLayer(**plain, surface=s), NM, 50.0, 0.002, seed)
        for seed, s in ((1, make_gaussian_surface(0.3, length_m=1e-3)), (2, None))
    )
    difference = float(rough.reflectance[0] - smooth.reflectance[0])
    stderr = math.hypot(float(rough.reflectance_stderr[0]), float(smooth.reflectance_stderr[0]))
    # The layer is 0.15 mm rough and a metre thick, which changes its reflectance by at most 1e-4.
    judge_z([difference / stderr], "without contrast")


@pytest.mark.parametrize("incidence", [0.0, 60.0])
def test_small_roughness_approaches_the_flat_surface(incidence):
    plain = {"optical_thickness": 3.0, "single_scattering_albedo": 0.9}
    rough, smooth = (
        splits.spectrophotometer(
            splits.ParticleLayer(**plain, surface=s), NM, incidence, 0.002, seed
        )
        for seed, s in ((1, make_gaussian_surface(1e-4)), (2, None))
    )
    z = []
    for name in ("reflectance", "transmittance"):
        difference = float(rough[name][0] - smooth[name][0])
        stderr = math.hypot(float(rough[f"{name}_stderr"][0]), float(smooth[f"{name}_stderr"][0]))
        z.append(difference / stderr)
    judge_z(z, "small roughness", independent=1)


@pytest.mark.long
def test_rough_surface_is_reciprocal():
    layer = splits.ParticleLayer(
        refractive_index=1.52, optical_thickness=5.0, single_scattering_albedo=0.95,
        bottom_albedo=0.0, surface=make_gaussian_surface(0.7),
    )  # fmt: skip
    z = []
    pairs = ((0.0, 45.0, 0.0), (20.0, 60.0, 180.0))
    # Two comparisons would not detect errors that are too large.
    for number, (one, other, azimuth) in enumerate(3 * pairs):
        forward, reverse = (
            splits.goniophotometer(
                layer, NM, a, seed=10 * number + seed, polar_deg=[b], azimuth_deg=[azimuth],
                relative_stderr=0.03,
            )
            for seed, (a, b) in enumerate(((one, other), (other, one)))
        )  # fmt: skip
        difference = forward.brdf.item() - reverse.brdf.item()
        z.append(difference / math.hypot(forward.brdf_stderr.item(), reverse.brdf_stderr.item()))
    judge_z(z, "reciprocity of a rough surface")
    assert np.abs(z).max() < 3.0


def test_small_slopes_reflect_by_geometric_optics():
    # Geometric optics of small slopes: a facet of slope s reflects light from the zenith to the
    # polar angle θ = 2 atan s, cos θ = (1 − s²)/(1 + s²), and of Gaussian slopes of rms r the
    # fraction exp(−s²/r²) is steeper than s.
    # An interface of index 3 reflects a quarter of all rays at any small angle: these 17 000 detect
    # an rms slope that is 3 % off (in 200 rings that adds 60 to a χ² of 200 ± 20).
    rms, rays, rings = 0.1, 68_000, 200
    layer = splits.ParticleLayer(
        refractive_index=3.0,
        optical_thickness=10.0, single_scattering_albedo=0.0, bottom_albedo=0.0,
        # With 64 waves slopes are not normal enough: λ² of each is exponential.
        surface=make_gaussian_surface(rms, waves=400),
    )  # fmt: skip
    ds = splits.goniophotometer(layer, NM, 0.0, rays=rays, estimator="bins", n_bins=(rings, 8))
    cosine = np.cos(np.radians(ds.polar.values))
    # Fractions of rays in rings of equal solid angle, from the zenith.
    power = ds.brdf.isel(wavelength=0).mean("azimuth").values * cosine * 2.0 * math.pi / rings
    edges = np.append(cosine + 0.5 / rings, 0.0)
    cdf = -np.expm1(-(1.0 - edges) / (1.0 + edges) / rms**2)
    judge_p({"rings": compute_p_of_counts(rays * power, np.diff(cdf) / cdf[-1])})


def test_focal_length_of_crossed_waves():
    # z = A (cos kx + cos ky): light through a small ring over a crest converges at the depth
    # n/((n − 1) A k²).
    waves = [(1.0, 0.1, 0.0, 0.0), (1.0, 0.0, 0.1, 0.0)]
    water = splits.ParticleLayer(refractive_index=1.34)
    ds = lens(water, np.arange(380.0, 410.0, 2.0), 0.2, half_width_m=5.0, waves=waves)
    # The ring is smallest between screens, where its square is fitted by a parabola.
    size = ds.contraction.values
    near = slice(size.argmin() - 1, size.argmin() + 2)
    fit = np.polyfit(ds.screen_depth.values[near], size[near] ** 2, 2)
    assert -0.5 * fit[1] / fit[0] == pytest.approx(1.34 / (0.34 * 0.1**2), rel=0.005)
    assert float(ds.detected_fraction.min()) == 1.0


def test_sign_and_phase_of_waves_are_equivalent():
    water = splits.ParticleLayer(refractive_index=1.5)
    one, other = (
        lens(water, [5.0, 20.0, 60.0], 1.0, half_width_m=4.0, waves=[wave])
        for wave in ((3.0, 0.5, 0.0, 0.0), (-3.0, 0.5, 0.0, math.pi))
    )
    assert np.array_equal(one.detected_fraction, other.detected_fraction)
    assert one.contraction.values == pytest.approx(other.contraction.values, rel=1e-9)


def test_beam_through_a_rough_surface_enters_at_the_origin():
    layer = splits.ParticleLayer(
        optical_thickness=math.inf, single_scattering_albedo=0.9, refractive_index=1.3,
        depth_m=1e-3, surface=make_gaussian_surface(0.2, length_m=0.1),
    )  # fmt: skip
    smooth = splits.ParticleLayer(
        optical_thickness=math.inf, single_scattering_albedo=0.9, refractive_index=1.3,
        depth_m=1e-3,
    )  # fmt: skip
    rough, plain = (
        splits.beam_spread(m, NM, 60.0, rays=20_000, half_width_m=0.05) for m in (layer, smooth)
    )
    centroids = []
    for ds in (rough, plain):
        profile_map = ds.profile_map.sel(side="reflected").isel(wavelength=0)
        centroids.append(float((profile_map * profile_map.x).sum() / profile_map.sum()))
    # Heights of 1 cm rms shift entry points by up to that times tan 60°, in both directions.
    assert abs(centroids[0] - centroids[1]) < 0.01


def test_depth_of_an_infinite_layer_includes_its_surface():
    layer = splits.ParticleLayer(
        optical_thickness=math.inf, single_scattering_albedo=1.0, asymmetry=0.0, depth_m=0.02,
        surface={"rms_height_m": 1.0, "wave_number_per_m": 1.0, "correlation": "gaussian"},
    )  # fmt: skip
    assert layer.scene_bottom.depth_m > 8.0
