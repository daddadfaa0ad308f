"""Statistics of rough surfaces: heights, correlation, wave numbers, slopes, sampled facets."""

import math

import numpy as np
import pytest
from chi2 import (
    NEEDS_JIT,
    SEED,
    compute_p_of_counts,
    compute_p_of_values,
    draw_samples,
    judge_p,
    judge_z,
    scale_sample_size,
    uniform_cdf,
)
from events import compute_facet_normal, sample_facet, sample_unit_sphere
from numba import njit
from scipy import stats

from splits.kernels import rng
from splits.kernels.arithmetic import dot
from splits.kernels.rough_surface import realization as kernels
from splits.kernels.rough_surface.realization import AMPLITUDE, KX, KY, PHASE
from splits.kernels.scene import ANY_FACETS, PROJECTED_FACETS, UNWEIGHTED_FACETS, UP, Vector
from splits.media.rough_surface import RoughSurface

N_REALIZATIONS = scale_sample_size(60_000)
K0, SIGMA = 2.0, 0.3
K = np.linspace(0.0, 8.0, 17)
TABLE = {"wave_number_per_m": K, "density": np.exp(-K) * (1.0 + np.sin(K) ** 2)}
BASE = {"rms_height_m": SIGMA, "wave_number_per_m": K0, "waves": 12}
PRINTED = BASE | {"correlation": "exponential_printed"}
SPECTRA = {
    "exponential, limit": BASE | {"band_limit_per_m": 5.0 * K0},
    "exponential, no limit": BASE | {"band_limit_per_m": math.inf},
    "printed": PRINTED,
    "printed, limit": PRINTED | {"band_limit_per_m": 2.0 * K0},
    "gaussian": BASE | {"correlation": "gaussian"},
    "gaussian, limit": BASE | {"correlation": "gaussian", "band_limit_per_m": K0},
    "spectrum": {
        "rms_height_m": SIGMA, "correlation": "spectrum", "spectrum": TABLE, "waves": 12,
    },
    "one wave": PRINTED | {"waves": 1},
    "two fields": [PRINTED, BASE | {"correlation": "gaussian", "waves": 5}],
}  # fmt: skip
LAGS = np.array([0.2, 0.5, 1.0, 2.0, 4.0]) / K0


@njit
def _evaluate_heights(seed, ensemble, fields, x, y, heights):
    state = np.zeros(1, dtype=np.uint64)
    buffer = kernels.allocate_realization(fields)
    for i in range(heights.shape[0]):
        rng.start_stream(state, seed, ensemble, i)
        waves = kernels.sample_realization(state, fields, buffer).waves
        for j in range(x.size):
            heights[i, j] = kernels.compute_height_and_slope(waves, x[j], y[j]).height


def sample_heights(name, x, y):
    """Return heights at points in units of σ, one row per realization."""
    surface = RoughSurface.from_input(SPECTRA[name])
    heights = np.empty((N_REALIZATIONS, len(x)))
    ensemble = list(SPECTRA).index(name)
    _evaluate_heights(
        SEED, ensemble, surface.make_height_fields(), np.asarray(x), np.asarray(y), heights
    )
    return heights / surface.rms_height_m


@pytest.mark.parametrize("name", SPECTRA)
def test_heights_have_the_given_correlation(name):
    surface = RoughSurface.from_input(SPECTRA[name])
    # Points away from the origin reveal wrong phases or directions; five lags in each direction.
    x = 3.0 + np.concatenate([[0.0], LAGS, 0.0 * LAGS])
    y = -7.0 + np.concatenate([[0.0], 0.0 * LAGS, LAGS])
    h = sample_heights(name, x, y)
    products = h[:, :1] * h
    expected = surface.correlation(np.concatenate([[0.0], LAGS, LAGS]))
    assert expected[0] == pytest.approx(1.0, abs=1e-12)
    error = products.std(axis=0) / math.sqrt(len(h))
    z = np.append((products.mean(axis=0) - expected) / error, h[:, 0].mean() * math.sqrt(len(h)))
    # All points use the same realizations.
    judge_z(z, name, independent=1)


def test_heights_are_normal_for_any_number_of_waves():
    p = {}
    for name in SPECTRA:
        p[name] = compute_p_of_values(sample_heights(name, [11.0], [2.0])[:, 0], stats.norm.cdf)
    judge_p(p)


def compute_spectrum_cdf(name):
    """Return the cumulative distribution of wave numbers from the density of the correlation."""
    field = RoughSurface.from_input(SPECTRA[name]).fields[0]
    if field.correlation == "spectrum":
        k = np.linspace(K[0], K[-1], 160_001)
        mass = np.interp(k, K, TABLE["density"]) * k
        total = np.concatenate([[0.0], np.cumsum(0.5 * (mass[1:] + mass[:-1]))])
        return lambda x: np.interp(x, k, total / total[-1])
    cdf = {
        "exponential": lambda k: 1.0 - 1.0 / np.sqrt(1.0 + k * k),
        "exponential_printed": lambda k: 1.0 / np.sqrt(1.0 + 1.0 / (k * k)),
        "gaussian": lambda k: 1.0 - np.exp(-0.25 * k * k),
    }[field.correlation]
    return lambda x: cdf(x / K0) / cdf(field.band_limit_per_m / K0)


@pytest.mark.parametrize("name", [name for name in SPECTRA if name != "two fields"])
def test_waves_follow_their_distributions(name):
    count = scale_sample_size(100_000)
    settings = SPECTRA[name] | {"waves": count}
    waves = RoughSurface(settings).sample_realization(SEED, list(SPECTRA).index(name))
    waves = waves[:, waves[AMPLITUDE] > 0.0]
    assert waves.shape[1] == count
    # Amplitudes are Rayleigh distributed, so their squares have the mean 2 σ²/M.
    square = waves[AMPLITUDE] ** 2 / (2.0 * SIGMA**2 / count)
    judge_p(
        {
            "wave number": compute_p_of_values(
                2.0 * np.pi * np.hypot(waves[KX], waves[KY]), compute_spectrum_cdf(name)
            ),
            "direction": compute_p_of_values(
                np.arctan2(waves[KY], waves[KX]) / (2.0 * np.pi) % 1.0, uniform_cdf
            ),
            "phase": compute_p_of_values(waves[PHASE], uniform_cdf),
            "amplitude": compute_p_of_values(square, lambda x: 1.0 - np.exp(-x)),
        }
    )  # fmt: skip


# --- slopes -----------------------------------------------------------------------------------

# Budak & Grimailo 2020: swell and ripples of one surface.
PAIR = ((500, 11.25, 0.025), (100, 0.2, 3.0))


def make_pair(correlation):
    """Return the surface of Budak & Grimailo without a band limit."""
    return RoughSurface([
        {
            "waves": waves, "rms_height_m": sigma, "wave_number_per_m": k0,
            "correlation": correlation, "band_limit_per_m": math.inf,
        }
        for waves, sigma, k0 in PAIR
    ])  # fmt: skip


def compute_rms_slopes(surface, count):
    """Return the rms slope of each of many realizations."""
    rms_slopes = []
    for number in range(count):
        waves = surface.sample_realization(SEED, number)
        k2 = waves[KX] ** 2 + waves[KY] ** 2
        rms_slopes.append(2.0 * np.pi * math.sqrt(0.5 * (waves[AMPLITUDE] ** 2 * k2).sum()))
    return np.sort(rms_slopes)


def compute_rms_slopes_numpy(wave_number_ratio, count):
    """Return rms slopes from an independent NumPy implementation of the published formulas."""
    generator = np.random.default_rng(SEED)
    mean_square = np.zeros(count)
    for waves, sigma, k0 in PAIR:
        u, beta = generator.random((2, count, waves))
        # ⟨|∇Ψ|²⟩ of a wave is half of (a λ)², and a² = −2 ln u σ²/M.
        mean_square -= (
            sigma**2 / waves * (np.log(u) * (k0 * wave_number_ratio(beta)) ** 2).sum(axis=1)
        )
    return np.sqrt(mean_square)


@NEEDS_JIT
@pytest.mark.parametrize(
    ("correlation", "wave_number_ratio", "median"),
    [
        ("exponential_printed", lambda b: b / np.sqrt(1.0 - b * b), 1.09),
        ("exponential", lambda b: np.sqrt(1.0 / (1.0 - b) ** 2 - 1.0), 20.0),
    ],
)
def test_median_rms_slope_without_band_limit(correlation, wave_number_ratio, median):
    surface = make_pair(correlation)
    assert surface.rms_slope() == math.inf
    count = 1000
    rms_slopes, reference = (
        compute_rms_slopes(surface, count),
        compute_rms_slopes_numpy(wave_number_ratio, 2000),
    )
    # The mean does not exist; order statistics bracket the median with a probability of 99 %.
    low, high = stats.binom.ppf([0.005, 0.995], count, 0.5).astype(int)
    print(
        f"median {np.median(rms_slopes):.3f}, "
        f"99 % within {rms_slopes[low]:.3f} to {rms_slopes[high]:.3f}"
    )
    assert rms_slopes[low] <= median <= rms_slopes[high]
    assert stats.ks_2samp(rms_slopes, reference).pvalue > 0.01


@pytest.mark.parametrize("name", ["exponential, limit", "printed, limit", "gaussian", "spectrum"])
def test_rms_slope_with_band_limit(name):
    surface = RoughSurface.from_input(SPECTRA[name])
    squares = compute_rms_slopes(surface, scale_sample_size(20_000)) ** 2
    error = squares.std() / math.sqrt(squares.size)
    judge_z([(squares.mean() - surface.rms_slope() ** 2) / error], name)


N_SAMPLES = scale_sample_size(200_000)
FACETNESS = (0.3, 1.0)
COSINES = (0.05, 0.5, 1.0)
RULES = {
    "projected": PROJECTED_FACETS,
    "unweighted": UNWEIGHTED_FACETS,
    "any": ANY_FACETS,
}
N_TILT_BINS, N_AZIMUTH_BINS = 8, 12


def make_tilt_distribution(facetness):
    """Return the distribution of 1 − n·n': half-normal below 1."""
    return stats.truncnorm(0.0, 2.0 / facetness, scale=0.5 * facetness)


@njit
def _sample_tilt(state, facetness):
    """Return 1 − n·n' of a facet of any orientation."""
    return 1.0 - sample_facet(state, Vector(0.6, 0.0, -0.8), UP, facetness, ANY_FACETS).tilt.cos


def test_tilt_is_half_normal():
    p = {}
    for facetness in (0.3, 1.0, 2.0):
        tilts = draw_samples(_sample_tilt, N_SAMPLES, facetness)
        assert tilts.min() >= 0.0 and tilts.max() < 1.0
        p[facetness] = compute_p_of_values(tilts, make_tilt_distribution(facetness).cdf)
    judge_p(p)


def test_smooth_facets_have_no_tilt():
    assert (draw_samples(_sample_tilt, 1000, 0.0) == 0.0).all()


def compute_bin_probabilities(facetness, cos_i, rule):
    """Return probabilities of bins uniform in tilt quantile and azimuth, by the midpoint rule."""
    fine_tilt, fine_azimuth = 250, 80
    u = (np.arange(N_TILT_BINS * fine_tilt) + 0.5) / (N_TILT_BINS * fine_tilt)
    phi = (np.arange(N_AZIMUTH_BINS * fine_azimuth) + 0.5) / (N_AZIMUTH_BINS * fine_azimuth)
    c = 1.0 - make_tilt_distribution(facetness).ppf(u)[:, None]
    s = np.sqrt(1.0 - c * c)
    facing = c * cos_i + s * np.sqrt(1.0 - cos_i**2) * np.cos(2.0 * np.pi * phi)
    weight = {
        "projected": np.maximum(facing, 0.0),
        "unweighted": (facing > 0.0).astype(float),
        "any": np.ones_like(facing),
    }[rule]
    weights = weight.reshape(N_TILT_BINS, fine_tilt, N_AZIMUTH_BINS, fine_azimuth).sum(axis=(1, 3))
    return weights / weights.sum()


MIN_SINE = 1e-10
"""Smallest sine of incidence for which facets are rotated exactly (`arithmetic.Precision`)."""


@njit
def _sample_facet_angles(state, facetness, cos_i, sin_i, rule):
    """Return cosine and sine of tilt and azimuth, and the cosine of incidence on the facet."""
    facet = sample_facet(state, Vector(sin_i, 0.0, -cos_i), UP, facetness, rule)
    cos_facet = -facet.cos_facet if facet.back_side else facet.cos_facet
    sine = facet.tilt.sin * max(sin_i, MIN_SINE)
    return facet.tilt.cos, sine, facet.azimuth.cos, facet.azimuth.sin, cos_facet


@pytest.mark.parametrize("rule", RULES)
def test_facet_angles_follow_their_density(rule):
    p = {}
    for facetness in FACETNESS:
        for cos_i in COSINES:
            sin_i = np.sqrt(1.0 - cos_i**2)
            out = draw_samples(
                _sample_facet_angles, N_SAMPLES, facetness, cos_i, sin_i, RULES[rule], width=5
            )
            c, s, cp, sp, cos_facet = out.T
            assert np.abs(c * c + s * s - 1.0).max() < 1e-12
            assert np.abs(cp * cp + sp * sp - 1.0).max() < 1e-12
            expected = c * cos_i + s * max(sin_i, MIN_SINE) * cp
            assert np.abs(cos_facet - expected).max() < 1e-12
            assert rule == "any" or cos_facet.min() > 0.0
            tilt_quantile = make_tilt_distribution(facetness).cdf(1.0 - c)
            azimuth = np.arctan2(sp, cp) / (2.0 * np.pi) % 1.0
            counts = np.histogram2d(
                tilt_quantile, azimuth, bins=(N_TILT_BINS, N_AZIMUTH_BINS), range=((0, 1), (0, 1))
            )[0]
            assert counts.sum() == N_SAMPLES
            p[facetness, cos_i] = compute_p_of_counts(
                counts, compute_bin_probabilities(facetness, cos_i, rule)
            )
    judge_p(p)


@njit
def _sample_random_facet(state, facetness, rule):
    """Return d, n and a sampled facet normal for a random ray and surface."""
    while True:
        d, n = sample_unit_sphere(state), sample_unit_sphere(state)
        if dot(d, n) < 0.0:
            break
    facet = sample_facet(state, d, n, facetness, rule)
    m = compute_facet_normal(d, facet)
    return d.x, d.y, d.z, n.x, n.y, n.z, m.x, m.y, m.z, facet.cos_facet


@pytest.mark.parametrize("rule", RULES)
def test_facets_face_the_ray_and_keep_their_tilt(rule):
    out = draw_samples(_sample_random_facet, scale_sample_size(50_000), 0.6, RULES[rule], width=10)
    d, n, m, cosine = out[:, :3], out[:, 3:6], out[:, 6:9], out[:, 9]
    assert np.abs((m * m).sum(axis=1) - 1.0).max() < 1e-12
    assert cosine.min() > 0.0
    assert np.abs(cosine + (d * m).sum(axis=1)).max() < 1e-12
    if rule != "any":
        assert (n * m).sum(axis=1).min() > 0.0
    # The rotation into world axes preserves the distribution of the tilt.
    if rule == "any":
        tilt_quantile = make_tilt_distribution(0.6).cdf(1.0 - np.abs((n * m).sum(axis=1)))
        judge_p({"tilt in world axes": compute_p_of_values(tilt_quantile, lambda x: x)})


@njit
def _sample_near_normal_incidence(state, facetness):
    d = Vector(1e-7, 0.6 * np.sqrt(1.0 - 1e-14), -0.8 * np.sqrt(1.0 - 1e-14))
    normal = Vector(0.0, -0.6, 0.8)
    facet = sample_facet(state, d, normal, facetness, PROJECTED_FACETS)
    return compute_facet_normal(d, facet)


def test_azimuth_is_uniform_at_normal_incidence():
    m = draw_samples(_sample_near_normal_incidence, N_SAMPLES, 1.0, width=3)
    azimuth = np.arctan2(m[:, 0], m @ np.array([0.0, 0.8, 0.6])) / (2.0 * np.pi) % 1.0
    judge_p({"azimuth": compute_p_of_values(azimuth, lambda x: x, 48)})
