"""One grain met in free pore space: how it deflects rays and what it absorbs, over many rays.

The grain is drawn and followed as in `granular.trace`, but alone: no boundary and no last leg can
reject it (SPLITS 4.3.3-4.3.4).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.transport.compiling.jit import entry, kernel
from splits.transport.grains.flight import FIRST_ROULETTE, Meeting, Purse
from splits.transport.grains.scalar import Beam, Found, aim_of, candidate_of
from splits.transport.grains.scene import Optics, Scene
from splits.transport.grains.spheroid import strike
from splits.transport.grains.walk import walk
from splits.transport.numerics.rng import start_stream, uniform
from splits.transport.numerics.vectors import ORIGIN, UP, dot

PARTS = 16
"""Equal parts of all rays, from which errors of what theories make of them come: to 18 %."""


class Tallied(NamedTuple):
    """Sums over all rays, and over parts of them, see `scatter`."""

    sums: np.ndarray
    parts: np.ndarray


class Solitary(NamedTuple):
    """A grain alone: `wet` is the probability that rays come to it through a wet pore.

    The layer of the scene gives no faces here, only the saturation around the grain.
    """

    wet: float
    scene: Scene
    optics: Optics


@kernel
def met(state, solitary):
    """Draw the grain that a ray along +z strikes."""
    candidate = candidate_of(state, solitary.scene, 0)
    aim = aim_of(state, candidate.size.flattening)
    hit = strike(UP, candidate.size, aim, solitary.scene.rules.entry)
    return Found(candidate, Meeting(0.0, 0.0, hit, False, True, 0.0), 0, False)


@kernel
def legendre(x, values):
    """Set `values` (float64[orders]) to the Legendre polynomials P_0(x), P_1(x) and so on."""
    values[0] = 1.0
    if values.size > 1:
        values[1] = x
    for order in range(2, values.size):
        values[order] = (
            (2 * order - 1) * x * values[order - 1] - (order - 1) * values[order - 2]
        ) / order


@entry
def scatter(seed, work, orders, solitary, absorption):
    """Let rays meet one grain each and tally their directions by weight.

    Parameters
    ----------
    seed : int
    work : int64[3]
        Ensemble, first ray, number of rays; they name the random streams, as in `granular.batch`.
    orders : int
        Legendre polynomials to tally.
    solitary : Solitary
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
    sums = np.zeros((3, orders + 4, absorption.shape[0]))
    parts = np.zeros((PARTS, orders + 4, absorption.shape[0]))
    told = np.zeros(orders + 4)
    saturation = solitary.scene.layers.saturation[0]
    length = np.zeros(absorption.shape[1])
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[1], work[1] + work[2]):
        start_stream(state, seed, work[0], number)
        length[:] = 0.0
        purse = Purse(0.0, FIRST_ROULETTE, 1.0)
        # A pore is wet where its number lies below the saturation.
        beam = Beam(UP, 0, 0.0 if uniform(state) < solitary.wet else 1.0, purse)
        found = met(state, solitary)
        walked = walk(state, beam, found, solitary.scene, solitary.optics, length)
        if not walked.alive:
            continue
        d = walked.beam.d
        way = ORIGIN if solitary.scene.rules.point_grains else walked.way
        # Rounding may carry the cosine past 1, which high orders would amplify.
        legendre(min(1.0, max(-1.0, d.z)), told[:orders])
        told[orders] = way.z
        told[orders + 1] = dot(way, d)
        told[orders + 2] = dot(way, way)
        told[orders + 3] = 1.0 if walked.beam.u < saturation else 0.0
        add(told, length, walked.beam.purse.weight, absorption, sums, parts[number % PARTS])
    return Tallied(sums, parts)


@kernel
def add(told, length, weight, absorption, sums, part):
    """Add what a ray told to the sums, with its weight at every wavelength."""
    for i in range(absorption.shape[0]):
        depth = 0.0
        for material in range(absorption.shape[1]):
            depth += absorption[i, material] * length[material]
        w = weight * math.exp(-depth)
        for j in range(told.size):
            wx = w * told[j]
            sums[0, j, i] += wx
            sums[1, j, i] += w * wx
            sums[2, j, i] += wx * wx
            part[j, i] += wx
