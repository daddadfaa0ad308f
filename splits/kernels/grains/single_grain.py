"""One grain met in free pore space: how it deflects rays and what it absorbs, over many rays.

The grain is drawn and followed as in `granular.trace`, but alone: no boundary and no last leg can
reject it (SPLITS 4.3.3-4.3.4).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline
from splits.kernels.grains.free_path import FIRST_ROULETTE_DEPTH, Collision, RouletteState
from splits.kernels.grains.grain_path import trace_through_grain
from splits.kernels.grains.scene import Optics, Scene
from splits.kernels.grains.spheroid import sample_entry_point
from splits.kernels.grains.state import NextEvent, RayPayload, sample_entry_variates, sample_grain
from splits.kernels.math.rng import start_stream, uniform
from splits.kernels.math.vectors import ORIGIN, UP, dot

N_SCATTERING_BATCHES = 16
"""Equal parts of all rays, from which errors of what theories make of them come: to 18 %."""


class ScatteringTally(NamedTuple):
    """Sums over all rays, and over parts of them, see `tally_single_scattering`."""

    sums: np.ndarray
    batches: np.ndarray


class IsolatedGrain(NamedTuple):
    """A grain alone: `wet_probability` is the probability that rays come to it through a wet pore.

    The layer of the scene gives no faces here, only the saturation around the grain.
    """

    wet_probability: float
    scene: Scene
    optics: Optics


@inline
def sample_struck_grain(state, isolated_grain):
    """Draw the grain that a ray along +z strikes."""
    candidate = sample_grain(state, isolated_grain.scene, 0)
    aim = sample_entry_variates(state, candidate.size.flattening)
    hit = sample_entry_point(UP, candidate.size, aim, isolated_grain.scene.rules.entry_sampling)
    return NextEvent(candidate, Collision(0.0, 0.0, hit, False, True, 0.0), 0, False)


@inline
def fill_legendre(x, values):
    """Set `values` (float64[orders]) to the Legendre polynomials P_0(x), P_1(x) and so on."""
    values[0] = 1.0
    if values.size > 1:
        values[1] = x
    for order in range(2, values.size):
        values[order] = (
            (2 * order - 1) * x * values[order - 1] - (order - 1) * values[order - 2]
        ) / order


@entry_point
def tally_single_scattering(seed, work, n_orders, isolated_grain, absorption):
    """Let rays meet one grain each and tally their directions by weight.

    Parameters
    ----------
    seed : int
    work : int64[3]
        Ensemble, first ray, number of rays; they name the random streams, as in `granular.batch`.
    n_orders : int
        Legendre polynomials to tally.
    isolated_grain : IsolatedGrain
        Its optics' absorption bounds `absorption` from below.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m) that turn path lengths in the grain into weights.

    Returns
    -------
    sums : float64[3, orders + 4, wavelengths]
        Over rays, with w the weight: Σ w x, Σ w² x and Σ w² x², where x are first the Legendre
        polynomials P_l(cosΘ) of the angle of scattering Θ; then, with δ the way from entry to exit
        point (m) and d, d' the directions before and after, δ·d, δ·d' and δ·δ; and at last 1 if
        the ray leaves into a wet pore, or 0.
    parts : float64[PARTS, orders + 4, wavelengths]
        Σ w x over every so many rays.
    """
    sums = np.zeros((3, n_orders + 4, absorption.shape[0]))
    parts = np.zeros((N_SCATTERING_BATCHES, n_orders + 4, absorption.shape[0]))
    told = np.zeros(n_orders + 4)
    saturation = isolated_grain.scene.layers.saturation[0]
    length = np.zeros(absorption.shape[1])
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[1], work[1] + work[2]):
        start_stream(state, seed, work[0], number)
        length[:] = 0.0
        purse = RouletteState(0.0, FIRST_ROULETTE_DEPTH, 1.0)
        # A pore is wet where its number lies below the saturation.
        beam = RayPayload(
            UP, 0, 0.0 if uniform(state) < isolated_grain.wet_probability else 1.0, purse
        )
        found = sample_struck_grain(state, isolated_grain)
        walked = trace_through_grain(
            state, beam, found, isolated_grain.scene, isolated_grain.optics, length
        )
        if not walked.alive:
            continue
        d = walked.payload.direction
        way = ORIGIN if isolated_grain.scene.rules.point_grains else walked.displacement
        # Rounding may carry the cosine past 1, which high orders would amplify.
        fill_legendre(min(1.0, max(-1.0, d.z)), told[:n_orders])
        told[n_orders] = way.z
        told[n_orders + 1] = dot(way, d)
        told[n_orders + 2] = dot(way, way)
        told[n_orders + 3] = 1.0 if walked.payload.pore_variate < saturation else 0.0
        score_ray(
            told,
            length,
            walked.payload.roulette.weight,
            absorption,
            sums,
            parts[number % N_SCATTERING_BATCHES],
        )
    return ScatteringTally(sums, parts)


@inline
def score_ray(scores, path_lengths, weight, absorption, sums, batch_sums):
    """Add what a ray told to the sums, with its weight at every wavelength."""
    for i in range(absorption.shape[0]):
        depth = 0.0
        for material in range(absorption.shape[1]):
            depth += absorption[i, material] * path_lengths[material]
        w = weight * math.exp(-depth)
        for j in range(scores.size):
            wx = w * scores[j]
            sums[0, j, i] += wx
            sums[1, j, i] += w * wx
            sums[2, j, i] += wx * wx
            batch_sums[j, i] += wx
