"""Rough surfaces: refusals, sums of waves, and first crossings against dense scans."""

from __future__ import annotations

import math

import numpy as np
import pytest
import yaml
from chi2 import NEEDS_JIT, scaled, stream
from mpmath import mp
from scipy import integrate, optimize, special

from splits.media.rough_surface import LAWS, RoughSurface, SurfaceField
from splits.transport import rough_surface as kernels
from splits.transport.rough_surface import GONE, LOST
from splits.transport.wave_sums import AMPLITUDE, KX, KY, LANES, PHASE

GAUSSIAN = {"rms_height_m": 0.5, "wave_number_per_m": 1.0, "correlation": "gaussian", "waves": 16}
EXPONENTIAL = {"rms_height_m": 0.2, "wave_number_per_m": 1.0, "band_limit_per_m": 50.0}
PRINTED = {"rms_height_m": 2.0, "wave_number_per_m": 0.1, "correlation": "exponential_printed"}
TABLE = {"wave_number_per_m": [0.5, 1.0, 2.0], "density": [1.0, 2.0, 0.0]}
SPECTRUM = {"rms_height_m": 0.3, "correlation": "spectrum", "spectrum": TABLE}
SURFACES = {
    "gaussian": GAUSSIAN,
    "exponential": EXPONENTIAL,
    "printed": PRINTED,
    "spectrum": SPECTRUM,
    "two scales": [PRINTED, GAUSSIAN | {"rms_height_m": 0.05, "wave_number_per_m": 20.0}],
}

BAD = [
    ("rms_height_m", -0.1, "in [0, 1e+06] m"),
    ("rms_height_m", "1e-1", "this is text, not a number"),
    ("wave_number_per_m", 0.0, "in [1e-09, 1e+09] 1/m"),
    ("wave_number_per_m", None, "in [1e-09, 1e+09] 1/m"),
    ("correlation", "gausian", "did you mean gaussian?"),
    ("waves", 0, "a whole number from 1 to 100000"),
    ("waves", 100_001, "a whole number from 1 to 100000"),
    ("waves", 8.0, "a whole number from 1 to 100000"),
    ("waves", True, "a whole number from 1 to 100000"),
    ("band_limit_per_m", 0.0, "at least 0.001 1/m"),
    ("band_limit_per_m", float("nan"), "at least 0.001 1/m"),
    ("band_limit_per_m", None, "name the finest waves that light shall see, or infinity"),
    ("spectrum", TABLE, 'left out unless correlation is "spectrum"'),
]
BAD_TABLES = [
    (None, "spectrum = None: must be a mapping"),
    ({"wave_number_per_m": [1.0, 2.0]}, "must be a mapping"),
    (TABLE | {"density": [1.0, 2.0]}, "must be a mapping"),
    (TABLE | {"density": [1.0, "x", 2.0]}, "must be a mapping"),
    (TABLE | {"density": [1.0, -1.0, 2.0]}, "spectrum.density = .*0 or more"),
    (TABLE | {"density": [0.0, 0.0, 0.0]}, "spectrum.density = .*0 or more"),
    (TABLE | {"wave_number_per_m": [1.0, 1.0, 2.0]}, "spectrum.wave_number_per_m = .*rising"),
    ({"wave_number_per_m": [1.0], "density": [1.0]}, "two rows"),
]


def realised(surface, number=0):
    """Return waves and bounds of a realisation."""
    waves = RoughSurface.of(surface).realisation(7, number)
    bounds = np.empty(kernels.BOUNDS_SHAPE)
    low, high = kernels.set_bounds(waves, bounds)
    assert -low == high > 0.0
    return waves, bounds


def summed(waves, x, y):
    """Return the heights that a sum in plain NumPy has."""
    turns = np.multiply.outer(waves[KX], x) + np.multiply.outer(waves[KY], y)
    return np.tensordot(waves[AMPLITUDE], np.cos(2.0 * np.pi * (turns.T - waves[PHASE]).T), axes=1)


# --- what the user says -----------------------------------------------------------------------


@pytest.mark.parametrize(("key", "value", "allowed"), BAD)
def test_bad_values_are_refused_with_key_value_and_range(key, value, allowed):
    good = {"rms_height_m": 0.1, "wave_number_per_m": 1.0, "band_limit_per_m": 10.0}
    with pytest.raises(ValueError, match=f"^{key} = ") as caught:
        SurfaceField(**good | {key: value})
    assert repr(value) in str(caught.value) and allowed in str(caught.value)


@pytest.mark.parametrize(("table", "message"), BAD_TABLES)
def test_bad_spectra_are_refused(table, message):
    with pytest.raises(ValueError, match=message):
        SurfaceField(0.1, correlation="spectrum", spectrum=table)


@pytest.mark.parametrize("key", ["wave_number_per_m", "band_limit_per_m"])
def test_a_spectrum_needs_no_scale_and_no_limit(key):
    with pytest.raises(ValueError, match=rf"{key} = 1.0: must be left out"):
        SurfaceField(**SPECTRUM | {key: 1.0})


def test_refusals_say_which_field():
    with pytest.raises(ValueError, match=r"^surface\[1\]\.waves = 0"):
        RoughSurface([GAUSSIAN, GAUSSIAN | {"waves": 0}])
    with pytest.raises(ValueError, match=r"^surface\.waves = 0"):
        RoughSurface(GAUSSIAN | {"waves": 0})
    with pytest.raises(ValueError, match="did you mean rms_height_m"):
        RoughSurface({"rms_heigth_m": 1.0})
    with pytest.raises(ValueError, match=r"surface\.rms_height_m = None"):
        RoughSurface({"waves": 3})
    for bad in ("sea", 3.0, []):
        with pytest.raises(ValueError, match=r"^surface = .*one field, or a list of fields"):
            RoughSurface.of(bad)


def test_surfaces_come_from_yaml():
    text = """
    - {rms_height_m: 11.25, wave_number_per_m: 0.025, waves: 500, band_limit_per_m: .inf}
    - {rms_height_m: 0.2, wave_number_per_m: 3, correlation: gaussian}
    """
    surface = RoughSurface.of(yaml.safe_load(text))
    assert RoughSurface.of(surface) is surface
    assert surface == RoughSurface(surface.fields)
    assert surface.rms_height_m == pytest.approx(math.hypot(11.25, 0.2), rel=1e-15)
    facts = surface.describe()
    assert facts["waves"] == [500, 64]
    assert facts["band_limit_per_m"] == [math.inf, math.inf]
    assert facts["correlation"] == "exponential, gaussian"
    assert facts["rms_slope"] == math.inf
    assert RoughSurface(SPECTRUM).describe()["spectrum_density"] == TABLE["density"]
    with pytest.raises(AttributeError):
        surface.fields = ()


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("limit", [0.5, 3.0, 10.0])
def test_expectations_are_integrals_over_the_law_as_kernels_draw_it(name, limit):
    field = SurfaceField(0.3, 2.0, name, band_limit_per_m=2.0 * limit)
    numbers = RoughSurface(field).numbers()

    def drawn(u):
        return kernels.wave_number(numbers, 0, u)

    # At probability 1 the whole band is drawn.
    assert drawn(1.0) == pytest.approx(2.0 * limit, rel=1e-6)
    for r in (0.0, 0.3, 2.0):
        mean = integrate.quad(lambda u, r=r: special.j0(drawn(u) * r), 0, 1, limit=2000)[0]
        assert field.correlation_at(r) == pytest.approx(mean, abs=1e-8)
    square = integrate.quad(lambda u: drawn(u) ** 2, 0, 1, limit=2000)[0]
    assert RoughSurface(field).rms_slope() == pytest.approx(0.3 * math.sqrt(square), rel=1e-8)


@pytest.mark.parametrize("name", LAWS)
def test_a_far_limit_is_none(name):
    r = np.array([0.0, 0.1, 1.0, 3.0])
    near, far = (
        SurfaceField(1.0, 2.0, name, band_limit_per_m=limit).correlation_at(r)
        for limit in (2e5, math.inf)
    )
    # What the limit cuts off exp(−k0 r) is a share of k0/limit.
    np.testing.assert_allclose(near, far, atol=1.1e-5)


def test_the_printed_law_is_not_exponential():
    assert RoughSurface(PRINTED).correlation(10.0) == pytest.approx(0.7615975857, abs=1e-9)
    assert RoughSurface(PRINTED).rms_slope() == math.inf


def test_correlation_and_slope_of_a_spectrum():
    k = np.linspace(0.0, 14.0, 2001)
    field = SurfaceField(
        0.5, correlation="spectrum",
        spectrum={"wave_number_per_m": k, "density": np.exp(-0.25 * k * k)},
    )  # fmt: skip
    r = np.array([[0.0, 0.5], [1.0, 2.0]])
    np.testing.assert_allclose(RoughSurface(field).correlation(r), np.exp(-r * r), atol=3e-6)
    assert RoughSurface(field).rms_slope() == pytest.approx(1.0, rel=1e-4)


def test_gaps_in_a_spectrum_stay_empty():
    table = {"wave_number_per_m": [0, 1, 2, 3, 4, 5], "density": [0, 0, 1, 0, 0, 0]}
    quantiles = SurfaceField(1.0, correlation="spectrum", spectrum=table).quantiles
    assert 1.0 <= quantiles[0] < 1.01 and 2.99 < quantiles[-1] <= 3.0
    assert (np.diff(quantiles) > 0.0).all()


def test_fields_superpose():
    r = np.array([0.0, 0.1, 1.0])
    one, other = RoughSurface(PRINTED), RoughSurface(GAUSSIAN)
    both = RoughSurface([PRINTED, GAUSSIAN])
    shares = np.array([4.0, 0.25]) / 4.25
    np.testing.assert_allclose(
        both.correlation(r), shares @ [one.correlation(r), other.correlation(r)], rtol=1e-14
    )
    plane = RoughSurface(GAUSSIAN | {"rms_height_m": 0})
    assert (plane.correlation(r) == 1.0).all() and plane.rms_slope() == 0.0


# --- sums over waves --------------------------------------------------------------------------


@pytest.mark.parametrize("name", SURFACES)
def test_heights_are_sums_of_waves_and_slopes_their_derivatives(name):
    waves, _ = realised(SURFACES[name])
    assert waves.shape[1] % LANES == 0
    assert (waves[AMPLITUDE] > 0.0).sum() == sum(
        f.waves for f in RoughSurface(SURFACES[name]).fields
    )
    x, y = np.random.default_rng(1).uniform(-30.0, 30.0, (2, 200))
    height, slope_x, slope_y = kernels.heights_and_slopes(waves, x, y)
    scale = waves[AMPLITUDE].sum()
    np.testing.assert_allclose(height, summed(waves, x, y), atol=1e-13 * scale)
    step = 1e-5 / (2.0 * np.pi * np.hypot(waves[KX], waves[KY]).max())
    for slope, dx, dy in ((slope_x, step, 0.0), (slope_y, 0.0, step)):
        rise = summed(waves, x + dx, y + dy) - summed(waves, x - dx, y - dy)
        np.testing.assert_allclose(slope, rise / (2.0 * step), atol=1e-10 * scale / step)
    assert kernels.height_and_slope(waves, x[0], y[0]) == (height[0], slope_x[0], slope_y[0])


def test_arguments_up_to_a_million_are_reduced_exactly():
    # One wave of amplitude 1 along x: the argument is 2πx, of which every digit counts.
    waves = np.zeros((4, LANES))
    waves[AMPLITUDE, 0] = waves[KX, 0] = 1.0
    generator = np.random.default_rng(2)
    x = np.concatenate([
        np.linspace(-1.5, 1.5, 601), generator.uniform(-1.0, 1.0, 2000) * 1e6 / (2.0 * np.pi)
    ])  # fmt: skip
    height, slope, across = kernels.heights_and_slopes(waves, x, np.zeros_like(x))
    with mp.workdps(30):
        turned = [2 * mp.mpf(float(v)) for v in x]
        cosine = np.array([float(mp.cospi(v)) for v in turned])
        sine = np.array([float(mp.sinpi(v)) for v in turned])
    print(f"worst {abs(height - cosine).max():.1e}, {abs(slope / -2 / np.pi - sine).max():.1e}")
    np.testing.assert_allclose(height, cosine, atol=4e-15)
    np.testing.assert_allclose(slope, -2.0 * np.pi * sine, atol=3e-14)
    assert (across == 0.0).all()


@pytest.mark.parametrize("name", SURFACES)
def test_bounds_bound(name):
    for number in range(3):
        waves, bounds = realised(SURFACES[name], number)
        count = int(bounds[4, 0])
        # Coarse to fine, every wave in the first band.
        k = np.hypot(waves[KX], waves[KY])
        assert bounds[0, 0] == waves.shape[1] and (np.diff(bounds[0, :count]) < 0).all()
        for azimuth in np.linspace(0.0, 3.0, 4):
            dx, dy = 0.8 * math.cos(azimuth), 0.8 * math.sin(azimuth)
            kernels.set_leg(waves, bounds, dx, dy)
            s = np.linspace(0.0, 200.0, scaled(4000))
            t = (
                2.0
                * np.pi
                * (np.multiply.outer(waves[KX] * dx + waves[KY] * dy, s) - waves[PHASE][:, None])
            )
            q = 2.0 * np.pi * (waves[KX] * dx + waves[KY] * dy)
            a = waves[AMPLITUDE]
            for band in range(count):
                end, rest, slope, curvature = bounds[:4, band]
                end = int(end)
                assert (k[:end].max() < k[end:].max(initial=np.inf)) or end == waves.shape[1]
                assert np.abs(a[end:] @ np.cos(t[end:])).max(initial=0.0) <= rest
                assert np.abs((a * q)[:end] @ np.sin(t[:end])).max() <= slope
                assert np.abs((a * q * q)[:end] @ np.cos(t[:end])).max() <= curvature
                assert slope <= bounds[4, 2] * 0.8 * (1.0 + 1e-12)
        assert np.abs(summed(waves, s, 0.3 * s)).max() <= bounds[4, 1]


@pytest.mark.parametrize("curvature", [0.0, 1e-3, 1.0, 30.0])
@pytest.mark.parametrize("rate", [-0.9, -1e-6, 0.0, 1e-6, 0.9])
def test_a_safe_step_ends_above_what_the_bounds_allow(rate, curvature):
    slope, climb = 1.2, 0.1
    for gap in (1e-12, 1e-3, 1.0, 50.0):
        step = kernels.safe_step(gap, rate, slope, curvature, climb)
        # The lowest that the surface can be along the ray, by either bound.
        s = np.linspace(0.0, min(step, 1e6), 101)
        bent = gap + rate * s - 0.5 * curvature * s * s
        straight = gap - (slope - climb) * s
        assert (np.maximum(bent, straight) >= -1e-12 * gap).all()
        assert step >= gap / (slope - climb)
    assert kernels.safe_step(1.0, rate, 0.1, curvature, 0.2) == math.inf


# --- crossings --------------------------------------------------------------------------------


def gaps(waves, ray, side, s):
    """Return heights above the surface (below it for side −1) along a ray."""
    x, y, z, dx, dy, dz = ray
    return side * (z + s * dz - summed(waves, x + s * dx, y + s * dy))


def scanned(waves, ray, side, length, points):
    """Return the first crossing found by probing, NaN without one."""
    s = np.linspace(0.0, length, points)
    below = np.flatnonzero(gaps(waves, ray, side, s) < 0.0)
    if not below.size:
        return math.nan
    i = below[0]
    assert i > 0
    return optimize.brentq(
        lambda v: gaps(waves, ray, side, np.array([v]))[0], s[i - 1], s[i], xtol=1e-14
    )


def rays_from(generator, high, side, count):
    """Return rays from beyond the surface, in all directions towards it."""
    for _ in range(count):
        azimuth, climb = generator.uniform(0.0, 2.0 * np.pi), -generator.uniform(0.01, 1.0)
        flat = math.sqrt(1.0 - climb * climb)
        x, y = generator.uniform(-5.0, 5.0, 2)
        yield (
            x, y, 1.5 * side * high,
            flat * math.cos(azimuth), flat * math.sin(azimuth), side * climb,
        )  # fmt: skip


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("steepness", [0.1, 1.0, 5.0])
def test_crossings_of_one_wave(side, steepness):
    waves = np.zeros((4, LANES))
    waves[:, 3] = 0.7, 0.6, 0.8, 0.4
    waves[KX : KY + 1] *= steepness / (0.7 * 2.0 * np.pi)
    bounds = np.empty(kernels.BOUNDS_SHAPE)
    low, high = kernels.set_bounds(waves, bounds)
    assert high == 0.7
    for ray in rays_from(np.random.default_rng(3), high, side, 40):
        s, slope_x, slope_y = kernels.first_crossing(waves, bounds, *ray, side, low, high)
        expected = scanned(waves, ray, side, 2.5 * high / abs(ray[5]), 20_001)
        assert s == pytest.approx(expected, rel=1e-9)
        at = ray[0] + s * ray[3], ray[1] + s * ray[4]
        assert (slope_x, slope_y) == pytest.approx(kernels.height_and_slope(waves, *at)[1:])
        assert abs(gaps(waves, ray, side, np.array([s]))[0]) <= kernels.tolerance(bounds, *at, s)


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_no_crossing_is_missed(name, side):
    generator = np.random.default_rng(4)
    grazed = 0
    for number in range(scaled(6_000) // 1000):
        waves, bounds = realised(SURFACES[name], number)
        low, high = kernels.set_bounds(waves, bounds)
        for ray in rays_from(generator, high, side, 10):
            s, _, _ = kernels.first_crossing(waves, bounds, *ray, side, low, high)
            assert s > 0.0
            probed = gaps(waves, ray, side, np.linspace(0.0, s * (1.0 - 1e-9), 3001))
            tolerance = kernels.tolerance(bounds, ray[0], ray[1], 2.0 * s)
            assert probed.min() >= -tolerance
            gap = gaps(waves, ray, side, np.array([s]))[0]
            assert abs(gap) <= tolerance
            # Beyond the crossing the ray is on the other side, unless it only touched the surface.
            ahead = gaps(waves, ray, side, s + 1e-6 * s * np.arange(1, 4))
            grazed += not (ahead < 0.0).any()
    assert grazed <= 1


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rays_that_stand_on_the_surface(side):
    waves, bounds = realised(GAUSSIAN)
    low, high = kernels.set_bounds(waves, bounds)
    generator = np.random.default_rng(5)
    away = 0
    for ray in rays_from(generator, high, side, 40):
        s, slope_x, slope_y = kernels.first_crossing(waves, bounds, *ray, side, low, high)
        start = tuple(ray[i] + s * ray[i + 3] for i in range(3))
        n = side * np.array(kernels.normal_of(slope_x, slope_y))
        assert n @ ray[3:] < 0.0
        for grazing in (0.0, 1e-15, 1e-12, 1e-6, 0.5):
            d = np.cross(n, generator.normal(size=3))
            d = kernels.cleared(*(d / np.linalg.norm(d) + grazing * n), *n)
            assert np.dot(d, n) > 0.5 * kernels.GRAZING
            t, _, _ = kernels.first_crossing(waves, bounds, *start, *d, side, low, high)
            assert t == GONE or t > 0.0
            away += t == GONE
            length = t if t > 0.0 else (high - side * start[2]) / (side * d[2])
            probed = gaps(waves, (*start, *d), side, length * np.linspace(0.0, 1.0 - 1e-9, 2001))
            assert probed.min() >= -2.0 * kernels.tolerance(bounds, *start[:2], length)
    assert 20 < away < 180


def test_a_surface_without_height_is_a_plane():
    surface = RoughSurface(GAUSSIAN | {"rms_height_m": 0.0})
    state, bounds = stream(), np.empty(kernels.BOUNDS_SHAPE)
    waves = np.empty((4, kernels.columns_for(surface.numbers())))
    low, high = kernels.draw_waves(state, surface.numbers(), waves, bounds)
    assert low == high == 0.0
    for dz in (-1.0, -0.3, -1e-3):
        flat = math.sqrt(1.0 - dz * dz)
        for side in (1.0, -1.0):
            s, *slopes = kernels.first_crossing(
                waves, bounds, 1.0, 2.0, 3.0 * side, flat, 0.0, dz * side, side, low, high
            )
            assert s == pytest.approx(-3.0 / dz, rel=1e-14) and slopes == [0.0, 0.0]
            away = kernels.first_crossing(
                waves, bounds, 1.0, 2.0, 0.0, flat, 0.0, -dz * side, side, low, high
            )
            assert away == (GONE, 0.0, 0.0)
    assert kernels.normal_of(0.0, 0.0) == (0.0, 0.0, 1.0)


def test_rays_that_meet_nothing():
    waves, bounds = realised(GAUSSIAN)
    low, high = kernels.set_bounds(waves, bounds)

    def crossing(*ray, side=1.0, farthest=math.inf):
        return kernels.first_crossing(waves, bounds, *ray, side, low, high, farthest)[0]

    assert crossing(0.0, 0.0, 2.0 * high, 0.6, 0.0, 0.8) == GONE
    assert crossing(0.0, 0.0, 2.0 * high, 1.0, 0.0, 0.0) == GONE
    assert crossing(0.0, 0.0, 2.0 * low, 0.6, 0.0, -0.8, side=-1.0) == GONE
    down = 0.0, 0.0, 2.0 * high, 0.6, 0.0, -0.8
    s = crossing(*down)
    assert s > high / 0.8
    assert crossing(*down, farthest=1.001 * s) == s
    assert crossing(*down, farthest=0.999 * s) == GONE
    # Straight down and up, the height itself.
    height, _, _ = kernels.height_and_slope(waves, 3.0, 4.0)
    assert crossing(3.0, 4.0, 5.0, 0.0, 0.0, -1.0) == pytest.approx(5.0 - height, rel=1e-12)
    below = crossing(3.0, 4.0, -5.0, 0.0, 0.0, 1.0, side=-1.0)
    assert below == pytest.approx(5.0 + height, rel=1e-12)


@NEEDS_JIT
def test_a_level_ray_that_never_meets_the_surface_is_lost():
    # cos t + cos(2t + π) is nowhere above 9/8; the bound on heights is 2.
    waves = np.zeros((4, LANES))
    waves[:, 6] = 1.0, 0.1, 0.0, 0.0
    waves[:, 7] = 1.0, 0.2, 0.0, 0.5
    bounds = np.empty(kernels.BOUNDS_SHAPE)
    low, high = kernels.set_bounds(waves, bounds)
    assert high == 2.0
    level = 0.0, 0.0, 1.5, 1.0, 0.0, 0.0
    assert kernels.first_crossing(waves, bounds, *level, 1.0, low, high)[0] == LOST
    # Along its crests the same surface is level too.
    along = 0.0, 0.0, 1.5, 0.0, 1.0, 0.0
    assert kernels.first_crossing(waves, bounds, *along, 1.0, low, high)[0] == GONE


def test_realisations_are_what_a_ray_draws():
    surface = RoughSurface(SURFACES["two scales"])
    waves = surface.realisation(3, 5)
    np.testing.assert_array_equal(waves, surface.realisation(3, 5))
    assert not np.array_equal(waves, surface.realisation(3, 6))
    assert not np.array_equal(waves, surface.realisation(4, 5))
    with pytest.raises(ValueError, match="seed = -1: must be a whole number"):
        surface.realisation(-1)


@NEEDS_JIT
def test_plain_python_finds_the_same():
    for name in SURFACES:
        waves, bounds = realised(SURFACES[name])
        low, high = kernels.set_bounds(waves, bounds)
        for ray in rays_from(np.random.default_rng(6), high, 1.0, 3):
            fast = kernels.first_crossing(waves, bounds, *ray, 1.0, low, high)
            slow = kernels.first_crossing.py_func(waves, bounds, *ray, 1.0, low, high)
            assert fast == pytest.approx(slow, rel=1e-9, abs=1e-9)
