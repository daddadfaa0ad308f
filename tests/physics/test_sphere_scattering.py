"""Scattering by single grains: smooth spheres against geometric optics in closed form."""

from __future__ import annotations

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
from splits.kernels.arithmetic import Vector, dot
from splits.kernels.grains.spheroid import GrainSize
from splits.kernels.scene import ALIVE

pytestmark = NEEDS_JIT

RADIUS = 2.5e-4
COUNT = 400_000


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


def fresnel(i, n):
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
    r, t = fresnel(i, n)
    series = np.exp(2j * (i - t)) / (1.0 - r * np.exp(1j * (math.pi - 2.0 * t)))
    return -r * math.cos(2.0 * i) + (1.0 - r) ** 2 * series.real


def mean_escape(i, n, depth):
    """Return the fraction that is not absorbed in a sphere of optical thickness `depth`."""
    r, t = fresnel(i, n)
    transmission = math.exp(-depth * math.cos(t))
    return r + (1.0 - r) ** 2 * transmission / (1.0 - r * transmission)


def mean_path(i, n):
    """Return the path inside per diameter: 1 − r enters, for 1/(1 − r) segments of cos t each."""
    _, t = fresnel(i, n)
    return math.cos(t)


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


def test_asymmetry_of_an_ice_sphere():
    expected = integrate_impacts(lambda i: mean_cosine(i, 1.31), projected_density)
    assert abs(expected - 0.78) < 0.005
    cosine, _, _ = sample_scattering(1.31, ray=3)
    judge_z([(cosine.mean() - expected) / (cosine.std() / math.sqrt(COUNT))], "asymmetry")


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


def test_matched_grain_does_not_deviate_rays():
    for psi, facetness in ((1.0, 0.0), (0.5, 0.0), (0.7, 1.0)):
        for entry in ("uniform", "projected"):
            cosine, path, _ = sample_scattering(1.0, psi, facetness, entry)
            assert np.abs(cosine - 1.0).max() < 1e-12
            assert path.min() > 0.0


def test_roughness_reduces_forward_scattering():
    means = [sample_scattering(1.31, 0.8, f)[0].mean() for f in (0.0, 0.3, 1.0)]
    assert means[0] > means[1] + 0.01 > means[2] + 0.02
