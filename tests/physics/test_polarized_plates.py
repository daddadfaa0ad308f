"""Polarized light at smooth interfaces of whole media: one face, plates and stacks of plates.

Mueller matrices of plane-parallel plates follow from Fresnel's amplitudes and the addition of
interfaces without interference.  Rays of any polarization are traced by the functions of the
scalar kernel, from the entry into a medium without particles to the exit.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z, scale_sample_size
from numba import njit
from scenes import compute_optics

import splits
from splits.kernels.arithmetic import ORIGIN, Vector
from splits.kernels.grains.spheroid import FIRST_ROULETTE_DEPTH
from splits.kernels.rng import start_stream
from splits.kernels.scene import ALIVE, NO_MAX_ORDER, REFLECTED, make_ray
from splits.kernels.stokes import Stokes, rotate_reference_to
from splits.kernels.transport.events import enter_layer
from splits.kernels.transport.history import trace_history
from splits.simulation.scene import build_scene

NM = [550.0]
LIGHT = {
    "unpolarized": (0.0, 0.0, 0.0), "parallel": (1.0, 0.0, 0.0), "perpendicular": (-1.0, 0.0, 0.0),
    "circular": (0.0, 0.0, 1.0), "elliptic": (0.48, -0.6, 0.64), "partial": (-0.2, 0.5, -0.3),
}  # fmt: skip
PLATES = {
    "glass": (1.5,), "diamond": (2.4,), "water on glass": (1.33, 1.6), "three": (1.6, 1.2, 1.9),
}  # fmt: skip
ANGLES = (20.0, 56.0, 80.0)


def make_plate(index: float, **more) -> splits.ParticleLayer:
    """Return a layer without particles."""
    return splits.ParticleLayer(
        optical_thickness=0.0, refractive_index=index, bottom_albedo=None, polarized=True, **more
    )


def make_stack(indices: tuple[float, ...]) -> splits.ParticleLayer | splits.Stack:
    """Return plates without particles on top of each other."""
    plates = [make_plate(index) for index in indices]
    return plates[0] if len(plates) == 1 else splits.Stack(plates)


def compute_interface(n1: float, n2: float, sine: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the Mueller matrices of an interface by its amplitudes, for a sine in air.

    The reference of all beams is parallel to the plane of incidence.
    """
    w1, w2 = np.sqrt(n1**2 - sine**2 + 0j), np.sqrt(n2**2 - sine**2 + 0j)
    rs = (w1 - w2) / (w1 + w2)
    rp = (n2**2 * w1 - n1**2 * w2) / (n2**2 * w1 + n1**2 * w2)
    ts, tp = 2.0 * w1 / (w1 + w2), 2.0 * n1 * n2 * w1 / (n2**2 * w1 + n1**2 * w2)
    flux = (w2 / w1).real

    def make_mueller(p, s):
        plus, minus = 0.5 * (abs(p) ** 2 + abs(s) ** 2), 0.5 * (abs(p) ** 2 - abs(s) ** 2)
        product = p * np.conj(s)
        a, b = product.real, product.imag
        return np.array([[plus, minus, 0, 0], [minus, plus, 0, 0], [0, 0, a, b], [0, 0, -b, a]])

    return make_mueller(rp, rs), flux * make_mueller(tp, ts)


def add_interfaces(indices: tuple[float, ...], incidence_deg: float) -> tuple:
    """Return the matrices of reflection and transmission of plates in air, by addition.

    r and t are those of the plates so far for light from above, r_below and t_below from below.
    """
    sine = math.sin(math.radians(incidence_deg))
    media = [1.0, *indices, 1.0]
    r, t = compute_interface(media[0], media[1], sine)
    r_below, t_below = compute_interface(media[1], media[0], sine)
    for near, far in pairwise(media[1:]):
        next_r, next_t = compute_interface(near, far, sine)
        next_r_below, next_t_below = compute_interface(far, near, sine)
        down = np.linalg.inv(np.eye(4) - r_below @ next_r)
        up = np.linalg.inv(np.eye(4) - next_r @ r_below)
        r, t, r_below, t_below = (
            r + t_below @ next_r @ down @ t,
            next_t @ down @ t,
            next_r_below + next_t @ r_below @ up @ next_t_below,
            t_below @ up @ next_t_below,
        )
    return r, t


@njit
def _trace_light(seed, count, light, scene, optics, path_lengths):
    """Return sums over rays of I, Q, U and V, and of their squares, reflected and transmitted.

    Light has the reference in the plane of incidence, at both ends.
    """
    sums, state = np.zeros((2, 2, 4)), np.zeros(1, dtype=np.uint64)
    cosine = scene.source.cos_incidence
    sine = math.sqrt((1.0 - cosine) * (1.0 + cosine))
    d, e = Vector(sine, 0.0, -cosine), Vector(cosine, 0.0, sine)
    stokes = Stokes(e, light[0], light[1], light[2])
    for number in range(count):
        start_stream(state, seed, 0, number)
        path_lengths[:] = 0.0
        ray = make_ray(ORIGIN, d, stokes, 0.0, FIRST_ROULETTE_DEPTH, NO_MAX_ORDER)
        ray = enter_layer(state, ray, scene, optics)
        if ray.status == ALIVE:
            ray = trace_history(state, ray, scene, optics, path_lengths, None, None)
        out = ray.direction
        q, u = rotate_reference_to(ray.stokes, out, Vector(-out.z * out.x, 0.0, out.x * out.x))
        side = 0 if ray.status == REFLECTED else 1
        for i, value in enumerate((1.0, q, u, ray.stokes.v)):
            sums[0, side, i] += ray.weight * value
            sums[1, side, i] += (ray.weight * value) ** 2
    return sums


@NEEDS_JIT
@pytest.mark.parametrize("name", PLATES)
def test_plates_have_the_matrices_of_added_interfaces(name):
    """I, Q, U and V of reflected and transmitted light of six polarizations at three angles."""
    count, z = scale_sample_size(200_000), []
    for incidence in ANGLES:
        medium = make_stack(PLATES[name])
        scene, optics = build_scene(medium, incidence, False), compute_optics(medium, NM[0])
        matrices = add_interfaces(PLATES[name], incidence)
        for light in LIGHT.values():
            sums = _trace_light(
                len(z), count, np.array(light), scene, optics, np.zeros(optics.n.size)
            )
            mean, square = sums / count
            stderr = np.sqrt(np.maximum(square - mean**2, 0.0) / count)
            expected = np.array([matrix @ np.array([1.0, *light]) for matrix in matrices])
            assert expected[:, 0].sum() == pytest.approx(1.0, abs=1e-14)
            # Without randomness, such as U of light polarized in the plane, values are exact.
            exact = stderr < 1e-12
            assert np.abs(mean - expected)[exact] == pytest.approx(0.0, abs=1e-12)
            z.append((mean - expected)[~exact] / stderr[~exact])
    family = np.concatenate(z)
    # The elements of one light share their rays.
    judge_z(family, f"plates, {name}", independent=len(LIGHT) * len(ANGLES))


@pytest.mark.parametrize("incidence", [0.0, 30.0, 56.3, 75.0, 89.0])
def test_one_face_reflects_by_fresnel(incidence):
    """Every ray of an opaque layer has the reflectance as its weight."""
    for index in (1.2, 1.5, 2.4):
        medium = make_plate(index, opaque=True)
        ds = splits.goniophotometer(medium, NM, incidence, rays=1000, estimator="bins")
        matrix, _ = compute_interface(1.0, index, math.sin(math.radians(incidence)))
        assert float(ds.specular_reflectance[0]) == pytest.approx(matrix[0, 0], rel=1e-12)


@NEEDS_JIT
@pytest.mark.parametrize("polarized", [True, False])
def test_unpolarized_light_at_a_plate(polarized):
    """2 r/(1 + r) of each component with polarization, of the mean reflectance without it."""
    z = []
    for incidence in (40.0, 70.0, 85.0):
        medium = make_plate(1.5) if polarized else splits.ParticleLayer(
            optical_thickness=0.0, refractive_index=1.5, bottom_albedo=None
        )  # fmt: skip
        ds = splits.goniophotometer(medium, NM, incidence, rays=1_000_000, estimator="bins")
        matrix, _ = compute_interface(1.0, 1.5, math.sin(math.radians(incidence)))
        plus, minus = matrix[0, 0], matrix[0, 1]
        components = (plus + minus, plus - minus) if polarized else (plus, plus)
        expected = sum(r / (1.0 + r) for r in components)
        for name, value in (
            ("specular_reflectance", expected), ("direct_transmittance", 1.0 - expected)
        ):  # fmt: skip
            z.append(float((ds[name] - value)[0] / ds[f"{name}_stderr"][0]))
    judge_z(z, f"plate, polarized {polarized}", independent=3)
