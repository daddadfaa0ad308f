"""Fresnel and Snell equations, and scattering by smooth spheres in closed form."""

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, draw_samples, judge_z
from events import trace_grain
from numba import njit
from scenes import make_optics, make_scene
from scipy import integrate
from spheroids import compute_normal, evaluate_quadratic, to_real_space

import splits
from splits.kernels.arithmetic import dot
from splits.kernels.grains.spheroid import GrainSize
from splits.kernels.interface import FresnelResult, fresnel, fresnel_between, refract
from splits.kernels.scene import ALIVE, Vector

RADIUS = 2.5e-4
COUNT = 200_000


DIRECTION = Vector(0.48, -0.64, 0.6)


@njit
def _scatter(state, psi, facetness, scene, optics, length):
    """Return cosθ of scattering, path inside, survival, entry, axis, displacement, direction."""
    size = GrainSize(RADIUS, 1.0 - psi * psi)
    ray, entry = trace_grain(state, DIRECTION, size, facetness, False, scene, optics, length)
    q, w, g, e = entry.grain.q, entry.grain.w, ray.exit_offset, ray.direction
    return (
        dot(DIRECTION, e), length[2], 1.0 if ray.status == ALIVE else 0.0,
        q.x, q.y, q.z, w.x, w.y, w.z, g.x, g.y, g.z, e.x, e.y, e.z,
    )  # fmt: skip


def sample_scattering(
    n, psi=1.0, facetness=0.0, entry="projected", absorption=0.0, analog=False, ray=0
):
    rules = splits.Interpretation(entry_point=entry).to_sampling_rules(analog)
    scene = make_scene(splits.Snow().make_grain_population(), rules=rules)
    optics = make_optics([1.0, 1.33, n], absorption=[0.0, 0.0, absorption])
    out = draw_samples(
        _scatter, COUNT, psi, facetness, scene, optics, np.zeros(3), width=15, ray=ray
    )
    alive = out[:, 2] == 1.0
    # Rays exit at a point of the surface in an outward direction.
    q, w, displacement, direction = (out[alive, i : i + 3] for i in (3, 6, 9, 12))
    minor, flattening = RADIUS * psi * psi, 1.0 - psi * psi
    exit_point = to_real_space(q, w, minor, flattening) + displacement
    assert np.abs(evaluate_quadratic(exit_point, w, minor, flattening) - 1.0).max() < 1e-9
    normal = compute_normal(exit_point, w, minor, flattening)
    assert (direction * normal).sum(axis=1).min() > 0.0
    assert np.abs((direction**2).sum(axis=1) - 1.0).max() < 1e-9
    return out[:, 0], out[:, 1], alive


def fresnel_of_angle(i, n):
    """Return the unpolarized reflectance and the angle of refraction, from the angles."""
    t = math.asin(math.sin(i) / n)
    s = (math.sin(i - t) / math.sin(i + t)) ** 2
    p = (math.tan(i - t) / math.tan(i + t)) ** 2
    return 0.5 * (s + p), t


def integrate_impacts(value, weight):
    """Return the mean of value(i) over angles of incidence i with the density `weight`."""
    return integrate.quad(lambda i: weight(i) * value(i), 1e-9, 0.5 * math.pi - 1e-9, limit=400)[0]


def projected_density(i):
    return math.sin(2.0 * i)


def mean_cosine(i, n):
    """Return <cosθ> at one angle of incidence: reflected, transmitted, all internal orders.

    Order q is deviated by 2(i − t) + q(π − 2t), with fraction (1 − r)² r^q: a geometric series.
    """
    r, t = fresnel_of_angle(i, n)
    series = np.exp(2j * (i - t)) / (1.0 - r * np.exp(1j * (math.pi - 2.0 * t)))
    return -r * math.cos(2.0 * i) + (1.0 - r) ** 2 * series.real


def mean_escape(i, n, depth):
    """Return the fraction that is not absorbed in a sphere of optical thickness `depth`."""
    r, t = fresnel_of_angle(i, n)
    transmission = math.exp(-depth * math.cos(t))
    return r + (1.0 - r) ** 2 * transmission / (1.0 - r * transmission)


def mean_path(i, n):
    """Return the path inside per diameter: 1 − r enters, for 1/(1 − r) segments of cos t each."""
    _, t = fresnel_of_angle(i, n)
    return math.cos(t)


@NEEDS_JIT
@pytest.mark.long
@pytest.mark.parametrize("entry", ["projected", "uniform"])
def test_mean_cosine_and_path_of_a_smooth_sphere(entry):
    weight = projected_density if entry == "projected" else math.sin
    z = []
    for ray, n in enumerate((1.1, 1.31, 1.6)):
        cosine, path, alive = sample_scattering(n, entry=entry, ray=ray)
        assert alive.all()
        for sample, expected in (
            (cosine, integrate_impacts(lambda i, n=n: mean_cosine(i, n), weight)),
            (path / (2 * RADIUS), integrate_impacts(lambda i, n=n: mean_path(i, n), weight)),
        ):
            z.append((sample.mean() - expected) / (sample.std() / math.sqrt(COUNT)))
    # Cosine and path of a sample count as one.
    judge_z(z, f"smooth sphere, {entry}", independent=3)
    assert np.abs(z).max() < 3.0


@NEEDS_JIT
def test_absorption_in_a_smooth_sphere():
    # Weighted and analog absorption against the sum over internal orders.
    z = []
    for number, depth in enumerate((0.1, 1.0, 5.0)):
        absorption = depth / (2.0 * RADIUS)
        expected = integrate_impacts(
            lambda i, depth=depth: mean_escape(i, 1.31, depth), projected_density
        )
        _, path, _ = sample_scattering(1.31, ray=10 + 2 * number)
        weight = np.exp(-absorption * path)
        _, _, alive = sample_scattering(
            1.31, absorption=absorption, analog=True, ray=11 + 2 * number
        )
        z.append((weight.mean() - expected) / (weight.std() / math.sqrt(COUNT)))
        z.append((alive.mean() - expected) / math.sqrt(expected * (1 - expected) / COUNT))
    judge_z(z, "absorbing sphere")


@NEEDS_JIT
def test_roughness_reduces_forward_scattering():
    means = [sample_scattering(1.31, 0.8, f)[0].mean() for f in (0.0, 0.3, 1.0)]
    assert means[0] > means[1] + 0.01 > means[2] + 0.02


COSINES = np.concatenate([np.linspace(0.01, 1.0, 41), [1e-6, 1e-3, 0.999999]])
INDICES = [
    (1.0, 1.31, 0.0),
    (1.0, 1.33, 1e-9),
    (1.0, 1.2, 0.4),
    (1.0, 0.3, 3.0),
    (1.0, 3.0, 3.0),
    (1.31, 1.0, 0.0),
    (1.31, 1.0, 1e-7),
    (1.31, 1.0, 1e-3),
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
        assert 0.0 <= reflectance <= 1.0
        assert reflectance == pytest.approx(0.5 * (s + p), rel=1e-9, abs=1e-14)
        if s > 1.0 - 1e-15:
            # Total reflection, which the slightest absorption beyond the interface frustrates.
            assert (ratio, cos_t) == (0.0, 0.0) and indices[2] == 0.0
            continue
        # Planes of constant phase have the tangential wave number sinθ and the normal Re q.
        wave = math.hypot(math.sqrt(1.0 - cos_i * cos_i), q.real)
        assert ratio == pytest.approx(1.0 / wave, rel=1e-9)
        assert cos_t == pytest.approx(q.real / wave, rel=1e-7, abs=1e-12)


@pytest.mark.parametrize("n2", [1.31, 1.33, 2.4])
def test_p_reflectance_is_zero_at_brewster_angle(n2):
    cos_b = 1.0 / math.sqrt(1.0 + n2 * n2)
    s, p, _ = compute_polarized_reflectance(1.0, n2, 0.0, cos_b)
    assert p < 1e-30
    # Only s polarization is reflected, by ((n² − 1)/(n² + 1))².
    assert fresnel(1.0, n2, 0.0, cos_b)[0] == pytest.approx(0.5 * s, rel=1e-12)
    assert s == pytest.approx(((n2 * n2 - 1) / (n2 * n2 + 1)) ** 2, rel=1e-12)


def test_total_internal_reflection_below_critical_cosine():
    n1 = 1.31
    critical = math.sqrt(1.0 - 1.0 / n1**2)
    for cos_i in np.linspace(1e-6, critical * (1.0 - 1e-9), 20):
        assert fresnel(n1, 1.0, 0.0, cos_i) == (1.0, 0.0, 0.0)
    assert fresnel(n1, 1.0, 0.0, critical * (1.0 + 1e-6))[0] < 1.0


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
