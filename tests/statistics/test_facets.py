"""Tilt and orientation of sampled microfacets against their density, in bins."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import (
    compute_p_of_counts,
    compute_p_of_values,
    draw_samples,
    judge_p,
    scale_sample_size,
)
from events import compute_facet_normal, sample_facet, sample_unit_sphere
from numba import njit
from scipy import stats

from splits.kernels.arithmetic import UP, Vector, dot
from splits.kernels.scene import ANY_FACETS, PROJECTED_FACETS, UNWEIGHTED_FACETS

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
