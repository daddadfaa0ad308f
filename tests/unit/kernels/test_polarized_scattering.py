"""Polarized light turned and scattered: explicit rotations, dipoles, estimates against draws."""

from __future__ import annotations

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

from splits.kernels.math.vectors import Vector
from splits.kernels.optics import phase_function, stokes

RAYLEIGH = phase_function.make_rayleigh()


def rotate_linear(q, u, e, d, t):
    """Return q and u when the reference changes from e to t."""
    return stokes.rotate_reference_to(to_kernel_light(e, (q, u, 0.0)), to_vector(d), to_vector(t))


def scatter_towards(model, d, e, s, t):
    """Return density, q, u, v, and the reference of light scattered towards t, in one array."""
    density, out = stokes.evaluate_polarized_scattering(
        model, to_vector(d), to_kernel_light(e, s), to_vector(t)
    )
    return np.array([density, *out[1:], *out.e])


def sample_scattering(state, model, d, e, s):
    """Return direction, reference, and q, u, v of light scattered somewhere."""
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


def test_light_along_the_new_reference_has_q_of_1():
    a = math.radians(30.0)
    q, u = math.cos(2 * a), math.sin(2 * a)
    turned = rotate_linear(q, u, (1, 0, 0), (0, 0, 1), (math.cos(a), math.sin(a), 0))
    assert turned == pytest.approx((1.0, 0.0), abs=1e-15)


def test_rotation_there_and_back():
    rng = np.random.default_rng(1)
    for _ in range(GEOMETRIES):
        d, e, (q, u, _) = draw_polarized_light(rng)
        t = np.cross(d, draw_unit_vectors(rng, 1)[0])
        t /= np.linalg.norm(t)
        q2, u2 = rotate_linear(q, u, e, d, t)
        assert q2**2 + u2**2 == pytest.approx(q**2 + u**2, rel=1e-14)
        assert rotate_linear(q2, u2, t, d, e) == pytest.approx((q, u), abs=1e-14)
        # Only the direction of the new reference counts, and not how long it is.
        longer = 3.0 * t + 0.2 * d
        assert rotate_linear(q, u, e, d, longer) == pytest.approx((q2, u2), abs=1e-13)


def test_any_reference():
    for d in draw_unit_vectors(np.random.default_rng(2), 100):
        light = stokes.make_unpolarized(to_vector(d), stokes.UNPOLARIZED)
        assert_frame(d, np.array(light.e))
        assert light[1:] == (0.0, 0.0, 0.0)
    assert stokes.make_unpolarized(to_vector(d), None) is None


# --- scattering -------------------------------------------------------------------------------


def list_geometries(rng, d, e):
    """Return directions: one at random, next to ±d, and exactly there."""
    yield draw_unit_vectors(rng, 1)[0]
    for sign in (1.0, -1.0):
        yield sign * d
        for off in (1e-12, 1e-6):
            t = sign * d + off * (0.6 * e + 0.8 * np.cross(d, e))
            yield t / np.linalg.norm(t)


def test_rayleigh_scattering_is_that_of_a_dipole():
    rng = np.random.default_rng(3)
    for i in range(GEOMETRIES):
        d, e, s = draw_polarized_light(rng, pure=i % 2 == 0)
        inside = make_frame(d, e) @ make_coherency(*s) @ make_frame(d, e).T
        for t in list_geometries(rng, d, e):
            out = scatter_towards(RAYLEIGH, d, e, s, t)
            density, e2 = out[0], out[4:]
            assert_frame(t, e2)
            # The field of a dipole is that of the light it scatters, seen across t.
            across = IDENTITY - np.outer(t, t)
            expected = compute_stokes(across @ inside @ across, t, e2)
            assert density == pytest.approx(3.0 / (8.0 * math.pi) * expected[0], abs=1e-15)
            assert out[1:4] == pytest.approx(expected[1:] / expected[0], abs=1e-14 / expected[0])


def make_rotation(sigma):
    """Return the matrix that turns the reference of a Stokes vector."""
    c, s = math.cos(2.0 * sigma), math.sin(2.0 * sigma)
    return np.array([[1, 0, 0, 0], [0, c, s, 0], [0, -s, c, 0], [0, 0, 0, 1]])


def compute_angle(e, t, d):
    return math.atan2(np.cross(e, t) @ d, e @ t)


@pytest.mark.parametrize("polarizing", [0.0, 0.7, 1.0])
def test_scattering_is_rotation_scattering_matrix_rotation(polarizing):
    rng = np.random.default_rng(4)
    g = 0.6
    model = phase_function.make_henyey_greenstein(g, polarizing)
    for _ in range(GEOMETRIES):
        d, e, s = draw_polarized_light(rng)
        t = draw_unit_vectors(rng, 1)[0]
        across = np.cross(np.cross(d, t), d)
        theta = math.atan2(np.linalg.norm(np.cross(d, t)), d @ t)
        m33 = 2.0 * math.cos(theta) / (1.0 + math.cos(theta) ** 2)
        m12 = -polarizing * math.sin(theta) ** 2 / (1.0 + math.cos(theta) ** 2)
        matrix = np.array([[1, m12, 0, 0], [m12, 1, 0, 0], [0, 0, m33, 0], [0, 0, 0, m33]])
        last = np.cross(t, draw_unit_vectors(rng, 1)[0])
        last /= np.linalg.norm(last)
        behind = np.cross(np.cross(d, t), t)
        expected = (
            make_rotation(compute_angle(behind, last, t))
            @ matrix
            @ make_rotation(compute_angle(e, across, d))
            @ np.append(1.0, s)
        )
        out = scatter_towards(model, d, e, s, t)
        p = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * math.cos(theta)) ** 1.5)
        assert out[0] == pytest.approx(p * expected[0], rel=1e-12)
        q, u = rotate_linear(*out[1:3], out[4:], t, last)
        assert (q, u, out[3]) == pytest.approx(expected[1:] / expected[0], abs=1e-11)


def test_unpolarized_light_at_90_degrees():
    out = scatter_towards(RAYLEIGH, (0, 0, 1), (0, 1, 0), (0, 0, 0), (1, 0, 0))
    # Polarized completely, at right angles to the plane of scattering.
    assert out[:4] == pytest.approx([3 / (16 * math.pi), -1.0, 0.0, 0.0], abs=1e-15)
    assert abs(out[4:] @ [0, 1, 0]) < 1e-15


def test_no_light_along_the_dipole():
    out = scatter_towards(RAYLEIGH, (0, 0, 1), (1, 0, 0), (1, 0, 0), (1, 0, 0))
    assert (out[:4] == 0.0).all()


TABLE = phase_function.make_tabulated([1.0, -1.0, 0.2, 0.8], [5.0, 1.0, 0.0, 2.0], 0.5)
MODELS = {
    "forward": phase_function.make_henyey_greenstein(0.6, 0.8),
    "backward": phase_function.make_henyey_greenstein(-0.4, 1.0),
    "Rayleigh": RAYLEIGH,
    "table": TABLE,
}


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_density_integrates_to_1(model):
    x, weight = np.polynomial.legendre.leggauss(24)
    edges = np.array([-1.0, 0.2, 0.8, 1.0])
    half = 0.5 * np.diff(edges)[:, np.newaxis]
    mu = (edges[:-1, np.newaxis] + half * (1.0 + x)).ravel()
    weight = (half * weight).ravel()
    turn = 2.0 * np.pi * (np.arange(6) + 0.3) / 6
    rng = np.random.default_rng(5)
    for _ in range(3):
        d, e, s = draw_polarized_light(rng, pure=True)
        total = 0.0
        for m, w in zip(mu, weight, strict=True):
            around = make_frame(d, e) @ [np.cos(turn), np.sin(turn)]
            for t in m * d + math.sqrt(1.0 - m * m) * around.T:
                total += w * scatter_towards(model, d, e, s, t)[0]
        assert total * 2.0 * np.pi / turn.size == pytest.approx(1.0, rel=1e-11)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_what_is_drawn_is_what_is_estimated(model):
    rng = np.random.default_rng(6)
    state = start_random_stream()
    for i in range(GEOMETRIES):
        d, e, s = draw_polarized_light(rng, pure=i % 2 == 0)
        t, e2, s2 = sample_scattering(state, model, d, e, s)
        assert_frame(t, e2)
        assert np.linalg.norm(s2) <= 1.0 + 1e-15
        expected = scatter_towards(model, d, e, s, t)
        seen = 4.0 * math.pi * expected[0]
        assert seen > 0.0
        turned = rotate_linear(*s2[:2], e2, t, expected[4:])
        assert (*turned, s2[2]) == pytest.approx(expected[1:4], abs=1e-10 / min(seen, 1.0))


@njit
def _scatter_repeatedly(state, model, times):
    d = Vector(0.0, 0.6, 0.8)
    light = stokes.Stokes(Vector(1.0, 0.0, 0.0), 0.5, 0.3, -0.4)
    for _ in range(times):
        d, light = stokes.scatter_polarized(state, model, d, light)
    return d, light


def test_frames_survive_many_scatterings():
    for model in (*MODELS.values(), phase_function.make_henyey_greenstein(0.99, 1.0)):
        d, light = _scatter_repeatedly(start_random_stream(), model, scale_sample_size(50_000))
        assert_frame(np.array(d), np.array(light.e))
        assert np.linalg.norm(light[1:]) <= 1.0 + 1e-15


def test_rayleigh_scattering_keeps_light_completely_polarized():
    rng = np.random.default_rng(7)
    state = start_random_stream()
    for _ in range(GEOMETRIES):
        d, e, s = draw_polarized_light(rng, pure=True)
        t, _, s2 = sample_scattering(state, RAYLEIGH, d, e, s)
        density = scatter_towards(RAYLEIGH, d, e, s, t)[0]
        assert np.linalg.norm(s2) == pytest.approx(1.0, abs=1e-14 / density)
