"""Paths that are listened to at planes in a sample: ensembles, and what they tell by group."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.kernels.tallies.flux import FluxTally, tally_flux
from splits.simulation import random_streams
from splits.simulation.tally import (
    N_BATCHES,
    STRATUM_BOUNDS,
    Stratum,
    TransportTraits,
    make_strata,
)

FLUX_RAYS_PER_CHUNK = 32
"""Rays whose weights are added up together: few, so that a first round of every group is short."""
FLUX_RAYS_PER_ROUND = FLUX_RAYS_PER_CHUNK * N_BATCHES
"""Rays of which every group gets as many."""
CROSSINGS_PER_BOUNDARY = 4
"""Passages of a face to expect of a ray, for the memory that a job takes."""

FluxScore = tuple[int, FluxTally]
"""What a batch yields: its group, and sums over its rays."""


class FluxByBatch(NamedTuple):
    """Means by batch of rays.

    Attributes
    ----------
    irradiance : float, shape (GROUPS, 2, faces, wavelengths)
        Of light that passes a face, downwards and upwards; at the top, what comes counts.
    absorptance : float, shape (GROUPS, layers, materials, wavelengths)
    path_length : float, shape (GROUPS, layers, wavelengths)
        Metres.
    """

    irradiance: np.ndarray
    absorptance: np.ndarray
    path_length: np.ndarray


class FluxPathTally:
    """Paths traced with one set of refractive indices, listened to at the faces of all layers.

    Parameters
    ----------
    number : int
        Names the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
    served : bool, shape (wavelengths,)
    traits : TransportTraits
    n_layers : int
    path_fractions : float, shape (materials,)
        Path over recorded length, see `splits.media.medium.compute_path_fractions`.
    """

    def __init__(
        self,
        stream_index: int,
        index: np.ndarray,
        absorption: np.ndarray,
        wavelength_mask: np.ndarray,
        traits: TransportTraits,
        n_layers: int,
        path_fractions: np.ndarray,
    ) -> None:
        self.absorption = absorption
        self.path_fractions = path_fractions
        self.traits = traits
        self.n_layers = n_layers
        self.n_rays = np.zeros(len(absorption))
        wavelengths, materials = absorption.shape
        self.irradiance_sums = np.zeros((N_BATCHES, 2, n_layers + 1, wavelengths))
        self.absorptance_sums = np.zeros((N_BATCHES, n_layers, materials, wavelengths))
        self.path_length_sums = np.zeros((N_BATCHES, n_layers, wavelengths))
        first = random_streams.IRRADIANCE_PROFILE + stream_index * len(STRATUM_BOUNDS)
        self.strata = make_strata(first, index, absorption, wavelength_mask, traits, STRATUM_BOUNDS)

    def count_score_values(self) -> int:
        """Return how many numbers a tally and the notes of a batch hold."""
        wavelengths, materials = self.absorption.shape
        notes = FLUX_RAYS_PER_CHUNK * CROSSINGS_PER_BOUNDARY * self.n_layers * (materials + 3)
        return notes + self.n_layers * (3 + materials) * wavelengths

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> FluxScore:
        """Return the sums of a batch of `FLUX_RAYS_PER_CHUNK` rays of a level."""
        absorption = self.absorption[stratum.wavelength_mask]
        ground = self.traits.ground_column
        sums = tally_flux(exits, crossings, absorption, self.path_fractions, self.n_layers, ground)
        return (first_ray // FLUX_RAYS_PER_CHUNK) % N_BATCHES, sums

    def add_scores(self, stratum: Stratum, scores: Sequence[FluxScore]) -> None:
        """Add the sums of batches one by one: they do not depend on who added them."""
        served = stratum.wavelength_mask
        stratum.n_rays += FLUX_RAYS_PER_CHUNK * len(scores)
        self.n_rays[served] += FLUX_RAYS_PER_CHUNK * len(scores)
        for group, sums in scores:
            self.irradiance_sums[group][..., served] += sums.boundary_weight
            self.absorptance_sums[group][..., served] += sums.absorbed
            self.path_length_sums[group][..., served] += sums.path_length

    def compute_batch_means(self) -> FluxByBatch:
        """Return the means of every group, zero where no ray was traced."""
        each = np.maximum(self.n_rays, 1.0) / N_BATCHES
        light = self.irradiance_sums / each
        light[:, 0, 0] = self.n_rays > 0.0
        return FluxByBatch(light, self.absorptance_sums / each, self.path_length_sums / each)
