"""Microfacet tilt and orientation, cell by cell against the density they are defined by."""

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

from splits.kernels.grains import microfacet
from splits.kernels.math.vectors import UP, Vector, dot

N_SAMPLES = scale_sample_size(200_000)
FACETNESS = (0.3, 1.0)
COSINES = (0.05, 0.5, 1.0)
RULES = {
    "projected": microfacet.PROJECTED_FACETS,
    "unweighted": microfacet.UNWEIGHTED_FACETS,
    "any": microfacet.ANY_FACETS,
}
TILT_CELLS, AZIMUTH_CELLS = 8, 12


def make_tilt_distribution(facetness):
    """Return the distribution of 1 − n·n': half-normal below 1."""
    return stats.truncnorm(0.0, 2.0 / facetness, scale=0.5 * facetness)


@njit
def _sample_tilt(state, facetness):
    """Return 1 − n·n' of any facet, whether it faces the ray or not."""
    return (
        1.0
        - sample_facet(state, Vector(0.6, 0.0, -0.8), UP, facetness, microfacet.ANY_FACETS).tilt.cos
    )


def test_lean():
    p = {}
    for facetness in (0.3, 1.0, 2.0):
        leaning = draw_samples(_sample_tilt, N_SAMPLES, facetness)
        assert leaning.min() >= 0.0 and leaning.max() < 1.0
        p[facetness] = compute_p_of_values(leaning, make_tilt_distribution(facetness).cdf)
    judge_p(p)


def test_smooth_surface_does_not_lean():
    assert (draw_samples(_sample_tilt, 1000, 0.0) == 0.0).all()


def compute_cell_probabilities(facetness, cos_i, rule):
    """Return the probability of cells even in tilt quantile and azimuth, by the midpoint rule."""
    fine_tilt, fine_azimuth = 250, 80
    u = (np.arange(TILT_CELLS * fine_tilt) + 0.5) / (TILT_CELLS * fine_tilt)
    phi = (np.arange(AZIMUTH_CELLS * fine_azimuth) + 0.5) / (AZIMUTH_CELLS * fine_azimuth)
    c = 1.0 - make_tilt_distribution(facetness).ppf(u)[:, None]
    s = np.sqrt(1.0 - c * c)
    facing = c * cos_i + s * np.sqrt(1.0 - cos_i**2) * np.cos(2.0 * np.pi * phi)
    weight = {
        "projected": np.maximum(facing, 0.0),
        "unweighted": (facing > 0.0).astype(float),
        "any": np.ones_like(facing),
    }[rule]
    cells = weight.reshape(TILT_CELLS, fine_tilt, AZIMUTH_CELLS, fine_azimuth).sum(axis=(1, 3))
    return cells / cells.sum()


NORMAL = 1e-10
"""Least sine of incidence for which facets are turned exactly (`arithmetic.Precision`)."""


@njit
def _sample_facet_angles(state, facetness, cos_i, sin_i, rule):
    """Return cosine and sine of tilt and azimuth, and of incidence the cosine on the facet."""
    facet = sample_facet(state, Vector(sin_i, 0.0, -cos_i), UP, facetness, rule)
    cos_facet = -facet.cos_facet if facet.back_side else facet.cos_facet
    sine = facet.tilt.sin * max(sin_i, NORMAL)
    return facet.tilt.cos, sine, facet.azimuth.cos, facet.azimuth.sin, cos_facet


@pytest.mark.parametrize("rule", RULES)
def test_facet_angles(rule):
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
            expected = c * cos_i + s * max(sin_i, NORMAL) * cp
            assert np.abs(cos_facet - expected).max() < 1e-12
            assert rule == "any" or cos_facet.min() > 0.0
            share = make_tilt_distribution(facetness).cdf(1.0 - c)
            turn = np.arctan2(sp, cp) / (2.0 * np.pi) % 1.0
            counts = np.histogram2d(
                share, turn, bins=(TILT_CELLS, AZIMUTH_CELLS), range=((0, 1), (0, 1))
            )[0]
            assert counts.sum() == N_SAMPLES
            p[facetness, cos_i] = compute_p_of_counts(
                counts, compute_cell_probabilities(facetness, cos_i, rule)
            )
    judge_p(p)


@njit
def _sample_random_facet(state, facetness, rule):
    """Return d, n and the facet struck for a random ray and surface."""
    while True:
        d, n = sample_unit_sphere(state), sample_unit_sphere(state)
        if dot(d, n) < 0.0:
            break
    facet = sample_facet(state, d, n, facetness, rule)
    m = compute_facet_normal(d, facet)
    return d.x, d.y, d.z, n.x, n.y, n.z, m.x, m.y, m.z, facet.cos_facet


@pytest.mark.parametrize("rule", RULES)
def test_struck_facet_faces_the_ray_and_lies_as_its_angles_say(rule):
    out = draw_samples(_sample_random_facet, scale_sample_size(50_000), 0.6, RULES[rule], width=10)
    d, n, m, cosine = out[:, :3], out[:, 3:6], out[:, 6:9], out[:, 9]
    assert np.abs((m * m).sum(axis=1) - 1.0).max() < 1e-12
    assert cosine.min() > 0.0
    assert np.abs(cosine + (d * m).sum(axis=1)).max() < 1e-12
    if rule != "any":
        assert (n * m).sum(axis=1).min() > 0.0
    # The law of the tilt survives the way into world axes: same angles, same distribution.
    if rule == "any":
        share = make_tilt_distribution(0.6).cdf(1.0 - np.abs((n * m).sum(axis=1)))
        judge_p({"tilt in world axes": compute_p_of_values(share, lambda x: x)})


@njit
def _sample_near_normal_incidence(state, facetness):
    d = Vector(1e-7, 0.6 * np.sqrt(1.0 - 1e-14), -0.8 * np.sqrt(1.0 - 1e-14))
    normal = Vector(0.0, -0.6, 0.8)
    facet = sample_facet(state, d, normal, facetness, microfacet.PROJECTED_FACETS)
    return compute_facet_normal(d, facet)


def test_normal_incidence_knows_no_azimuth():
    m = draw_samples(_sample_near_normal_incidence, N_SAMPLES, 1.0, width=3)
    turn = np.arctan2(m[:, 0], m @ np.array([0.0, 0.8, 0.6])) / (2.0 * np.pi) % 1.0
    judge_p({"azimuth": compute_p_of_values(turn, lambda x: x, 48)})
