"""Fresnel and Snell equations at an interface against complex arithmetic."""

from __future__ import annotations

import math

import numpy as np
import pytest

from splits.kernels.arithmetic import Vector
from splits.kernels.interface import (
    FresnelResult,
    fresnel,
    fresnel_between,
    refract,
)

COSINES = np.concatenate([np.linspace(0.01, 1.0, 41), [1e-6, 1e-3, 0.999999]])
INDICES = [
    (1.0, 1.31, 0.0),
    (1.0, 1.33, 1e-9),
    (1.0, 1.2, 0.4),
    (1.0, 0.3, 3.0),
    (1.0, 3.0, 3.0),
    (1.31, 1.0, 0.0),
    (1.31, 1.0, 1e-7),
    (1.33, 1.31, 0.02),
    (1.5, 0.9, 1.0),
    (1.31, 1.31, 0.1),
]


def compute_polarized_reflectance(n1, n2, k2, cos_i):
    """Return the reflectances for s and p polarization from complex Fresnel amplitudes."""
    m = complex(n2, k2) / n1
    # The wave of the root with positive imaginary part decays into the far medium.
    q = np.sqrt(m * m - (1.0 - cos_i * cos_i) + 0j)
    r_s = (cos_i - q) / (cos_i + q)
    r_p = (m * m * cos_i - q) / (m * m * cos_i + q)
    return abs(r_s) ** 2, abs(r_p) ** 2, q


@pytest.mark.parametrize("indices", INDICES, ids=str)
def test_reflectance_and_direction_agree_with_complex_amplitudes(indices):
    for cos_i in COSINES:
        s, p, q = compute_polarized_reflectance(*indices, cos_i)
        reflectance, ratio, cos_t = fresnel(*indices, cos_i)
        assert reflectance == pytest.approx(0.5 * (s + p), rel=1e-9, abs=1e-14)
        if s > 1.0 - 1e-15:
            assert (ratio, cos_t) == (0.0, 0.0)
            continue
        # Planes of constant phase have the tangential wave number sinθ and the normal Re q.
        wave = math.hypot(math.sqrt(1.0 - cos_i * cos_i), q.real)
        assert ratio == pytest.approx(1.0 / wave, rel=1e-9)
        assert cos_t == pytest.approx(q.real / wave, rel=1e-7, abs=1e-12)


@pytest.mark.parametrize("indices", INDICES, ids=str)
def test_reflectance_is_a_probability(indices):
    values = [fresnel(*indices, c)[0] for c in COSINES]
    assert min(values) >= 0.0 and max(values) <= 1.0


@pytest.mark.parametrize("n2", [1.31, 1.33, 2.4])
def test_p_reflectance_is_zero_at_brewster_angle(n2):
    cos_b = 1.0 / math.sqrt(1.0 + n2 * n2)
    s, p, _ = compute_polarized_reflectance(1.0, n2, 0.0, cos_b)
    assert p < 1e-30
    # Only s polarization is reflected, by ((n² − 1)/(n² + 1))².
    assert fresnel(1.0, n2, 0.0, cos_b)[0] == pytest.approx(0.5 * s, rel=1e-12)
    assert s == pytest.approx(((n2 * n2 - 1) / (n2 * n2 + 1)) ** 2, rel=1e-12)


@pytest.mark.parametrize(("n2", "k2"), [(1.31, 0.0), (1.2, 0.4), (0.3, 3.0)])
def test_reflectance_at_normal_incidence(n2, k2):
    expected = ((n2 - 1) ** 2 + k2**2) / ((n2 + 1) ** 2 + k2**2)
    reflectance, _, cos_t = fresnel(1.0, n2, k2, 1.0)
    assert reflectance == pytest.approx(expected, rel=1e-13)
    assert cos_t == pytest.approx(1.0, rel=1e-15)


def test_grazing_incidence_reflects_everything():
    for indices in INDICES[:-1]:
        assert fresnel(*indices, 1e-9)[0] == pytest.approx(1.0, abs=1e-6)


def test_total_internal_reflection_below_critical_cosine():
    n1 = 1.31
    critical = math.sqrt(1.0 - 1.0 / n1**2)
    for cos_i in np.linspace(1e-6, critical * (1.0 - 1e-9), 20):
        assert fresnel(n1, 1.0, 0.0, cos_i) == (1.0, 0.0, 0.0)
    assert fresnel(n1, 1.0, 0.0, critical * (1.0 + 1e-6))[0] < 1.0


def test_absorbing_far_medium_frustrates_total_reflection():
    assert fresnel(1.31, 1.0, 1e-3, 0.3)[0] < 1.0


@pytest.mark.parametrize("n", [1.0, 1.31, 2.4])
def test_equal_media_do_not_reflect(n):
    d = Vector(0.48, -0.64, -0.6)
    for cos_i in COSINES:
        assert fresnel(n, n, 0.0, cos_i) == (0.0, 1.0, cos_i)
    straight = refract(d, Vector(0.0, 0.0, 1.0), 0.6, FresnelResult(0.0, 1.0, 0.6))
    assert straight == pytest.approx(d, abs=1e-15)


@pytest.mark.parametrize(("n1", "n2"), [(1.0, 1.31), (1.31, 1.33), (1.0, 2.4)])
def test_refraction_is_reversible(n1, n2):
    for cos_i in COSINES[COSINES > 0.005]:
        forward, ratio, cos_t = fresnel(n1, n2, 0.0, cos_i)
        reverse, back_ratio, cos_back = fresnel(n2, n1, 0.0, cos_t)
        # 1 − R is compared, since R is close to 1 near grazing incidence.
        assert 1.0 - reverse == pytest.approx(1.0 - forward, rel=1e-8)
        assert cos_back == pytest.approx(cos_i, rel=1e-9)
        assert ratio * back_ratio == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("indices", INDICES, ids=str)
def test_refracted_direction_obeys_snell(indices):
    n1 = indices[0]
    rng = np.random.default_rng(5)
    for _ in range(200):
        n, d = rng.normal(size=(2, 3))
        n /= np.linalg.norm(n)
        d /= np.linalg.norm(d)
        d = -d if d @ n > 0.0 else d
        cos_i = float(-d @ n)
        result = fresnel(*indices, cos_i)
        if result.reflectance == 1.0:
            continue
        t = np.array(refract(Vector(*d), Vector(*n), cos_i, result))
        _, _, q = compute_polarized_reflectance(*indices, cos_i)
        real_index = n1 * math.sqrt(1.0 - cos_i**2 + q.real**2)
        assert abs(t @ t - 1.0) < 1e-12
        assert t @ n <= 0.0
        # Tangential wave vectors on both sides are equal.
        assert np.abs(n1 * np.cross(d, n) - real_index * np.cross(t, n)).max() < 1e-9
        if indices[2] == 0.0:
            assert real_index == pytest.approx(indices[1], rel=1e-12)


@pytest.mark.parametrize("n1", [1.56, 2.3, 2.6])
@pytest.mark.parametrize("far", [(1.0, 0.0), (1.33, 1e-8), (1.55, 0.0), (1.56, 0.01)], ids=str)
def test_diffuse_transmittance_is_limited_by_etendue(n1, far):
    # By étendue, diffuse transmittance cannot exceed n2²/n1².
    cosines = (np.arange(4000) + 0.5) / 4000
    transmittances = [1.0 - fresnel(n1, *far, c)[0] for c in cosines]
    transmittance = 2.0 * cosines @ transmittances / len(cosines)
    assert transmittance <= min(1.0, (far[0] / n1) ** 2) + 1e-3


def test_equal_absorbing_media_do_not_reflect():
    for k in (0.0, 1e-3, 0.3):
        assert fresnel_between(1.56, k, 1.56, k, 0.3) == (0.0, 1.0, 0.3)
    assert fresnel_between(1.31, 1e-3, 1.0, 0.0, 0.9) == fresnel(1.31, 1.0, 0.0, 0.9)
