"""Records and sums that kernels fill: their columns, batches and shapes.

Nothing here is compiled, as in `splits.kernels.scene`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from splits.kernels.scene import Optics, Scene

# --------------------------------------------------------------------------------------------------
# Records of rays that cross layer boundaries or hit the ground, see `tallies/exits.py`.

CROSSING_RAY = 0
"""Column of the ray, as its row in the exits."""


CROSSING_CODE = 1
"""Column of the code, see `encode_crossing`."""


CROSSING_WEIGHT = 2
"""Column of the statistical weight without absorption in materials."""


CROSSING_LENGTH = 3
"""First of the columns of path lengths (m), one per material, and of the number of ground hits."""


# --------------------------------------------------------------------------------------------------
# Records of exits, and sums of their weights.

EXIT_SIDE = 0
"""Column of the side: 0 reflected, 1 transmitted, −1 for rays that did not leave."""


EXIT_WEIGHT = 1
"""Column of the statistical weight without absorption in materials."""


EXIT_ORDER = 2
"""Column of the order of scattering: collisions with grains and particles, and hits of facets of a
rough surface and of the ground.  NaN for rays without an exit."""


EXIT_DIRECTION = 3
"""First of three columns: direction outside the slab."""


EXIT_POSITION = 6
"""First of two columns: horizontal position (m); NaN for rays without an exit."""


EXIT_LENGTH = 8
"""First of the columns of path lengths (m), one per material."""


N_STOKES_COLUMNS = 3
"""Columns of Q, U, V over I of polarized exits, after the path lengths."""


BLOCK_SIZE = 8
"""Successive rays with separate sums, whose scatter gives the correlation of errors."""


N_BATCHES = 32
"""Batches of rays with separate means.  Blocks of successive rays are assigned to them in turn, so
that even the smallest first round of a stratum reaches all.  The relative uncertainty of a standard
error from 32 batches is 13 %."""


class TraceResult(NamedTuple):
    """Result of a kernel call besides its exits or scores: its cost and the crossing records.

    Attributes
    ----------
    n_segments : int64[items]
        Path segments of each work item, a measure of the cost.
    lost : bool
        The call ended early because a ray was lost.
    crossings : float64[crossings, columns], or None
        Records of crossings; None from kernels that record none.
    """

    n_segments: np.ndarray
    lost: bool
    crossings: Any


class WeightSums(NamedTuple):
    """Sums of the weights of rays at every wavelength.

    Attributes
    ----------
    moments : float64[3, 3, wavelengths]
        Over rays, [reflected, transmitted, both][Σ weight, Σ weight², largest weight].
    min_weight : float64[wavelengths]
        Smallest exit weight of any ray; 0 if one did not leave.
    blocks : float32[blocks, 2, wavelengths]
        Σ weight of every `BLOCK_SIZE` successive rays; the last block may have fewer.  Blocks in
        excess of `N_BATCHES` are added to the first ones in turn.
    """

    moments: np.ndarray
    min_weight: np.ndarray
    blocks: np.ndarray


def allocate_exits(n_rays: int, n_materials: int, n_extra_columns: int = 0) -> np.ndarray:
    """Return empty exit records, float64[rays, columns].

    Parameters
    ----------
    n_rays, n_materials : int
    n_extra_columns : int, optional
        Further columns of a kernel after those of the materials.
    """
    rows = np.full((n_rays, EXIT_LENGTH + n_materials + n_extra_columns), np.nan)
    rows[:, EXIT_SIDE] = -1.0
    return rows


# --------------------------------------------------------------------------------------------------
# Sums over rays through an isolated grain.

N_SCATTERING_BATCHES = 16
"""Batches of rays for the standard errors of derived quantities, known to 18 %."""


class ScatteringSums(NamedTuple):
    """Sums over all rays and over batches of rays, see `tally_single_scattering`."""

    sums: np.ndarray
    batches: np.ndarray


class IsolatedGrain(NamedTuple):
    """Isolated grain, which rays reach through a wet pore with `wet_probability`.

    Of the layer of the scene only the wet_fraction is used, not the boundaries.  Rays are polarized
    if the scene is; the incident light is not.
    """

    wet_probability: float
    scene: Scene
    optics: Optics


N_ELEMENTS = 6


N_MATRIX_BATCHES = 32
"""Batches of rays for standard errors, known to 13 %."""


# --------------------------------------------------------------------------------------------------
# Polynomials and sums of angular distributions, see `tallies/distributions.py`.


class DiskBasis(NamedTuple):
    """Polynomials up to a degree, by increasing m and, for each m, increasing l.

    Attributes
    ----------
    n_per_m : int64[…]
        Polynomials for each m from 0 on.
    degrees : int64[polynomials]
        n = m + 2l.
    norms : float64[polynomials]
        Normalization factors.
    recurrence_slope, recurrence_offset, recurrence_previous : float64[polynomials]
        P_l = (slope·t + offset)·P_(l−1) − previous·P_(l−2).
    """

    n_per_m: np.ndarray
    degrees: np.ndarray
    norms: np.ndarray
    recurrence_slope: np.ndarray
    recurrence_offset: np.ndarray
    recurrence_previous: np.ndarray


class AngularSums(NamedTuple):
    """Sums over scattered rays, by direction, and over unscattered rays."""

    scattered: np.ndarray
    unscattered: np.ndarray


def make_basis(degree: int) -> DiskBasis:
    """Return the polynomials up to a degree (DLMF 18.9.2 with α = m and β = 1)."""
    rows = [(m, i) for m in range(degree + 1) for i in range((degree - m) // 2 + 1)]
    m, i = np.array(rows, dtype=float).T
    # ∫ (1 − μ)^m μ P² dμ is (l + 1) / ((2l + m + 2)(l + m + 1)); cosines give π, or 2π for m = 0.
    azimuth_integral = np.where(m == 0.0, 2.0 * np.pi, np.pi)
    scale = np.sqrt((2.0 * i + m + 2.0) * (i + m + 1.0) / ((i + 1.0) * azimuth_integral))
    denominator = 2.0 * i * (i + m + 1.0) * (2.0 * i + m - 1.0)
    # The first two need no recurrence, which would divide by 0.
    denominator = np.where(i < 2, 1.0, denominator)
    slope = (2.0 * i + m) * (2.0 * i + m + 1.0) * (2.0 * i + m - 1.0) / denominator
    offset = (2.0 * i + m) * (m * m - 1.0) / denominator
    previous = 2.0 * (i + m - 1.0) * i * (2.0 * i + m + 1.0) / denominator
    slope = np.where(i == 1, 0.5 * (m + 3.0), slope)
    offset = np.where(i == 1, 0.5 * (m - 1), offset)
    previous = np.where(i == 1, 0.0, previous)
    per_m = np.array([(degree - k) // 2 + 1 for k in range(degree + 1)])
    return DiskBasis(per_m, (m + 2 * i).astype(np.int64), scale, slope, offset, previous)
