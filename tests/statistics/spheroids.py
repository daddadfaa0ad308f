"""Geometry of spheroids in real space; kernels represent points on the unit sphere.

It is independent of `kernels/grains/spheroid.py`; all functions take arrays of vectors.
"""

import numpy as np


def normalize(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def dot_product(a, b):
    return (np.asarray(a) * np.asarray(b)).sum(axis=-1, keepdims=True)


def to_real_space(q, w, minor, flattening):
    """Return the point relative to the centre of the grain: the unit sphere scaled along w."""
    q, w = np.asarray(q), np.asarray(w)
    minor, flattening = np.asarray(minor)[..., None], np.asarray(flattening)[..., None]
    along = dot_product(q, w) * w
    return minor * (q - along) + minor / (1.0 - flattening) * along


def to_unit_sphere(p, w, minor, flattening):
    """Return the point of the unit sphere for a point relative to the grain's centre."""
    along = dot_product(p, w) * np.asarray(w)
    return (p - along) / minor + along * (1.0 - flattening) / minor


def evaluate_quadratic(p, w, minor, flattening):
    """Return the left side of the grain's equation, 1 on its surface and less inside."""
    minor, flattening = np.asarray(minor), np.asarray(flattening)
    z = dot_product(p, w)
    radial = np.asarray(p) - z * np.asarray(w)
    major = minor / (1.0 - flattening)
    return (radial**2).sum(axis=-1) / minor**2 + z[..., 0] ** 2 / major**2


def compute_normal(p, w, minor, flattening):
    """Return the outward unit normal at a point of the surface."""
    z = dot_product(p, w)
    radial = np.asarray(p) - z * np.asarray(w)
    minor, flattening = np.asarray(minor)[..., None], np.asarray(flattening)[..., None]
    return normalize(radial / minor**2 + z * np.asarray(w) * ((1.0 - flattening) / minor) ** 2)


def find_closest_approach(start, end, w, minor, flattening, steps=500):
    """Return the least `evaluate_quadratic` along a segment; positions from the centre."""
    fractions = np.linspace(0.0, 1.0, steps)
    return np.min(
        [evaluate_quadratic(start + t * (end - start), w, minor, flattening) for t in fractions], 0
    )
