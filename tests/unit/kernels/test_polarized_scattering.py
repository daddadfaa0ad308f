"""Rotation and scattering of polarized light: rotations, dipoles, sampling and evaluation."""

import math

import numpy as np
import pytest
from chi2 import scale_sample_size, start_random_stream
from numba import njit
from polarized_light import (
    GEOMETRIES,
    IDENTITY,
    assert_frame,
    compute_stokes,
    draw_polarized_light,
    draw_unit_vectors,
    make_coherency,
    make_frame,
    to_kernel_light,
    to_vector,
)

from splits.kernels import phase_function, stokes
from splits.kernels.arithmetic import Vector

RAYLEIGH = phase_function.make_rayleigh()
# Rows are m12, m22, m33, m34, m44 of matrices of single particles or of sums of them.
TABLE = phase_function.make_tabulated(
    [1.0, -1.0, 0.2, 0.8],
    [5.0, 1.0, 0.0, 2.0],
    [[0.0, 1.0, 1.0, 0.0, 1.0], [0.0, 0.6, -0.6, 0.0, -0.2], [0.4, 0.9, 0.3, 0.5, 0.3],
     [-0.5, 0.9, 0.6, -0.4, 0.7]],
)  # fmt: skip
MODELS = {
    "forward": phase_function.make_henyey_greenstein(0.6),
    "backward": phase_function.make_henyey_greenstein(-0.4),
    "Rayleigh": RAYLEIGH,
    "depolarizing": phase_function.make_rayleigh(0.1),
    "table": TABLE,
}


def rotate_linear(q, u, e, d, t):
    """Return q and u after a rotation of the reference axis from e to t."""
    return stokes.rotate_reference_to(to_kernel_light(e, (q, u, 0.0)), to_vector(d), to_vector(t))


def scatter_towards(model, d, e, s, t):
    """Return density, q, u, v, and the reference axis of light scattered towards t."""
    density, out = stokes.evaluate_polarized_scattering(
        model, to_vector(d), to_kernel_light(e, s), to_vector(t)
    )
    return np.array([density, *out[1:], *out.e])


def sample_scattering(state, model, d, e, s):
    """Return direction, reference axis, and q, u, v of a sampled scattering."""
    d, out = stokes.scatter_polarized(state, model, to_vector(d), to_kernel_light(e, s))
    return np.array(d), np.array(out.e), np.array(out[1:])


# --- rotation ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [(0, (0.6, 0.3)), (45, (0.3, -0.6)), (90, (-0.6, -0.3)), (-45, (-0.3, 0.6)), (180, (0.6, 0.3))],
)
def test_rotation_by_an_angle(degrees, expected):
    a = math.radians(degrees)
    # The light travels along z: from x towards y is from e towards d × e.
    q, u = rotate_linear(0.6, 0.3, (1, 0, 0), (0, 0, 1), (math.cos(a), math.sin(a), 0))
    assert (q, u) == pytest.approx(expected, abs=1e-15)


def test_rotation_is_invertible():
    rng = np.random.default_rng(1)
    for _ in range(GEOMETRIES):
        d, e, (q, u, _) = draw_polarized_light(rng)
        t = np.cross(d, draw_unit_vectors(rng, 1)[0])
        t /= np.linalg.norm(t)
        q2, u2 = rotate_linear(q, u, e, d, t)
        assert q2**2 + u2**2 == pytest.approx(q**2 + u**2, rel=1e-14)
        assert rotate_linear(q2, u2, t, d, e) == pytest.approx((q, u), abs=1e-14)
        # The length of the new reference and its component along d have no effect.
        longer = 3.0 * t + 0.2 * d
        assert rotate_linear(q, u, e, d, longer) == pytest.approx((q2, u2), abs=1e-13)


def test_unpolarized_light_has_a_valid_frame():
    for d in draw_unit_vectors(np.random.default_rng(2), 100):
        light = stokes.make_unpolarized(to_vector(d), stokes.UNPOLARIZED)
        assert_frame(d, np.array(light.e))
        assert light[1:] == (0.0, 0.0, 0.0)
    assert stokes.make_unpolarized(to_vector(d), None) is None


# --- scattering -------------------------------------------------------------------------------


def list_geometries(rng, d, e):
    """Yield directions: a random one, ±d, and directions next to ±d."""
    yield draw_unit_vectors(rng, 1)[0]
    for sign in (1.0, -1.0):
        yield sign * d
        for offset in (1e-12, 1e-6):
            t = sign * d + offset * (0.6 * e + 0.8 * np.cross(d, e))
            yield t / np.linalg.norm(t)


def test_rayleigh_scattering_matches_a_dipole():
    rng = np.random.default_rng(3)
    for i in range(GEOMETRIES):
        d, e, s = draw_polarized_light(rng, pure=i % 2 == 0)
        coherency = make_frame(d, e) @ make_coherency(*s) @ make_frame(d, e).T
        for t in list_geometries(rng, d, e):
            out = scatter_towards(RAYLEIGH, d, e, s, t)
            density, e2 = out[0], out[4:]
            assert_frame(t, e2)
            # The field of a dipole is the incident field projected perpendicular to t.
            projection = IDENTITY - np.outer(t, t)
            expected = compute_stokes(projection @ coherency @ projection, t, e2)
            assert density == pytest.approx(3.0 / (8.0 * math.pi) * expected[0], abs=1e-15)
            assert out[1:4] == pytest.approx(expected[1:] / expected[0], abs=1e-14 / expected[0])


def make_rotation(sigma):
    """Return the Mueller matrix of a rotation of the reference axis."""
    c, s = math.cos(2.0 * sigma), math.sin(2.0 * sigma)
    return np.array([[1, 0, 0, 0], [0, c, s, 0], [0, -s, c, 0], [0, 0, 0, 1]])


def compute_angle(e, t, d):
    return math.atan2(np.cross(e, t) @ d, e @ t)


def evaluate_matrix(model, mu):
    """Return the phase function and the normalized scattering matrix at a cosine, independently."""
    if model.kind == phase_function.TABLE:
        p = np.interp(mu, model.cosines, model.density)
        elements = [np.interp(mu, model.cosines, column) / p for column in model.elements.T]
    else:
        # Rayleigh scattering with a depolarization factor of 0.1, or Henyey & Greenstein with 0.
        rho = 0.1 if model.kind == phase_function.RAYLEIGH else 0.0
        delta, delta_2 = (1.0 - rho) / (1.0 + rho / 2.0), (1.0 - 2.0 * rho) / (1.0 - rho)
        p11 = 0.75 * delta * (1.0 + mu * mu) + 1.0 - delta
        p12, p22 = -0.75 * delta * (1.0 - mu * mu), 0.75 * delta * (1.0 + mu * mu)
        elements = np.array([p12, p22, 1.5 * delta * mu, 0.0, 1.5 * delta * delta_2 * mu]) / p11
        g = model.g
        p = p11 / (4.0 * math.pi)
        if model.kind == phase_function.HENYEY_GREENSTEIN:
            p = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * mu) ** 1.5)
    m12, m22, m33, m34, m44 = elements
    return p, np.array([[1, m12, 0, 0], [m12, m22, 0, 0], [0, 0, m33, m34], [0, 0, -m34, m44]])


@pytest.mark.parametrize("name", ["forward", "depolarizing", "table"])
def test_scattering_equals_rotated_mueller_matrix(name):
    rng, model = np.random.default_rng(4), MODELS[name]
    for _ in range(GEOMETRIES):
        d, e, s = draw_polarized_light(rng)
        t = draw_unit_vectors(rng, 1)[0]
        before = np.cross(np.cross(d, t), d)
        theta = math.atan2(np.linalg.norm(np.cross(d, t)), d @ t)
        p, matrix = evaluate_matrix(model, math.cos(theta))
        reference = np.cross(t, draw_unit_vectors(rng, 1)[0])
        reference /= np.linalg.norm(reference)
        after = np.cross(np.cross(d, t), t)
        expected = (
            make_rotation(compute_angle(after, reference, t))
            @ matrix
            @ make_rotation(compute_angle(e, before, d))
            @ np.append(1.0, s)
        )
        out = scatter_towards(model, d, e, s, t)
        assert out[0] == pytest.approx(p * expected[0], rel=1e-12)
        q, u = rotate_linear(*out[1:3], out[4:], t, reference)
        # Ratios of a table are undefined where its density is 0.
        assert (q, u, out[3]) == pytest.approx(expected[1:] / expected[0], abs=1e-11 / min(p, 1.0))


def test_rayleigh_vanishes_along_the_dipole():
    out = scatter_towards(RAYLEIGH, (0, 0, 1), (1, 0, 0), (1, 0, 0), (1, 0, 0))
    assert (out[:4] == 0.0).all()


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_density_integrates_to_1(model):
    x, weight = np.polynomial.legendre.leggauss(24)
    edges = np.array([-1.0, 0.2, 0.8, 1.0])
    half = 0.5 * np.diff(edges)[:, np.newaxis]
    mu = (edges[:-1, np.newaxis] + half * (1.0 + x)).ravel()
    weight = (half * weight).ravel()
    azimuth = 2.0 * np.pi * (np.arange(6) + 0.3) / 6
    rng = np.random.default_rng(5)
    for _ in range(3):
        d, e, s = draw_polarized_light(rng, pure=True)
        total = 0.0
        for m, w in zip(mu, weight, strict=True):
            azimuthal = make_frame(d, e) @ [np.cos(azimuth), np.sin(azimuth)]
            for t in m * d + math.sqrt(1.0 - m * m) * azimuthal.T:
                total += w * scatter_towards(model, d, e, s, t)[0]
        assert total * 2.0 * np.pi / azimuth.size == pytest.approx(1.0, rel=1e-11)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_sampled_scattering_matches_the_evaluated_density(model):
    rng = np.random.default_rng(6)
    state = start_random_stream()
    for i in range(GEOMETRIES):
        d, e, s = draw_polarized_light(rng, pure=i % 2 == 0)
        t, e2, s2 = sample_scattering(state, model, d, e, s)
        assert_frame(t, e2)
        assert np.linalg.norm(s2) <= 1.0 + 1e-15
        expected = scatter_towards(model, d, e, s, t)
        relative_density = 4.0 * math.pi * expected[0]
        assert relative_density > 0.0
        rotated = rotate_linear(*s2[:2], e2, t, expected[4:])
        assert (*rotated, s2[2]) == pytest.approx(
            expected[1:4], abs=1e-10 / min(relative_density, 1.0)
        )


@njit
def _scatter_repeatedly(state, model, n_scatterings):
    d = Vector(0.0, 0.6, 0.8)
    light = stokes.Stokes(Vector(1.0, 0.0, 0.0), 0.5, 0.3, -0.4)
    for _ in range(n_scatterings):
        d, light = stokes.scatter_polarized(state, model, d, light)
    return d, light


def test_frames_stay_orthonormal_after_many_scatterings():
    for model in (*MODELS.values(), phase_function.make_henyey_greenstein(0.99)):
        d, light = _scatter_repeatedly(start_random_stream(), model, scale_sample_size(50_000))
        assert_frame(np.array(d), np.array(light.e))
        assert np.linalg.norm(light[1:]) <= 1.0 + 1e-15
