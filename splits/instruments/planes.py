"""Paths that are listened to at planes in a sample: ensembles, and what they tell by group."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.instruments import streams
from splits.instruments.ensemble import GROUPS, LEVELS, Level, Manner, levels_of
from splits.transport.sums.passages import Passages, passages

BATCH = 32
"""Rays whose weights are added up together: few, so that a first round of every group is short."""
ROUND = BATCH * GROUPS
"""Rays of which every group gets as many."""
NOTES_A_FACE = 4
"""Passages of a face to expect of a ray, for the memory that a job takes."""

Sums = tuple[int, Passages]
"""What a batch yields: its group, and sums over its rays."""


class Told(NamedTuple):
    """Means by group of rays.

    Attributes
    ----------
    light : float, shape (GROUPS, 2, faces, wavelengths)
        Of light that passes a face, downwards and upwards; at the top, what comes counts.
    absorbed : float, shape (GROUPS, layers, materials, wavelengths)
    way : float, shape (GROUPS, layers, wavelengths)
        Metres.
    """

    light: np.ndarray
    absorbed: np.ndarray
    way: np.ndarray


class Planes:
    """Paths traced with one set of refractive indices, listened to at the faces of all layers.

    Parameters
    ----------
    number : int
        Names the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
    served : bool, shape (wavelengths,)
    manner : Manner
    layers : int
    fractions : float, shape (materials,)
        Path over recorded length, see `splits.media.granular.path_fractions`.
    """

    def __init__(
        self,
        number: int,
        index: np.ndarray,
        absorption: np.ndarray,
        served: np.ndarray,
        manner: Manner,
        layers: int,
        fractions: np.ndarray,
    ) -> None:
        self.absorption = absorption
        self.fractions = fractions
        self.manner = manner
        self.layers = layers
        self.count = np.zeros(len(absorption))
        wavelengths, materials = absorption.shape
        self.light = np.zeros((GROUPS, 2, layers + 1, wavelengths))
        self.absorbed = np.zeros((GROUPS, layers, materials, wavelengths))
        self.way = np.zeros((GROUPS, layers, wavelengths))
        first = streams.PLANES + number * len(LEVELS)
        self.levels = levels_of(first, index, absorption, served, manner, LEVELS)

    def size(self) -> int:
        """Return how many numbers a tally and the notes of a batch hold."""
        wavelengths, materials = self.absorption.shape
        notes = BATCH * NOTES_A_FACE * self.layers * (materials + 3)
        return notes + self.layers * (3 + materials) * wavelengths

    def tally(self, level: Level, first: int, exits: np.ndarray, notes: np.ndarray) -> Sums:
        """Return the sums of a batch of `BATCH` rays of a level."""
        absorption = self.absorption[level.served]
        ground = self.manner.ground
        sums = passages(exits, notes, absorption, self.fractions, self.layers, ground)
        return (first // BATCH) % GROUPS, sums

    def add(self, level: Level, tallies: Sequence[Sums]) -> None:
        """Add the sums of batches one by one: they do not depend on who added them."""
        served = level.served
        level.rays += BATCH * len(tallies)
        self.count[served] += BATCH * len(tallies)
        for group, sums in tallies:
            self.light[group][..., served] += sums.light
            self.absorbed[group][..., served] += sums.absorbed
            self.way[group][..., served] += sums.way

    def told(self) -> Told:
        """Return the means of every group, zero where no ray was traced."""
        each = np.maximum(self.count, 1.0) / GROUPS
        light = self.light / each
        light[:, 0, 0] = self.count > 0.0
        return Told(light, self.absorbed / each, self.way / each)
