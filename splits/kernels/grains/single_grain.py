"""Single scattering and absorption by an isolated grain, tallied over many rays.

The grain is sampled and traced as in `history.trace_rays`, but alone: no boundary and no previous
path segment can reject it (SPLITS 4.3.3-4.3.4).
"""

from __future__ import annotations

import numpy as np

from splits.kernels.arithmetic import dot, linear_combination
from splits.kernels.compiler.jit import entry_point, inline
from splits.kernels.grains.grain_path import (
    sample_entry_variates,
    sample_grain,
    trace_through_grain,
)
from splits.kernels.grains.spheroid import FIRST_ROULETTE_DEPTH, sample_entry_point
from splits.kernels.phase_function import find_interval
from splits.kernels.rays import make_ray
from splits.kernels.records import (
    N_ELEMENTS,
    N_MATRIX_BATCHES,
    N_SCATTERING_BATCHES,
    ScatteringSums,
)
from splits.kernels.rng import start_stream, uniform
from splits.kernels.scene import (
    ALIVE,
    FIRST_RAY,
    MAX_ORDER,
    N_RAYS,
    ORIGIN,
    STREAM,
    UP,
    Stokes,
    Vector,
)
from splits.kernels.stokes import compute_azimuth, make_unpolarized, rotate_reference_to
from splits.kernels.tallies.exits import compute_path_weight


@inline
def sample_hit_grain(state, isolated_grain):
    """Sample the grain that a ray along +z hits, and its entry point."""
    grain_sample = sample_grain(state, isolated_grain.scene, 0)
    variates = sample_entry_variates(state, grain_sample.size)
    entry = sample_entry_point(
        UP, grain_sample.size, variates, isolated_grain.scene.rules.entry_sampling
    )
    return grain_sample, entry


@inline
def fill_legendre(x, values):
    """Set `values` (float64[orders]) to the Legendre polynomials P_0(x), P_1(x) and so on."""
    values[0] = 1.0
    if values.size > 1:
        values[1] = x
    # Bonnet's recurrence, stable upwards in the order.
    for order in range(2, values.size):
        values[order] = (
            (2 * order - 1) * x * values[order - 1] - (order - 1) * values[order - 2]
        ) / order


@entry_point
def tally_single_scattering(seed, work, orders, isolated_grain, absorption):
    """Trace rays through one grain each, and tally their directions by weight.

    Parameters
    ----------
    seed : int
    work : int64[4]
        See `splits.kernels.scene`.
    orders : (int, int)
        Numbers of Legendre polynomials to tally, for all rays and for those that leave into a wet
        pore, at least 1 each.
    isolated_grain : IsolatedGrain
        The absorption of its optics is a lower bound of `absorption`.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m), which convert path lengths in the grain to weights.

    Returns
    -------
    sums : float64[3, scores, wavelengths]
        Over rays, with w the weight: Σ w x, Σ w² x and Σ w² x², where x are the Legendre
        polynomials P_l(cosΘ) of the scattering angle Θ; then, with δ the displacement from entry to
        exit point (m) and d, d' the directions before and after, δ·d, δ·d' and δ·δ; and P_l(cosΘ)
        again if the ray leaves into a wet pore, or 0.
    batches : float64[N_SCATTERING_BATCHES, scores, wavelengths]
        Σ w x over each batch.
    """
    n_orders, n_wet_orders = orders
    n_scores = n_orders + 3 + n_wet_orders
    sums = np.zeros((3, n_scores, absorption.shape[0]))
    batches = np.zeros((N_SCATTERING_BATCHES, n_scores, absorption.shape[0]))
    scores = np.zeros(n_scores)
    wet_fraction = isolated_grain.scene.layers.wet_fraction[0]
    path_lengths = np.zeros(absorption.shape[1])
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[FIRST_RAY], work[FIRST_RAY] + work[N_RAYS]):
        start_stream(state, seed, work[STREAM], number)
        path_lengths[:] = 0.0
        # A pore is wet if its variate is below the wet fraction.
        pore_variate = 0.0 if uniform(state) < isolated_grain.wet_probability else 1.0
        light = make_unpolarized(UP, isolated_grain.scene.stokes)
        ray = make_ray(ORIGIN, UP, light, pore_variate, FIRST_ROULETTE_DEPTH, work[MAX_ORDER])
        grain_sample, entry = sample_hit_grain(state, isolated_grain)
        ray = trace_through_grain(
            state,
            ray,
            grain_sample,
            entry,
            isolated_grain.scene,
            isolated_grain.optics,
            path_lengths,
        )
        if ray.status != ALIVE:
            continue
        d = ray.direction
        displacement = ORIGIN if isolated_grain.scene.rules.point_grains else ray.exit_offset
        # Rounding may bring the cosine above 1, which high orders would amplify.
        fill_legendre(min(1.0, max(-1.0, d.z)), scores[:n_orders])
        scores[n_orders] = displacement.z
        scores[n_orders + 1] = dot(displacement, d)
        scores[n_orders + 2] = dot(displacement, displacement)
        is_wet = 1.0 if ray.pore_variate < wet_fraction else 0.0
        for order in range(n_wet_orders):
            scores[n_orders + 3 + order] = is_wet * scores[order]
        score_ray(
            scores,
            path_lengths,
            ray.weight,
            absorption,
            sums,
            batches[number % N_SCATTERING_BATCHES],
        )
    return ScatteringSums(sums, batches)


@inline
def score_ray(scores, path_lengths, weight, absorption, sums, batch_sums):
    """Add the scores of a ray to the sums, with its weight at every wavelength."""
    for i in range(absorption.shape[0]):
        w = compute_path_weight(path_lengths, weight, absorption, i)
        for j in range(scores.size):
            wx = w * scores[j]
            sums[0, j, i] += wx
            sums[1, j, i] += w * wx
            sums[2, j, i] += wx * wx
            batch_sums[j, i] += wx


# --------------------------------------------------------------------------------------------------
# Scattering matrix of isolated grains, tallied over the scattering angle.
#
# Rays have linearly or circularly polarized light.  With the azimuth φ of the scattering plane from
# the direction of linear polarization, the light scattered into that plane has
#
#     I = P11 + P12 cos2φ,   Q = P12 + P22 cos2φ,   U = −P33 sin2φ,   V = P34 sin2φ
#
# for linear, and I = P11, Q = P12, U = P34, V = P44 for circular polarization.

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
        See `splits.kernels.scene`.
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
