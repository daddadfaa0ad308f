"""Random polarized light and its coherency tensor, for tests of Stokes vectors."""

import numpy as np
from chi2 import scale_sample_size

from splits.kernels.arithmetic import Vector
from splits.kernels.stokes import Stokes

GEOMETRIES = scale_sample_size(50_000) // 1000 * 4
IDENTITY = np.eye(3)


def draw_unit_vectors(rng, n):
    x = rng.normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def draw_polarized_light(rng, pure=False):
    """Return a direction, a reference axis and q, u, v of complete or partial polarization."""
    d, e = draw_unit_vectors(rng, 2)
    e = np.cross(d, e)
    degree = 1.0 if pure else rng.random()
    return d, e / np.linalg.norm(e), degree * draw_unit_vectors(rng, 1)[0]


def make_coherency(q, u, v):
    """Return the coherency matrix, mean E E*, of light of intensity 1 in the frame (e, f)."""
    return 0.5 * np.array([[1 + q, u - 1j * v], [u + 1j * v, 1 - q]])


def make_frame(d, e):
    return np.stack([e, np.cross(d, e)], axis=1)


def compute_stokes(c, d, e):
    """Return I, Q, U, V of a coherency tensor, the mean of E E* in space."""
    (ee, ef), (_, ff) = make_frame(d, e).T @ c @ make_frame(d, e)
    return np.array([(ee + ff).real, (ee - ff).real, 2.0 * ef.real, -2.0 * ef.imag])


def to_vector(x):
    """Return a `Vector` of three numbers."""
    return Vector(*(float(c) for c in x))


def to_kernel_light(e, s):
    """Return the `Stokes` of a reference axis and q, u, v."""
    return Stokes(to_vector(e), *(float(x) for x in s))


def assert_frame(d, e, tolerance=4e-15):
    assert abs(d @ d - 1.0) < tolerance and abs(e @ e - 1.0) < tolerance and abs(d @ e) < tolerance
