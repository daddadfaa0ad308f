"""Tallies of radiative fluxes at planes in a medium, by batch."""

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
"""Rays whose weights are added up together: few, so that a first round of all batches is short."""
FLUX_RAYS_PER_ROUND = FLUX_RAYS_PER_CHUNK * N_BATCHES
"""Rays of one chunk for each batch."""
CROSSINGS_PER_BOUNDARY = 4
"""Expected crossings of a boundary per ray, for the memory of a job."""

FluxScore = tuple[int, FluxTally]
"""Score of a chunk: its batch, and sums over its rays."""


class FluxByBatch(NamedTuple):
    """Means by batch of rays.

    Attributes
    ----------
    irradiance : float, shape (N_BATCHES, 2, boundaries, wavelengths)
        Of light that crosses a boundary, downwards and upwards; at the top, incident light counts.
    absorptance : float, shape (N_BATCHES, layers, materials, wavelengths)
    path_length : float, shape (N_BATCHES, layers, wavelengths)
        Metres.
    """

    irradiance: np.ndarray
    absorptance: np.ndarray
    path_length: np.ndarray


class FluxPathTally:
    """Tally of paths traced with one set of refractive indices, at the boundaries of all layers.

    Parameters
    ----------
    stream_index : int
        Position among the tallies of a run, which determines the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
    wavelength_mask : bool, shape (wavelengths,)
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
        first_stream = random_streams.IRRADIANCE_PROFILE + stream_index * len(STRATUM_BOUNDS)
        self.strata = make_strata(
            first_stream, index, absorption, wavelength_mask, traits, STRATUM_BOUNDS
        )

    def count_score_values(self) -> int:
        """Return the number of values in the score and the crossings of a chunk."""
        wavelengths, materials = self.absorption.shape
        crossings = FLUX_RAYS_PER_CHUNK * CROSSINGS_PER_BOUNDARY * self.n_layers * (materials + 3)
        return crossings + self.n_layers * (3 + materials) * wavelengths

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> FluxScore:
        """Return the sums of a chunk of `FLUX_RAYS_PER_CHUNK` rays of a stratum."""
        absorption = self.absorption[stratum.wavelength_mask]
        ground = self.traits.ground_column
        sums = tally_flux(exits, crossings, absorption, self.path_fractions, self.n_layers, ground)
        return (first_ray // FLUX_RAYS_PER_CHUNK) % N_BATCHES, sums

    def add_scores(self, stratum: Stratum, scores: Sequence[FluxScore]) -> None:
        """Add the sums of chunks one by one: they do not depend on the threads."""
        mask = stratum.wavelength_mask
        stratum.n_rays += FLUX_RAYS_PER_CHUNK * len(scores)
        self.n_rays[mask] += FLUX_RAYS_PER_CHUNK * len(scores)
        for batch, sums in scores:
            self.irradiance_sums[batch][..., mask] += sums.boundary_weight
            self.absorptance_sums[batch][..., mask] += sums.absorbed
            self.path_length_sums[batch][..., mask] += sums.path_length

    def compute_batch_means(self) -> FluxByBatch:
        """Return the means of every batch, zero where no ray was traced."""
        rays_per_batch = np.maximum(self.n_rays, 1.0) / N_BATCHES
        irradiance = self.irradiance_sums / rays_per_batch
        irradiance[:, 0, 0] = self.n_rays > 0.0
        return FluxByBatch(
            irradiance,
            self.absorptance_sums / rays_per_batch,
            self.path_length_sums / rays_per_batch,
        )
