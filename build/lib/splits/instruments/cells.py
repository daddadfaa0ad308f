"""A goniophotometer's collectors: cells of equal solid angle, the papers' estimator.

SPLITSnow Eq 7: the BRDF of a cell is the share of rays that it collects over its projected solid
angle.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.instruments import streams
from splits.instruments.angular import BIAS, Estimate, missed_of_totals
from splits.instruments.ensemble import Level
from splits.instruments.runner import BATCH
from splits.transport.grains.scene import shared_optics
from splits.transport.sums.directions import count_cells

CELLS_OF_5_DEG = (18, 72)
"""Cells between horizon and zenith, and around: as many as 5° by 5° would be."""

Sums = tuple[np.ndarray, np.ndarray]
"""What a batch yields: sums by cells, sums of weights that met no grain."""


class Cells:
    """Paths traced with one set of refractive indices, collected by cells.

    Parameters
    ----------
    number : int
        Names the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Absorption coefficients (1/m) of all wavelengths.
    weights : float, shape (wavelengths,)
        How much each wavelength draws on this ensemble.
    shape : (int, int)
        Cells between horizon and zenith, and around.
    stokes : sequence of int
        Columns of exits that hold Q, U, V over I, or nothing.

    Attributes
    ----------
    levels : list of Level
        One: every ray is followed to its end.
    """

    def __init__(
        self,
        number: int,
        index: np.ndarray,
        absorption: np.ndarray,
        weights: np.ndarray,
        shape: tuple[int, int],
        stokes: Sequence[int] = (),
    ) -> None:
        self.absorption = absorption
        self.weights = weights
        self.shape = shape
        self.parts = (-1, *stokes)
        self.sums = np.zeros((len(self.parts), 2, 2, len(absorption), *shape))
        self.straight = np.zeros((2, 2, len(absorption)))
        served = weights > 0.0
        optics = shared_optics(index, absorption[served])
        self.levels = [Level(streams.CELLS + number, optics, served, 400.0)]

    def size(self) -> int:
        """Return how many numbers a tally holds."""
        return int(self.sums.size + self.straight.size)

    def tally(self, level: Level, first: int, exits: np.ndarray, notes: np.ndarray) -> Sums:
        """Return the sums of a batch of exits."""
        found = [count_cells(exits, self.absorption, *self.shape, part) for part in self.parts]
        return np.stack([sums for sums, _ in found]), found[0][1]

    def add(self, level: Level, tallies: Sequence[Sums]) -> None:
        """Add the sums of batches one by one: they do not depend on who traced them."""
        level.rays += BATCH * len(tallies)
        for sums, straight in tallies:
            self.sums += sums
            self.straight += straight


def centres(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the polar and azimuth angles (degrees) of the middle of cells, from the zenith on."""
    polar, azimuth = shape
    cosine = (np.arange(polar)[::-1] + 0.5) / polar
    return np.degrees(np.arccos(cosine)), np.arange(azimuth) * (360.0 / azimuth)


def estimate_cells(ensembles: Sequence[Cells], bias: np.ndarray) -> Estimate:
    """Estimate BRDF and BTDF of every cell, from the zenith on.

    Parameters
    ----------
    ensembles : sequence of Cells
    bias : float, shape (wavelengths,)
        See `splits.instruments.nodes.Nodes`.
    """
    polar, azimuth = ensembles[0].shape
    mean, stderr = _means(ensembles, 0)
    sums = np.zeros((4, 2, len(bias)))
    for e in ensembles:
        share = 1.0 / e.levels[0].rays
        whole = e.sums[0].sum(axis=(-2, -1)) + e.straight
        for row, part in ((0, whole), (2, e.straight)):
            sums[row] += e.weights * share * part[0]
            sums[row + 1] += (e.weights * share) ** 2 * (part[1] - share * part[0] ** 2)
    sums[1::2] = np.sqrt(np.maximum(sums[1::2], 0.0))
    sums[1::2] = np.hypot(sums[1::2], missed_of_totals(bias, sums[::2]))
    missed = BIAS * bias[:, np.newaxis, np.newaxis] * mean
    shape = (2, len(bias), polar * azimuth)
    stderr = np.hypot(stderr, missed).reshape(shape)
    return Estimate(
        mean.reshape(shape),
        stderr,
        stderr,
        sums,
        np.zeros((2, len(bias)), dtype=int),
        np.zeros(shape),
    )


def stokes_of_cells(ensembles: Sequence[Cells]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return Q, U and V of BRDF and BTDF with their errors, by name, where exits tell them."""
    found = {}
    for place, name in enumerate("quv"[: len(ensembles[0].parts) - 1], start=1):
        pair = _means(ensembles, place)
        for side, function in enumerate(("brdf", "btdf")):
            mean, stderr = (x[side].reshape(len(x[side]), -1) for x in pair)
            found[f"{function}_{name}"] = (mean, stderr)
    return found


def _projected(shape: tuple[int, int]) -> np.ndarray:
    """Return the projected solid angle of cells from the zenith on, shape (polar, 1)."""
    polar, azimuth = shape
    edges = np.arange(polar + 1) / polar
    return (np.pi / azimuth * np.diff(edges**2))[::-1, np.newaxis]


def _means(ensembles: Sequence[Cells], part: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a distribution function and its standard errors, from the zenith on."""
    mean, variance = np.zeros((2, *ensembles[0].sums.shape[2:]))
    for e in ensembles:
        share, weights = 1.0 / e.levels[0].rays, e.weights[:, np.newaxis, np.newaxis]
        total, square = e.sums[part]
        mean += weights * share * total
        variance += weights**2 * share**2 * (square - share * total**2)
    projected = _projected(ensembles[0].shape)
    # An empty cell is not certain: as if a ray had come.
    unseen = max(1.0 / e.levels[0].rays for e in ensembles)
    stderr = np.where(variance > 0.0, np.sqrt(np.maximum(variance, 0.0)), unseen)
    return mean[:, :, ::-1] / projected, stderr[:, :, ::-1] / projected
