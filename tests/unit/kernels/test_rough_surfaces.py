"""Rough surfaces: input, correlations, sums of waves, and first intersections of rays."""

import math

import numpy as np
import pytest
import yaml
from chi2 import NEEDS_JIT, scale_sample_size, start_random_stream
from mpmath import mp
from scipy import integrate, optimize, special

from splits.kernels.rough_surface import intersection, realization
from splits.kernels.rough_surface.intersection import NO_HIT, STEP_LIMIT_REACHED
from splits.kernels.rough_surface.realization import (
    AMPLITUDE,
    BAND_END,
    KX,
    KY,
    N_WAVE_LANES,
    PHASE,
    SurfaceSlope,
    allocate_realization,
    compute_height_and_slope,
    make_realization,
    sample_realization,
)
from splits.kernels.scene import Vector
from splits.media.rough_surface import HEIGHT_SPECTRA, RandomHeightField, RoughSurface

GAUSSIAN = {"rms_height_m": 0.5, "wave_number_per_m": 1.0, "correlation": "gaussian", "waves": 16}
EXPONENTIAL = {"rms_height_m": 0.2, "wave_number_per_m": 1.0, "band_limit_per_m": 50.0}
TABULATED = {"rms_height_m": 2.0, "wave_number_per_m": 0.1, "correlation": "exponential_printed"}
TABLE = {"wave_number_per_m": [0.5, 1.0, 2.0], "density": [1.0, 2.0, 0.0]}
SPECTRUM = {"rms_height_m": 0.3, "correlation": "spectrum", "spectrum": TABLE}
SURFACES = {
    "gaussian": GAUSSIAN,
    "exponential": EXPONENTIAL,
    "printed": TABULATED,
    "spectrum": SPECTRUM,
    "two scales": [TABULATED, GAUSSIAN | {"rms_height_m": 0.05, "wave_number_per_m": 20.0}],
}


def draw_realization(surface, index=0):
    """Return one realization of a rough surface."""
    realization = make_realization(RoughSurface.from_input(surface).sample_realization(7, index))
    assert realization.max_height > 0.0
    return realization


def sum_waves(waves, x, y):
    """Return the heights of a sum of waves, computed with NumPy."""
    phase = np.multiply.outer(waves[KX], x) + np.multiply.outer(waves[KY], y)
    return np.tensordot(waves[AMPLITUDE], np.cos(2.0 * np.pi * (phase.T - waves[PHASE]).T), axes=1)


# --- input, correlations and slopes ---------------------------------------------------------------


INVALID_SURFACES = [
    ("rms_height_m", -0.1, "in [0, 1e+06] m"),
    ("rms_height_m", "1e-1", "write 0.1, without quotes"),
    ("wave_number_per_m", 0.0, "in [1e-09, 1e+09] 1/m"),
    ("wave_number_per_m", None, "given (1/m)"),
    ("correlation", "gausian", "did you mean gaussian?"),
    ("waves", 0, "a whole number from 1 to 100000"),
    ("waves", 100_001, "a whole number from 1 to 100000"),
    ("waves", 8.0, "a whole number from 1 to 100000"),
    ("waves", True, "a whole number from 1 to 100000"),
    ("band_limit_per_m", 0.0, "at least 0.001 1/m"),
    ("band_limit_per_m", float("nan"), "at least 0.001 1/m"),
    ("band_limit_per_m", None, "give the largest wave number of the surface, or infinity"),
    ("spectrum", TABLE, 'left out unless correlation is "spectrum"'),
]
INVALID_TABLES = [
    (None, "spectrum = None: must be a mapping"),
    ({"wave_number_per_m": [1.0, 2.0]}, "must be a mapping"),
    (TABLE | {"density": [1.0, 2.0]}, "3 wave_number_per_m, 2 density"),
    (TABLE | {"density": [1.0, "x", 2.0]}, "spectrum.density = 'x': must be numbers"),
    (TABLE | {"density": [1.0, -1.0, 2.0]}, "spectrum.density = -1.0: must be at least 0"),
    (TABLE | {"density": [0.0, 0.0, 0.0]}, "spectrum.density = .*0 or more"),
    (TABLE | {"wave_number_per_m": [1.0, 1.0, 2.0]}, "spectrum.wave_number_per_m = .*increasing"),
    ({"wave_number_per_m": [1.0], "density": [1.0]}, "at least 2"),
]


@pytest.mark.parametrize(("key", "value", "allowed"), INVALID_SURFACES)
def test_invalid_values_are_rejected_with_key_and_range(key, value, allowed):
    valid = {"rms_height_m": 0.1, "wave_number_per_m": 1.0, "band_limit_per_m": 10.0}
    with pytest.raises(ValueError, match=f"^{key} = ") as error:
        RandomHeightField(**valid | {key: value})
    assert repr(value) in str(error.value) and allowed in str(error.value)


@pytest.mark.parametrize(("table", "message"), INVALID_TABLES)
def test_invalid_spectra_are_rejected(table, message):
    with pytest.raises(ValueError, match=message):
        RandomHeightField(0.1, correlation="spectrum", spectrum=table)


@pytest.mark.parametrize("key", ["wave_number_per_m", "band_limit_per_m"])
def test_spectrum_excludes_scale_and_band_limit(key):
    with pytest.raises(ValueError, match=rf"{key} = 1.0: must be left out"):
        RandomHeightField(**SPECTRUM | {key: 1.0})


def test_errors_name_the_field():
    with pytest.raises(ValueError, match=r"^surface\[1\]\.waves = 0"):
        RoughSurface([GAUSSIAN, GAUSSIAN | {"waves": 0}])
    with pytest.raises(ValueError, match=r"^surface\.waves = 0"):
        RoughSurface(GAUSSIAN | {"waves": 0})
    with pytest.raises(ValueError, match="did you mean rms_height_m"):
        RoughSurface({"rms_heigth_m": 1.0})
    with pytest.raises(ValueError, match=r"surface\.rms_height_m = None"):
        RoughSurface({"waves": 3})
    for invalid in ("sea", 3.0, []):
        with pytest.raises(ValueError, match=r"^surface = .*one field, or a list of fields"):
            RoughSurface.from_input(invalid)


def test_surfaces_are_made_from_yaml():
    text = """
    - {rms_height_m: 11.25, wave_number_per_m: 0.025, waves: 500, band_limit_per_m: .inf}
    - {rms_height_m: 0.2, wave_number_per_m: 3, correlation: gaussian}
    """
    surface = RoughSurface.from_input(yaml.safe_load(text))
    assert RoughSurface.from_input(surface) is surface
    assert surface == RoughSurface(surface.fields)
    assert surface.rms_height_m == pytest.approx(math.hypot(11.25, 0.2), rel=1e-15)
    attributes = surface.describe()
    assert attributes["waves"] == [500, 64]
    assert attributes["band_limit_per_m"] == [math.inf, math.inf]
    assert attributes["correlation"] == "exponential, gaussian"
    assert attributes["rms_slope"] == math.inf
    assert RoughSurface(SPECTRUM).describe()["spectrum_density"] == TABLE["density"]
    with pytest.raises(AttributeError):
        surface.fields = ()


@pytest.mark.parametrize("name", HEIGHT_SPECTRA)
@pytest.mark.parametrize("limit", [0.5, 3.0, 10.0])
def test_expectations_match_the_sampled_wave_numbers(name, limit):
    field = RandomHeightField(0.3, 2.0, name, band_limit_per_m=2.0 * limit)
    height_fields = RoughSurface(field).make_height_fields()

    def sample_wave_number(u):
        return realization.wave_number_quantile(height_fields, 0, u)

    # Probability 1 gives the band limit.
    assert sample_wave_number(1.0) == pytest.approx(2.0 * limit, rel=1e-6)
    for r in (0.0, 0.3, 2.0):
        mean = integrate.quad(
            lambda u, r=r: special.j0(sample_wave_number(u) * r), 0, 1, limit=2000
        )[0]
        assert field.compute_correlation(r) == pytest.approx(mean, abs=1e-8)
    square = integrate.quad(lambda u: sample_wave_number(u) ** 2, 0, 1, limit=2000)[0]
    assert RoughSurface(field).rms_slope() == pytest.approx(0.3 * math.sqrt(square), rel=1e-8)


@pytest.mark.parametrize("name", HEIGHT_SPECTRA)
def test_a_large_band_limit_equals_none(name):
    r = np.array([0.0, 0.1, 1.0, 3.0])
    limited, unlimited = (
        RandomHeightField(1.0, 2.0, name, band_limit_per_m=limit).compute_correlation(r)
        for limit in (2e5, math.inf)
    )
    # The limit truncates a fraction k0/limit of the spectrum of exp(−k0 r).
    np.testing.assert_allclose(limited, unlimited, atol=1.1e-5)


def test_printed_correlation_is_not_exponential():
    assert RoughSurface(TABULATED).correlation(10.0) == pytest.approx(0.7615975857, abs=1e-9)
    assert RoughSurface(TABULATED).rms_slope() == math.inf


def test_correlation_and_slope_of_a_gaussian_spectrum():
    k = np.linspace(0.0, 14.0, 2001)
    field = RandomHeightField(
        0.5, correlation="spectrum",
        spectrum={"wave_number_per_m": k, "density": np.exp(-0.25 * k * k)},
    )  # fmt: skip
    r = np.array([[0.0, 0.5], [1.0, 2.0]])
    np.testing.assert_allclose(RoughSurface(field).correlation(r), np.exp(-r * r), atol=3e-6)
    assert RoughSurface(field).rms_slope() == pytest.approx(1.0, rel=1e-4)


def test_zero_density_is_not_sampled():
    table = {"wave_number_per_m": [0, 1, 2, 3, 4, 5], "density": [0, 0, 1, 0, 0, 0]}
    quantiles = RandomHeightField(1.0, correlation="spectrum", spectrum=table).wave_number_quantiles
    assert 1.0 <= quantiles[0] < 1.01 and 2.99 < quantiles[-1] <= 3.0
    assert (np.diff(quantiles) > 0.0).all()


def test_fields_superpose():
    r = np.array([0.0, 0.1, 1.0])
    one, other = RoughSurface(TABULATED), RoughSurface(GAUSSIAN)
    sum_of_fields = RoughSurface([TABULATED, GAUSSIAN])
    fractions = np.array([4.0, 0.25]) / 4.25
    np.testing.assert_allclose(
        sum_of_fields.correlation(r),
        fractions @ [one.correlation(r), other.correlation(r)],
        rtol=1e-14,
    )
    plane = RoughSurface(GAUSSIAN | {"rms_height_m": 0})
    assert (plane.correlation(r) == 1.0).all() and plane.rms_slope() == 0.0


# --- sums of waves, and bounds on them ------------------------------------------------------------


@pytest.mark.parametrize("name", SURFACES)
def test_heights_and_slopes_match_wave_sums(name):
    waves = draw_realization(SURFACES[name]).waves
    assert waves.shape[1] % N_WAVE_LANES == 0
    assert (waves[AMPLITUDE] > 0.0).sum() == sum(
        f.waves for f in RoughSurface(SURFACES[name]).fields
    )
    x, y = np.random.default_rng(1).uniform(-30.0, 30.0, (2, 200))
    height, (slope_x, slope_y) = realization.compute_heights_and_slopes(waves, x, y)
    scale = waves[AMPLITUDE].sum()
    np.testing.assert_allclose(height, sum_waves(waves, x, y), atol=1e-13 * scale)
    step = 1e-5 / (2.0 * np.pi * np.hypot(waves[KX], waves[KY]).max())
    for slope, dx, dy in ((slope_x, step, 0.0), (slope_y, 0.0, step)):
        rise = sum_waves(waves, x + dx, y + dy) - sum_waves(waves, x - dx, y - dy)
        np.testing.assert_allclose(slope, rise / (2.0 * step), atol=1e-10 * scale / step)
    assert realization.compute_height_and_slope(waves, x[0], y[0]) == (
        height[0],
        (slope_x[0], slope_y[0]),
    )


def test_arguments_up_to_a_million_are_reduced_exactly():
    # One wave of amplitude 1 along x: the argument is 2πx, which needs exact argument reduction.
    waves = np.zeros((4, N_WAVE_LANES))
    waves[AMPLITUDE, 0] = waves[KX, 0] = 1.0
    generator = np.random.default_rng(2)
    x = np.concatenate([
        np.linspace(-1.5, 1.5, 601), generator.uniform(-1.0, 1.0, 2000) * 1e6 / (2.0 * np.pi)
    ])  # fmt: skip
    height, (slope, across) = realization.compute_heights_and_slopes(waves, x, np.zeros_like(x))
    with mp.workdps(30):
        half_turns = [2 * mp.mpf(float(v)) for v in x]
        cosine = np.array([float(mp.cospi(v)) for v in half_turns])
        sine = np.array([float(mp.sinpi(v)) for v in half_turns])
    print(f"errors {abs(height - cosine).max():.1e}, {abs(slope / -2 / np.pi - sine).max():.1e}")
    np.testing.assert_allclose(height, cosine, atol=4e-15)
    np.testing.assert_allclose(slope, -2.0 * np.pi * sine, atol=3e-14)
    assert (across == 0.0).all()


@pytest.mark.parametrize("name", SURFACES)
def test_bounds_hold_along_rays(name):
    for index in range(3):
        surface = draw_realization(SURFACES[name], index)
        waves, bands, n_bands = surface.waves, surface.bands, surface.n_bands
        # Bands are ordered from coarse to fine, and the first one contains all waves.
        k = np.hypot(waves[KX], waves[KY])
        ends = bands[BAND_END, :n_bands]
        assert ends[0] == waves.shape[1] and (np.diff(ends) < 0).all()
        for azimuth in np.linspace(0.0, 3.0, 4):
            dx, dy = 0.8 * math.cos(azimuth), 0.8 * math.sin(azimuth)
            intersection.set_ray_bounds(surface, Vector(dx, dy, 0.6))
            s = np.linspace(0.0, 200.0, scale_sample_size(4000))
            t = (
                2.0
                * np.pi
                * (np.multiply.outer(waves[KX] * dx + waves[KY] * dy, s) - waves[PHASE][:, None])
            )
            q = 2.0 * np.pi * (waves[KX] * dx + waves[KY] * dy)
            a = waves[AMPLITUDE]
            for band in range(n_bands):
                end, rest, slope, curvature = bands[:, band]
                end = int(end)
                assert (k[:end].max() < k[end:].max(initial=np.inf)) or end == waves.shape[1]
                assert np.abs(a[end:] @ np.cos(t[end:])).max(initial=0.0) <= rest
                assert np.abs((a * q)[:end] @ np.sin(t[:end])).max() <= slope
                assert np.abs((a * q * q)[:end] @ np.cos(t[:end])).max() <= curvature
                assert slope <= surface.max_slope * 0.8 * (1.0 + 1e-12)
        assert np.abs(sum_waves(waves, s, 0.3 * s)).max() <= surface.max_height


@pytest.mark.parametrize("curvature", [0.0, 1e-3, 1.0, 30.0])
@pytest.mark.parametrize("rate", [-0.9, -1e-6, 0.0, 1e-6, 0.9])
def test_safe_steps_stay_above_the_bounds(rate, curvature):
    slope, climb = 1.2, 0.1
    for gap in (1e-12, 1e-3, 1.0, 50.0):
        step = intersection.compute_safe_step(gap, rate, slope, curvature, climb)
        # The smallest possible gap along the ray, by either bound.
        s = np.linspace(0.0, min(step, 1e6), 101)
        parabolic = gap + rate * s - 0.5 * curvature * s * s
        linear = gap - (slope - climb) * s
        assert (np.maximum(parabolic, linear) >= -1e-12 * gap).all()
        assert step >= gap / (slope - climb)
    assert intersection.compute_safe_step(1.0, rate, 0.1, curvature, 0.2) == math.inf


def test_realizations_are_determined_by_the_seed():
    surface = RoughSurface(SURFACES["two scales"])
    waves = surface.sample_realization(3, 5)
    np.testing.assert_array_equal(waves, surface.sample_realization(3, 5))
    assert not np.array_equal(waves, surface.sample_realization(3, 6))
    assert not np.array_equal(waves, surface.sample_realization(4, 5))
    with pytest.raises(ValueError, match="seed = -1: must be a whole number"):
        surface.sample_realization(-1)


# --- intersections, against dense scans and exact cases -------------------------------------------


def find_intersection(surface, ray, side, max_distance=math.inf):
    """Return the `Hit` of a ray (x, y, z, dx, dy, dz)."""
    ray = [float(x) for x in ray]
    return intersection.find_first_intersection(
        surface, Vector(*ray[:3]), Vector(*ray[3:]), side, max_distance
    )


def compute_tolerance(surface, x, y, s):
    return intersection.compute_height_tolerance(surface, Vector(x, y, 0.0), s)


def compute_gaps(waves, ray, side, s):
    """Return heights above the surface (below it for side −1) along a ray."""
    x, y, z, dx, dy, dz = ray
    return side * (z + s * dz - sum_waves(waves, x + s * dx, y + s * dy))


def scan_for_intersection(waves, ray, side, length, points):
    """Return the distance of the first intersection on a dense grid, NaN without one."""
    s = np.linspace(0.0, length, points)
    below = np.flatnonzero(compute_gaps(waves, ray, side, s) < 0.0)
    if not below.size:
        return math.nan
    i = below[0]
    assert i > 0
    return optimize.brentq(
        lambda v: compute_gaps(waves, ray, side, np.array([v]))[0], s[i - 1], s[i], xtol=1e-14
    )


def draw_rays(generator, max_height, side, n_rays):
    """Return rays that start outside the surface and travel towards it."""
    for _ in range(n_rays):
        azimuth, dz = generator.uniform(0.0, 2.0 * np.pi), -generator.uniform(0.01, 1.0)
        horizontal = math.sqrt(1.0 - dz * dz)
        x, y = generator.uniform(-5.0, 5.0, 2)
        yield (
            x, y, 1.5 * side * max_height,
            horizontal * math.cos(azimuth), horizontal * math.sin(azimuth), side * dz,
        )  # fmt: skip


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("steepness", [0.1, 1.0, 5.0])
def test_intersections_with_one_wave_match_a_scan(side, steepness):
    waves = np.zeros((4, N_WAVE_LANES))
    waves[:, 3] = 0.7, 0.6, 0.8, 0.4
    waves[KX : KY + 1] *= steepness / (0.7 * 2.0 * np.pi)
    surface = make_realization(waves)
    max_height = surface.max_height
    assert max_height == 0.7
    for ray in draw_rays(np.random.default_rng(3), max_height, side, 40):
        s, slope, _ = find_intersection(surface, ray, side)
        expected = scan_for_intersection(waves, ray, side, 2.5 * max_height / abs(ray[5]), 20_001)
        assert s == pytest.approx(expected, rel=1e-9)
        position = ray[0] + s * ray[3], ray[1] + s * ray[4]
        assert slope == pytest.approx(compute_height_and_slope(waves, *position).slope)
        assert abs(compute_gaps(waves, ray, side, np.array([s]))[0]) <= compute_tolerance(
            surface, *position, s
        )


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_no_intersection_is_missed(name, side):
    generator = np.random.default_rng(4)
    n_grazing = 0
    for number in range(scale_sample_size(6_000) // 1000):
        surface = draw_realization(SURFACES[name], number)
        waves = surface.waves
        for ray in draw_rays(generator, surface.max_height, side, 10):
            s = find_intersection(surface, ray, side).distance
            assert s > 0.0
            gaps = compute_gaps(waves, ray, side, np.linspace(0.0, s * (1.0 - 1e-9), 3001))
            allowed = compute_tolerance(surface, ray[0], ray[1], 2.0 * s)
            assert gaps.min() >= -allowed
            gap = compute_gaps(waves, ray, side, np.array([s]))[0]
            assert abs(gap) <= allowed
            # After the intersection the ray is on the other side, except for grazing rays.
            gaps_after = compute_gaps(waves, ray, side, s + 1e-6 * s * np.arange(1, 4))
            n_grazing += not (gaps_after < 0.0).any()
    assert n_grazing <= 1


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rays_that_start_on_the_surface(side):
    surface = draw_realization(GAUSSIAN)
    waves, max_height = surface.waves, surface.max_height
    generator = np.random.default_rng(5)
    n_escaped = 0
    for ray in draw_rays(generator, max_height, side, 40):
        s, slope, _ = find_intersection(surface, ray, side)
        start = tuple(ray[i] + s * ray[i + 3] for i in range(3))
        n = side * np.array(intersection.compute_normal_from_slope(slope))
        assert n @ ray[3:] < 0.0
        for grazing in (0.0, 1e-15, 1e-12, 1e-6, 0.5):
            d = np.cross(n, generator.normal(size=3))
            d = intersection.nudge_off_surface(
                Vector(*(d / np.linalg.norm(d) + grazing * n)), Vector(*n)
            )
            assert np.dot(d, n) > 0.5 * intersection.MIN_COS_EXIT
            t = find_intersection(surface, (*start, *d), side).distance
            assert t == NO_HIT or t > 0.0
            n_escaped += t == NO_HIT
            length = t if t > 0.0 else (max_height - side * start[2]) / (side * d[2])
            gaps = compute_gaps(
                waves, (*start, *d), side, length * np.linspace(0.0, 1.0 - 1e-9, 2001)
            )
            assert gaps.min() >= -2.0 * compute_tolerance(surface, *start[:2], length)
    assert 20 < n_escaped < 180


def test_zero_height_gives_a_plane():
    fields = RoughSurface(GAUSSIAN | {"rms_height_m": 0.0}).make_height_fields()
    surface = sample_realization(start_random_stream(), fields, allocate_realization(fields))
    assert surface.max_height == 0.0
    for dz in (-1.0, -0.3, -1e-3):
        dx = math.sqrt(1.0 - dz * dz)
        for side in (1.0, -1.0):
            s, slope, _ = find_intersection(
                surface, (1.0, 2.0, 3.0 * side, dx, 0.0, dz * side), side
            )
            assert s == pytest.approx(-3.0 / dz, rel=1e-14) and slope == (0.0, 0.0)
            upward = find_intersection(surface, (1.0, 2.0, 0.0, dx, 0.0, -dz * side), side)
            assert upward[:2] == (NO_HIT, (0.0, 0.0))
    assert intersection.compute_normal_from_slope(SurfaceSlope(0.0, 0.0)) == (0.0, 0.0, 1.0)


def test_rays_without_intersection():
    surface = draw_realization(GAUSSIAN)
    max_height = surface.max_height

    def find_distance(*ray, side=1.0, max_distance=math.inf):
        return find_intersection(surface, ray, side, max_distance).distance

    assert find_distance(0.0, 0.0, 2.0 * max_height, 0.6, 0.0, 0.8) == NO_HIT
    assert find_distance(0.0, 0.0, 2.0 * max_height, 1.0, 0.0, 0.0) == NO_HIT
    assert find_distance(0.0, 0.0, -2.0 * max_height, 0.6, 0.0, -0.8, side=-1.0) == NO_HIT
    downward = 0.0, 0.0, 2.0 * max_height, 0.6, 0.0, -0.8
    s = find_distance(*downward)
    assert s > max_height / 0.8
    assert find_distance(*downward, max_distance=1.001 * s) == s
    assert find_distance(*downward, max_distance=0.999 * s) == NO_HIT
    # Vertical rays hit the surface at its height.
    height = compute_height_and_slope(surface.waves, 3.0, 4.0).height
    assert find_distance(3.0, 4.0, 5.0, 0.0, 0.0, -1.0) == pytest.approx(5.0 - height, rel=1e-12)
    from_below = find_distance(3.0, 4.0, -5.0, 0.0, 0.0, 1.0, side=-1.0)
    assert from_below == pytest.approx(5.0 + height, rel=1e-12)


@pytest.mark.long
@NEEDS_JIT
def test_horizontal_ray_without_intersection_is_lost():
    # cos t + cos(2t + π) is nowhere above 9/8; the bound on heights is 2.
    waves = np.zeros((4, N_WAVE_LANES))
    waves[:, 6] = 1.0, 0.1, 0.0, 0.0
    waves[:, 7] = 1.0, 0.2, 0.0, 0.5
    surface = make_realization(waves)
    assert surface.max_height == 2.0
    horizontal = 0.0, 0.0, 1.5, 1.0, 0.0, 0.0
    assert find_intersection(surface, horizontal, 1.0).distance == STEP_LIMIT_REACHED
    # Along its crests the same surface is horizontal too.
    along_crests = 0.0, 0.0, 1.5, 0.0, 1.0, 0.0
    assert find_intersection(surface, along_crests, 1.0).distance == NO_HIT


@NEEDS_JIT
def test_compiled_and_interpreted_intersections_agree():
    for name in SURFACES:
        surface = draw_realization(SURFACES[name])
        for ray in draw_rays(np.random.default_rng(6), surface.max_height, 1.0, 3):
            arguments = surface, Vector(*ray[:3]), Vector(*ray[3:]), 1.0
            compiled = intersection.find_first_intersection(*arguments)
            interpreted = intersection.find_first_intersection.py_func(*arguments)
            assert compiled.distance == pytest.approx(interpreted.distance, rel=1e-9, abs=1e-9)
            assert compiled.slope == pytest.approx(interpreted.slope, rel=1e-9, abs=1e-9)
