"""Rough surfaces: energy, limits, reciprocity, rough tops of stacks, and crossings of rays."""

import math
from dataclasses import replace

import numpy as np
import pytest
from chi2 import (
    NEEDS_JIT,
    compare_results,
    compute_p_of_counts,
    compute_p_of_values,
    draw_samples,
    judge_p,
    judge_z,
)
from chi2 import scale_sample_size as sample_size
from events import sample_unit_sphere
from numba import njit
from scipy import stats

import splits
from splits.core.validation import InvalidValue
from splits.instruments.lens import lens
from splits.kernels import rng
from splits.kernels.arithmetic import add_scaled, scale
from splits.kernels.interface import ComplexIndex, sample_interface
from splits.kernels.rough_surface.intersection import (
    NO_HIT,
    STEP_LIMIT_REACHED,
    compute_height_tolerance,
    compute_normal_from_slope,
    find_first_intersection,
    nudge_off_surface,
)
from splits.kernels.rough_surface.realization import (
    BOUND_SIGMA,
    allocate_realization,
    compute_height_and_slope,
    sample_realization,
)
from splits.kernels.scene import MAX_HEIGHT_SIGMA, Vector
from splits.media.rough_surface import RoughSurface

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
        optical_thickness=2.0, single_scattering_albedo=1.0, ground=1.0,
        surface=make_gaussian_surface(2.0), polarized=polarized,
    )  # fmt: skip
    ds = splits.spectrophotometer(layer, NM, incidence, max_stderr=0.5)
    assert float(ds.reflectance[0]) == pytest.approx(1.0, abs=1e-10)


def test_rough_surface_without_contrast_has_no_effect():
    plain = {"optical_thickness": 2.0, "refractive_index": 1.0, "ground": 0.0}
    rough, smooth = (
        splits.spectrophotometer(
            splits.ParticleLayer(**plain, surface=s), NM, 50.0, max_stderr=0.002, seed=seed
        )
        for seed, s in ((1, make_gaussian_surface(0.3, length_m=1e-3)), (2, None))
    )
    # The layer is 0.15 mm rough and a metre thick, which changes its reflectance by at most 1e-4.
    judge_z(compare_results(rough, smooth, "reflectance"), "without contrast")


@pytest.mark.parametrize("incidence", [0.0, 60.0])
def test_small_roughness_approaches_the_flat_surface(incidence):
    plain = {"optical_thickness": 3.0, "single_scattering_albedo": 0.9}
    rough, smooth = (
        splits.spectrophotometer(
            splits.ParticleLayer(**plain, surface=s), NM, incidence, max_stderr=0.002, seed=seed
        )
        for seed, s in ((1, make_gaussian_surface(1e-4)), (2, None))
    )
    z = compare_results(rough, smooth, "reflectance", "transmittance")
    judge_z(z, "small roughness", independent=1)


@pytest.mark.long
def test_rough_surface_is_reciprocal():
    layer = splits.ParticleLayer(
        refractive_index=1.52, optical_thickness=5.0, single_scattering_albedo=0.95,
        ground=0.0, surface=make_gaussian_surface(0.7),
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
        z.append(compare_results(forward.squeeze(drop=True), reverse.squeeze(drop=True), "brdf"))
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
        optical_thickness=10.0, single_scattering_albedo=0.0, ground=0.0,
        # With 64 waves slopes are not normal enough: λ² of each is exponential.
        surface=make_gaussian_surface(rms, waves=400),
    )  # fmt: skip
    ds = splits.goniophotometer(layer, NM, 0.0, rays=rays, estimator="bins", n_bins=(rings, 8))
    cosine = np.cos(np.radians(ds.polar_deg.values))
    # Fractions of rays in rings of equal solid angle, from the zenith.
    power = ds.brdf.isel(wavelength=0).mean("azimuth_deg").values * cosine * 2.0 * math.pi / rings
    edges = np.append(cosine + 0.5 / rings, 0.0)
    cdf = -np.expm1(-(1.0 - edges) / (1.0 + edges) / rms**2)
    judge_p({"rings": compute_p_of_counts(rays * power, np.diff(cdf) / cdf[-1])})


def test_focal_length_of_crossed_waves():
    # z = A (cos kx + cos ky): light through a small ring over a crest converges at the depth
    # n/((n − 1) A k²).
    waves = [(1.0, 0.1, 0.0, 0.0), (1.0, 0.0, 0.1, 0.0)]
    water = splits.ParticleLayer(refractive_index=1.34)
    ds = lens(
        water,
        screen_depth_m=np.arange(380.0, 410.0, 2.0),
        radius_m=0.2,
        half_width_m=5.0,
        waves=waves,
    )
    # The ring is smallest between screens, where its square is fitted by a parabola.
    size = ds.contraction.values
    near = slice(size.argmin() - 1, size.argmin() + 2)
    fit = np.polyfit(ds.screen_depth.values[near], size[near] ** 2, 2)
    assert -0.5 * fit[1] / fit[0] == pytest.approx(1.34 / (0.34 * 0.1**2), rel=0.005)
    assert float(ds.detected_fraction.min()) == 1.0


def test_sign_and_phase_of_waves_are_equivalent():
    water = splits.ParticleLayer(refractive_index=1.5)
    one, other = (
        lens(water, screen_depth_m=[5.0, 20.0, 60.0], radius_m=1.0, half_width_m=4.0, waves=[wave])
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
        **settings, optical_thickness=thickness, ground=None, depth_m=DEPTH * fraction,
        surface=surface,
    )  # fmt: skip


def measure(medium, incidence, seed, max_stderr=0.002, **settings):
    """Return R, T and A and their standard errors, shape (2, 3)."""
    ds = splits.spectrophotometer(
        medium, [550.0], incidence, max_stderr=max_stderr, seed=seed, **settings
    )
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
    judge_z(compare_results(one, other, "brdf"), independent=4, bound_added=True)


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
def test_small_roughness_of_a_top_approaches_the_flat_surface(incidence):
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
        refractive_index=1.0, optical_thickness=0.01, ground=None, depth_m=2e-5,
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
    judge_z(compare_results(one, other, "quantile_radius"), "radii", independent=2)


@pytest.mark.parametrize(
    "instrument",
    [
        lambda stack: splits.irradiance_profile(stack, [550.0], depth_m=[0.1]),
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


GAUSSIAN = {"wave_number_per_m": 1.0, "correlation": "gaussian", "waves": 16}
SEA = GAUSSIAN | {"rms_height_m": 0.1}
STEEP = GAUSSIAN | {"rms_height_m": 1.0}
FINE = {"rms_height_m": 0.1, "wave_number_per_m": 1.0, "waves": 24, "band_limit_per_m": 100.0}
PRINTED = FINE | {"correlation": "exponential_printed", "band_limit_per_m": None}
PAIR = [
    PRINTED | {"rms_height_m": 11.25, "wave_number_per_m": 0.025},
    PRINTED | {"rms_height_m": 0.2, "wave_number_per_m": 3.0},
]
# Surface, refractive index, angle of incidence, rays.
CASES = {
    "water": (SEA, 1.34, 40.0, 60_000),
    "water, grazing": (SEA, 1.34, 89.9, 30_000),
    "glass, steep": (STEEP, 1.52, 40.0, 40_000),
    "glass, steep, grazing": (STEEP, 1.52, 89.9, 15_000),
    "glass, exponential": (FINE, 1.52, 60.0, 40_000),
    "glass, unbounded slopes": (FINE | {"band_limit_per_m": math.inf}, 1.52, 20.0, 12_000),
    "water, two scales": (PAIR, 1.34, 70.0, 20_000),
    "no contrast": (STEEP, 1.0, 60.0, 40_000),
}


# --- leaks --------------------------------------------------------------------------------------


@njit
def _trace_ray(state, fields, buffer, index, mu):
    """Return hits, points on the wrong side of the surface, and whether the search gave up.

    A ray from either side is reflected or refracted at the facets that it hits until it leaves.
    """
    surface = sample_realization(state, fields, buffer)
    above, below = ComplexIndex(1.0, 0.0), ComplexIndex(index, 0.0)
    side, leaks = 1.0 if rng.uniform(state) < 0.5 else -1.0, 0
    position = Vector(0.0, 0.0, side * surface.max_height)
    d = Vector(math.sqrt(1.0 - mu * mu), 0.0, -side * mu)
    for hits in range(50):
        hit = find_first_intersection(surface, position, d, side)
        if hit.distance == STEP_LIMIT_REACHED:
            return hits, leaks, 1
        length = hit.distance
        if hit.distance == NO_HIT:
            length = (surface.max_height - side * position.z) / max(side * d.z, 1e-300)
        # Three random points of the segment, and one where a last step that is too long would show.
        for i in range(4 if length > 0.0 else 0):
            s = length * (rng.uniform(state) if i else 1.0 - 1e-9)
            point = add_scaled(s, d, position)
            height = compute_height_and_slope(surface.waves, point.x, point.y).height
            if side * (point.z - height) < -4.0 * compute_height_tolerance(surface, point, s):
                leaks += 1
        if hit.distance == NO_HIT:
            return hits, leaks, 0
        position = add_scaled(hit.distance, d, position)
        upward = compute_normal_from_slope(hit.slope)
        near, far = (above, below) if side > 0.0 else (below, above)
        sample = sample_interface(d, scale(side, upward), near, far, rng.uniform(state))
        d = nudge_off_surface(
            sample.direction, scale(-side if sample.transmitted else side, upward)
        )
        side = -side if sample.transmitted else side
    return 50, leaks, 0


@NEEDS_JIT
@pytest.mark.parametrize("name", CASES)
def test_no_ray_misses_an_intersection(name):
    surface, index, angle, rays = CASES[name]
    fields = RoughSurface.from_input(surface).make_height_fields()
    mu = math.cos(math.radians(angle))
    buffer = allocate_realization(fields)
    hits, leaks, lost = draw_samples(_trace_ray, rays, fields, buffer, index, mu, width=3).T
    print(f"{name}: {hits.sum():.0f} crossings")
    assert leaks.sum() == lost.sum() == 0
    assert hits.sum() >= 20_000
    # Every ray hits the surface at least once, except near grazing incidence.
    assert hits.min() > 0 or angle > 85.0


# --- reciprocity ------------------------------------------------------------------------------


@njit
def _trace_reverse_ray(state, fields, buffer, side):
    """Return distances to an intersection and along the reverse ray, and the normal component."""
    surface = sample_realization(state, fields, buffer)
    dx, dy, dz = sample_unit_sphere(state)
    d = Vector(dx, dy, -side * abs(dz))
    position = Vector(0.0, 0.0, side * surface.max_height * (1.0 - 2.0 * rng.uniform(state)))
    if side * (position.z - compute_height_and_slope(surface.waves, 0.0, 0.0).height) <= 0.0:
        return 0.0, 0.0, 0.0
    s, slope, _ = find_first_intersection(surface, position, d, side)
    # Visibility is mutual: the reverse ray hits nothing before the starting point.
    t = find_first_intersection(surface, add_scaled(s, d, position), scale(-1.0, d), side).distance
    normal_component = side * (d.z - slope.x * d.x - slope.y * d.y)
    return s, t, normal_component


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("name", ["water", "glass, steep", "glass, exponential"])
def test_visibility_is_mutual(name, side):
    fields = RoughSurface(CASES[name][0]).make_height_fields()
    out = draw_samples(
        _trace_reverse_ray, sample_size(50_000), fields, allocate_realization(fields), side, width=3
    )
    s, t, normal_component = out[out[:, 0] != 0.0].T
    assert s.size > 0.3 * len(out) and s.min() > 0.0
    assert normal_component.max() < 0.0
    np.testing.assert_array_less(s * (1.0 - 1e-9), np.where(t == NO_HIT, math.inf, t))
    assert (t == NO_HIT).mean() > 0.1


# --- hit statistics ---------------------------------------------------------------------------


@njit
def _sample_hit(state, fields, buffer, mu):
    """Return height and slopes where a ray from above first hits a surface."""
    surface = sample_realization(state, fields, buffer)
    d = Vector(math.sqrt(1.0 - mu * mu), 0.0, -mu)
    s, slope, _ = find_first_intersection(surface, Vector(0.0, 0.0, surface.max_height), d, 1.0)
    return surface.max_height - s * mu, slope.x, slope.y


@njit
def _sample_visibility(state, fields, buffer, mu):
    """Return the height of the surface at the origin and the part of a beam that hits it there.

    The latter is in units of the part that hits the mean plane, and 0 in shadow.
    """
    surface = sample_realization(state, fields, buffer)
    height, slope = compute_height_and_slope(surface.waves, 0.0, 0.0)
    d = Vector(-math.sqrt(1.0 - mu * mu), 0.0, mu)
    facing = 1.0 - slope.x * d.x / mu
    if facing <= 0.0:
        return height, 0.0
    s = find_first_intersection(surface, Vector(0.0, 0.0, height), d, 1.0).distance
    return height, facing if s == NO_HIT else 0.0


def sample_surface(sampler, surface, mu, count, **options):
    fields = RoughSurface(surface).make_height_fields()
    return draw_samples(
        sampler, sample_size(count), fields, allocate_realization(fields), mu, **options
    )


@NEEDS_JIT
def test_vertical_rays_sample_the_height_and_slope_distributions():
    # With many waves the slopes are normal too, with σ√(⟨λ²⟩/2) along each axis.
    height, *slopes = sample_surface(_sample_hit, STEEP | {"waves": 400}, 1.0, 10_000, width=3).T
    p = {"height": compute_p_of_values(height, stats.norm.cdf)}
    for axis, slope in zip("xy", slopes, strict=True):
        p[axis] = compute_p_of_values(slope / math.sqrt(2.0), stats.norm.cdf)
    judge_p(p)


@pytest.mark.parametrize("name", ["water", "glass, steep", "glass, exponential"])
def test_hits_are_weighted_by_projected_area(name):
    # Visible points intercept the whole beam.  Means over rays therefore equal means over surface
    # points with a free line of sight to the source, weighted by projected area.
    surface, z = CASES[name][0], []

    def compare(sample, expected, *others):
        variance = sum(part.var() / part.size for part in (sample, *others))
        z.append((sample.mean() - expected) / math.sqrt(variance))

    for i, mu in enumerate((0.9, 0.6, 0.3, 0.1)):
        hits = sample_surface(_sample_hit, surface, mu, 20_000, ray=2 * i, width=3)
        height, slope, across = hits.T
        assert (1.0 + slope * math.sqrt(1.0 - mu * mu) / mu).min() > 0.0
        point, weight = sample_surface(
            _sample_visibility, surface, mu, 20_000, ray=2 * i + 1, width=2
        ).T
        compare(weight, 1.0)
        compare(height, (weight * point).mean(), weight * point)
        compare(across, 0.0)
    judge_z(z, name, independent=4)
