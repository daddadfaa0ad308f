"""Scattering matrix of isolated grains, tallied over the scattering angle.

Rays have linearly or circularly polarized light.  With the azimuth φ of the scattering plane from
the direction of linear polarization, the light scattered into that plane has

    I = P11 + P12 cos2φ,   Q = P12 + P22 cos2φ,   U = −P33 sin2φ,   V = P34 sin2φ

for linear, and I = P11, Q = P12, U = P34, V = P44 for circular polarization.
"""

from __future__ import annotations

import numpy as np

from splits.kernels.base.ray import ALIVE, make_ray
from splits.kernels.base.work import FIRST_RAY, MAX_ORDER, N_RAYS, STREAM
from splits.kernels.compiler.jit import entry_point, inline
from splits.kernels.grains.free_path import FIRST_ROULETTE_DEPTH
from splits.kernels.grains.grain_path import trace_through_grain
from splits.kernels.grains.single_grain import sample_hit_grain
from splits.kernels.math.rng import start_stream, uniform
from splits.kernels.math.vectors import ORIGIN, UP, Vector, linear_combination
from splits.kernels.optics.phase_function import find_interval
from splits.kernels.optics.stokes import Stokes, compute_azimuth, rotate_reference_to
from splits.kernels.tallies.exits import compute_path_weight

N_ELEMENTS = 6
N_MATRIX_BATCHES = 32
"""Batches of rays for standard errors, known to 13 %."""
_ALONG_X, _ALONG_Y = Vector(1.0, 0.0, 0.0), Vector(0.0, 1.0, 0.0)


@inline
def evaluate_elements(ray, is_linear, scores):
    """Set `scores` (float64[6]) to estimates of P11, P12, P33, P34, P22 and P44 by one ray.

    Elements that only half of the rays estimate have twice the score.
    """
    d, stokes = ray.direction, ray.stokes
    azimuth = compute_azimuth(d, _ALONG_X, _ALONG_Y)
    cos2 = (azimuth.cos - azimuth.sin) * (azimuth.cos + azimuth.sin)
    sin2 = 2.0 * azimuth.cos * azimuth.sin
    plane = Vector(azimuth.cos, azimuth.sin, 0.0)
    reference = linear_combination(d.z, plane, -azimuth.sin_polar, UP)
    q, u = rotate_reference_to(stokes, d, reference)
    scores[0], scores[1] = 1.0, q
    if is_linear:
        scores[2], scores[3], scores[4] = -4.0 * sin2 * u, 2.0 * sin2 * stokes.v, 4.0 * cos2 * q
        scores[5] = 0.0
    else:
        scores[2], scores[3], scores[4] = 0.0, u, 0.0
        scores[5] = 2.0 * stokes.v


@entry_point
def tally_scattering_matrix(seed, work, cosines, isolated_grain, absorption):
    """Trace polarized rays through one grain each, and tally the elements of its matrix.

    Parameters
    ----------
    seed : int
    work : int64[4]
        See `splits.kernels.base.work`.
    cosines : float64[nodes]
        Cosines of scattering angles, rising from −1 to 1.  Each ray is divided between the two
        nodes around it, in proportion to its distance from the other.
    isolated_grain : IsolatedGrain
        The absorption of its optics is a lower bound of `absorption`.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m), which convert path lengths in the grain to weights.

    Returns
    -------
    float64[N_MATRIX_BATCHES, 6, wavelengths, nodes]
        Sums over rays of P11, P12, P33, P34, P22 and P44, times the integral over a node's solid
        angle.
    """
    sums = np.zeros((N_MATRIX_BATCHES, N_ELEMENTS, absorption.shape[0], cosines.size))
    scores = np.zeros(N_ELEMENTS)
    path_lengths = np.zeros(absorption.shape[1])
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[FIRST_RAY], work[FIRST_RAY] + work[N_RAYS]):
        start_stream(state, seed, work[STREAM], number)
        path_lengths[:] = 0.0
        is_linear = (number // N_MATRIX_BATCHES) % 2 == 0
        linear = 1.0 if is_linear else 0.0
        light = Stokes(_ALONG_X, linear, 0.0, 1.0 - linear)
        # A pore is wet if its variate is below the wet fraction.
        pore_variate = 0.0 if uniform(state) < isolated_grain.wet_probability else 1.0
        ray = make_ray(ORIGIN, UP, light, pore_variate, FIRST_ROULETTE_DEPTH, work[MAX_ORDER])
        grain_sample, entry = sample_hit_grain(state, isolated_grain)
        ray = trace_through_grain(
            state, ray, grain_sample, entry, isolated_grain.scene, isolated_grain.optics,
            path_lengths,
        )  # fmt: skip
        if ray.status != ALIVE:
            continue
        evaluate_elements(ray, is_linear, scores)
        mu = min(1.0, max(-1.0, ray.direction.z))
        node = find_interval(cosines, mu)
        above = (mu - cosines[node]) / (cosines[node + 1] - cosines[node])
        batch = sums[number % N_MATRIX_BATCHES]
        for i in range(absorption.shape[0]):
            weight = compute_path_weight(path_lengths, ray.weight, absorption, i)
            for j in range(N_ELEMENTS):
                batch[j, i, node] += (1.0 - above) * weight * scores[j]
                batch[j, i, node + 1] += above * weight * scores[j]
    return sums
