"""Tallies of paths shared by several media, and of derivatives with respect to their absorption.

The lengths of a path in the materials give its weight for any absorption (SPLITSnow Eqs 5-6).  One
path ensemble therefore gives results for every medium with the same grains, layers and refractive
indices, and derivatives with respect to all absorption parameters, without more tracing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.kernels.grains.scene import NO_GROUND
from splits.kernels.tallies.derivatives import tally_derivatives
from splits.kernels.tallies.exits import BLOCK_SIZE
from splits.media.medium import GranularMedium, Interface, LayeredMedium, Medium
from splits.simulation.scene import (
    OpticalConstants,
    build_scene,
    compute_optical_constants,
    get_reflecting_ground,
)
from splits.simulation.tally import N_BATCHES, PathTally, Stratum, TransportTraits


class PathSharingMedia(NamedTuple):
    """Media that share paths: alike except for absorption, the ground, and a length scale.

    Where all lengths of a medium are s times those of another, light takes the same paths in both,
    s times as long, which is equivalent to s times the absorption per metre.

    Attributes
    ----------
    media : tuple of Medium
        Rays are traced in the first.
    size_ratios : float, shape (media,)
        Sizes in units of the first's.
    """

    media: tuple[Medium, ...]
    size_ratios: np.ndarray

    @classmethod
    def from_media(cls, media: Sequence[Medium]) -> PathSharingMedia:
        """Return path-sharing media of equal size."""
        return cls(tuple(media), np.ones(len(media)))

    def select(self, selection: slice) -> PathSharingMedia:
        """Return a subset of the media."""
        return PathSharingMedia(self.media[selection], self.size_ratios[selection])

    def compute_constants(self, wavelength_nm: np.ndarray) -> list[OpticalConstants]:
        """Return the optical constants of each at wavelengths (nm), in units of the first's size.

        The optical depth of a ground is not scaled.
        """
        scaled = []
        for medium, size_ratio in zip(*self, strict=True):
            constants = compute_optical_constants(medium, wavelength_nm)
            absorption = size_ratio * constants.absorption
            if get_reflecting_ground(medium) is not None:
                absorption[:, -1] = constants.absorption[:, -1]
            scaled.append(constants._replace(absorption=absorption))
        return scaled


@dataclass(frozen=True)
class SpectralRows:
    """Rows of path tallies: one for every wavelength of every medium.

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
            Column of a ground; the last derivative is to its absorption.  `NO_GROUND` for none.
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
            derivatives[-1][:, ground_column] = 1.0
        return replace(self, absorption_derivatives=np.stack(derivatives))


class Derivatives(NamedTuple):
    """Derivatives of reflected and transmitted fractions.

    Attributes
    ----------
    mean : float, shape (2, parameters, rows)
    batch_deviations : float, shape (N_BATCHES, 2, parameters, rows)
        Contributions of batches to the deviations of the means: sums of products are covariances.
    bias_bound : float, shape (2, parameters, rows)
        Bound on the systematic error.
    """

    mean: np.ndarray
    batch_deviations: np.ndarray
    bias_bound: np.ndarray

    def select(self, selection: slice) -> Derivatives:
        """Return the derivatives with respect to some of the parameters."""
        return Derivatives(
            self.mean[:, selection],
            self.batch_deviations[:, :, selection],
            self.bias_bound[:, selection],
        )

    @property
    def stderr(self) -> np.ndarray:
        """Standard errors, shaped like the means."""
        return np.sqrt((self.batch_deviations**2).sum(axis=0) + self.bias_bound**2)


class SharedPathTally(PathTally):
    """Tally of paths for several media and derivatives, see `PathTally`.

    Attributes
    ----------
    derivative_sums : float, shape (N_BATCHES, 2, parameters, rows)
        Σ derivative of weight of the rays of each batch, reflected and transmitted.
    """

    def __init__(
        self,
        stream_index: int,
        index: np.ndarray,
        rows: SpectralRows,
        wavelength_mask: np.ndarray,
        traits: TransportTraits,
    ) -> None:
        super().__init__(stream_index, index, rows.min_absorption, wavelength_mask, traits)
        self.absorption, self.absorption_derivatives = rows.absorption, rows.absorption_derivatives
        self.derivative_sums = np.zeros(
            (N_BATCHES, 2, len(rows.absorption_derivatives), len(self.rows))
        )

    def count_score_values(self) -> int:
        """Return the number of values in the score of a chunk."""
        return super().count_score_values() + len(self.absorption_derivatives) * len(self.rows) * (
            1 + BLOCK_SIZE
        )

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> Any:
        """Return the sums of a chunk of a stratum, and their derivatives by block."""
        sums = super().score_chunk(stratum, first_ray, exits, crossings)
        if not len(self.absorption_derivatives):
            return sums, None
        used_rows = self.rows[self.select_rows(stratum)]
        absorption, derivatives = (
            self.absorption[used_rows],
            self.absorption_derivatives[:, used_rows],
        )
        return sums, tally_derivatives(
            exits, crossings, absorption, derivatives, self.traits.ground_column
        )

    def add_scores(self, stratum: Stratum, scores: Sequence[Any]) -> None:
        """Add the scores of chunks one by one."""
        for sums, block_sums in scores:
            first = stratum.n_rays // BLOCK_SIZE % N_BATCHES
            super().add_scores(stratum, [sums])
            if block_sums is not None:
                self.derivative_sums[
                    first : first + len(block_sums), :, :, self.select_rows(stratum)
                ] += block_sums

    def compute_derivatives(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean derivatives and their deviations by batch, as `compute_batch_deviations`."""
        n_rays = np.maximum(self.n_rays, 1.0)
        mean = self.derivative_sums.sum(axis=0) / n_rays
        deviations = (
            self.derivative_sums - self.count_rays_per_batch()[:, np.newaxis, np.newaxis] * mean
        )
        return mean, deviations / n_rays


def check_path_sharing(media: Mapping[str, Medium]) -> None:
    """Check that media differ only in absorption.

    Raises
    ------
    ValueError
        Names the first medium that cannot share the paths of the first one.
    """
    (first, base), *others = media.items()
    if not isinstance(base, GranularMedium | LayeredMedium):
        raise invalid(f"medium[{first!r}]", base.kind, "a granular medium, or a stack")
    scene = build_scene(base, 0.0, False)
    for name, medium in others:
        shares_paths = (
            type(medium) is type(base)
            and medium.list_materials() == base.list_materials()
            and (get_reflecting_ground(medium) is None) == (get_reflecting_ground(base) is None)
            and tables_equal(scene, build_scene(medium, 0.0, False))
        )
        if not shares_paths:
            raise invalid(
                f"medium[{name!r}]", medium.kind, f"like medium[{first!r}] except for absorption",
                "grains, depths, pores and interpretation must be the same; impurities, and the "
                "albedo of a reflecting ground, may differ",
            )  # fmt: skip


def tables_equal(first: Any, second: Any) -> bool:
    """Return whether tables of a scene hold the same numbers."""
    if isinstance(first, tuple) and hasattr(first, "_fields"):
        return isinstance(second, tuple) and all(
            tables_equal(a, b) for a, b in zip(first, second, strict=True)
        )
    return np.array_equal(first, second)
