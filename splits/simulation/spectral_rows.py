"""Media that share paths, and the rows of their spectra.

The lengths of a path in the materials give its weight for any absorption (SPLITSnow Eqs 5-6), so
that one ensemble of paths gives results for every medium with the same grains and layers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from splits.kernels.base.scene import NO_GROUND
from splits.media.medium import Interface, Medium
from splits.simulation.scene import (
    OpticalConstants,
    compute_optical_constants,
)

GROUND_DERIVATIVE = -1
"""Position of the derivative to the absorption of a ground, after those to parameters."""


class PathSharingMedia(NamedTuple):
    """Media that share paths, see `splits.simulation.path_reuse`.

    Where all lengths of a medium are s times those of another, light takes the same paths in both,
    s times as long, which is equivalent to s times the absorption per metre.

    Attributes
    ----------
    media : tuple of Medium
        Rays are traced in the first.
    size_ratios : float, shape (media,)
        Sizes in units of the first's.
    n_perturbed : int
        Number of media, the last ones, that have no spectra of their own: each has one parameter of
        the first changed, for a derivative.
    """

    media: tuple[Medium, ...]
    size_ratios: np.ndarray
    n_perturbed: int = 0

    @classmethod
    def from_media(cls, media: Sequence[Medium]) -> PathSharingMedia:
        """Return path-sharing media of equal size."""
        return cls(tuple(media), np.ones(len(media)))

    @property
    def n_reported(self) -> int:
        """Number of media that are not perturbed."""
        return len(self.media) - self.n_perturbed

    def split(self) -> tuple[PathSharingMedia, PathSharingMedia]:
        """Return the media that are not perturbed, and the perturbed ones."""
        media, ratios, n = self.media, self.size_ratios, self.n_reported
        return PathSharingMedia(media[:n], ratios[:n]), PathSharingMedia(media[n:], ratios[n:])

    def compute_constants(self, wavelength_nm: np.ndarray) -> list[OpticalConstants]:
        """Return the optical constants of each at wavelengths (nm), in units of the first's size.

        The optical depth of a ground is not scaled.
        """
        scaled = []
        for medium, size_ratio in zip(self.media, self.size_ratios, strict=True):
            constants = compute_optical_constants(medium, wavelength_nm)
            absorption = size_ratio * constants.absorption
            if medium.reflecting_ground is not None:
                absorption[:, -1] = constants.absorption[:, -1]
            scaled.append(constants._replace(absorption=absorption))
        return scaled


@dataclass(frozen=True)
class SpectralRows:
    """Rows of spectra: one for every wavelength of every medium.

    Attributes
    ----------
    index : complex, shape (rows, columns)
        Refractive indices.
    absorption : float, shape (rows, columns)
        Absorption coefficients (1/m); of the ground, −ln of its albedo.
    min_absorption : float, shape (rows, columns)
        The smallest absorption among the media of one size at a row's wavelength.  It determines
        roulette and the strata of a row, so that these media use the same rays.
    absorption_derivatives : float, shape (parameters, rows, columns)
        Derivatives of absorption.
    interfaces : sequence of Interface
    """

    index: np.ndarray
    absorption: np.ndarray
    min_absorption: np.ndarray
    absorption_derivatives: np.ndarray
    interfaces: Sequence[Interface]

    @classmethod
    def from_media(cls, path_sharing: PathSharingMedia, wavelength_nm: np.ndarray) -> SpectralRows:
        """Return the rows of media that share paths, medium after medium."""
        constants = path_sharing.compute_constants(wavelength_nm)
        absorption = np.stack([one.absorption for one in constants])
        min_absorption = np.empty_like(absorption)
        for size_ratio in np.unique(path_sharing.size_ratios):
            same_size = path_sharing.size_ratios == size_ratio
            min_absorption[same_size] = absorption[same_size].min(axis=0)
        columns = absorption.shape[-1]
        return cls(
            np.concatenate([one.indices for one in constants]),
            absorption.reshape(-1, columns),
            min_absorption.reshape(-1, columns),
            np.zeros((0, absorption[..., 0].size, columns)),
            path_sharing.media[0].list_interfaces(),
        )

    def with_derivatives(
        self,
        perturbed: PathSharingMedia,
        steps: np.ndarray,
        wavelength_nm: np.ndarray,
        ground_column: int,
    ) -> SpectralRows:
        """Return these rows, of one medium, with absorption derivatives from perturbed media.

        Parameters
        ----------
        perturbed : PathSharingMedia
            The medium with one parameter after the other changed.
        steps : float, shape (media,)
            Changes of the parameters.
        wavelength_nm : float, shape (rows,)
        ground_column : int
            Column of a ground, to whose absorption a derivative is added at `GROUND_DERIVATIVE`;
            `NO_GROUND` for none.
        """
        perturbed_absorption = [
            one.absorption for one in perturbed.compute_constants(wavelength_nm)
        ]
        derivatives = [
            (other - self.absorption) / step
            for other, step in zip(perturbed_absorption, steps, strict=True)
        ]
        if ground_column != NO_GROUND:
            derivatives.append(np.zeros_like(self.absorption))
            derivatives[GROUND_DERIVATIVE][:, ground_column] = 1.0
        return replace(self, absorption_derivatives=np.stack(derivatives))
