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

    irradiance: np.ndarray
    absorptance: np.ndarray
    path_length: np.ndarray


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
        stream_index: int,
        index: np.ndarray,
        absorption: np.ndarray,
        wavelength_mask: np.ndarray,
        traits: Manner,
        n_layers: int,
        path_fractions: np.ndarray,
    ) -> None:
        self.absorption = absorption
        self.path_fractions = path_fractions
        self.traits = traits
        self.n_layers = n_layers
        self.n_rays = np.zeros(len(absorption))
        wavelengths, materials = absorption.shape
        self.irradiance_sums = np.zeros((GROUPS, 2, n_layers + 1, wavelengths))
        self.absorptance_sums = np.zeros((GROUPS, n_layers, materials, wavelengths))
        self.path_length_sums = np.zeros((GROUPS, n_layers, wavelengths))
        first = streams.PLANES + stream_index * len(LEVELS)
        self.strata = levels_of(first, index, absorption, wavelength_mask, traits, LEVELS)

    def count_score_values(self) -> int:
        """Return how many numbers a tally and the notes of a batch hold."""
        wavelengths, materials = self.absorption.shape
        notes = BATCH * NOTES_A_FACE * self.n_layers * (materials + 3)
        return notes + self.n_layers * (3 + materials) * wavelengths

    def score_chunk(self, stratum: Level, first_ray: int, exits: np.ndarray, crossings: np.ndarray) -> Sums:
        """Return the sums of a batch of `BATCH` rays of a level."""
        absorption = self.absorption[stratum.wavelength_mask]
        ground = self.traits.ground_column
        sums = passages(exits, crossings, absorption, self.path_fractions, self.n_layers, ground)
        return (first_ray // BATCH) % GROUPS, sums

    def add_scores(self, stratum: Level, scores: Sequence[Sums]) -> None:
        """Add the sums of batches one by one: they do not depend on who added them."""
        served = stratum.wavelength_mask
        stratum.n_rays += BATCH * len(scores)
        self.n_rays[served] += BATCH * len(scores)
        for group, sums in scores:
            self.irradiance_sums[group][..., served] += sums.boundary_weight
            self.absorptance_sums[group][..., served] += sums.absorbed
            self.path_length_sums[group][..., served] += sums.path_length

    def compute_batch_means(self) -> Told:
        """Return the means of every group, zero where no ray was traced."""
        each = np.maximum(self.n_rays, 1.0) / GROUPS
        light = self.irradiance_sums / each
        light[:, 0, 0] = self.n_rays > 0.0
        return Told(light, self.absorptance_sums / each, self.path_length_sums / each)
