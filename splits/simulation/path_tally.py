"""Spectra that share paths: of media that differ only in what they absorb, and how they change.

A path's lengths in the materials give its weight whatever these absorb (SPLITSnow Eqs 5-6).  So
one ensemble serves every medium whose grains, layers and refractive indices are the same, and
every derivative to what absorbs, at no cost of tracing.
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
    """Media that share paths: alike but for what absorbs, for the ground, and for size.

    Where all lengths of a medium are s times those of another, light takes the same paths in both,
    s times as long; it is as if the other one absorbed s times as much per metre.

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
        """Return the family of media that are of one size."""
        return cls(tuple(media), np.ones(len(media)))

    def select(self, selection: slice) -> PathSharingMedia:
        """Return some of it."""
        return PathSharingMedia(self.media[selection], self.size_ratios[selection])

    def compute_constants(self, wavelength_nm: np.ndarray) -> list[OpticalConstants]:
        """Return what each is to light at wavelengths (nm), lengths in units of the first's size.

        Meetings with a ground are no lengths.
        """
        found = []
        for medium, scale in zip(*self, strict=True):
            one = compute_optical_constants(medium, wavelength_nm)
            absorption = scale * one.absorption
            if get_reflecting_ground(medium) is not None:
                absorption[:, -1] = one.absorption[:, -1]
            found.append(one._replace(absorption=absorption))
        return found


@dataclass(frozen=True)
class SpectralRows:
    """What a few ensembles of paths are to tell: a row for every wavelength of every medium.

    Attributes
    ----------
    index : complex, shape (rows, columns)
        Refractive indices.
    absorption : float, shape (rows, columns)
        Absorption coefficients (1/m); of the ground, −ln of its albedo.
    min_absorption : float, shape (rows, columns)
        The least of those among the media of one size at a row's wavelength.  It alone decides on
        roulette and on the rays that a row listens to: so these media listen to the same.
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
        found = path_sharing.compute_constants(wavelength_nm)
        absorption = np.stack([one.absorption for one in found])
        weakest = np.empty_like(absorption)
        for scale in np.unique(path_sharing.size_ratios):
            alike = path_sharing.size_ratios == scale
            weakest[alike] = absorption[alike].min(axis=0)
        columns = absorption.shape[-1]
        return cls(
            np.concatenate([one.indices for one in found]),
            absorption.reshape(-1, columns),
            weakest.reshape(-1, columns),
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
        """Return these rows, of one medium, with the derivatives that moved ones tell.

        Parameters
        ----------
        perturbed : PathSharingMedia
            The medium with one parameter after the other moved.
        steps : float, shape (media,)
            By so much.
        wavelength_nm : float, shape (rows,)
        ground_column : int
            Column of a ground to whose own absorption the last derivative is, or `NO_GROUND`.
        """
        others = [one.absorption for one in perturbed.compute_constants(wavelength_nm)]
        changes = [(o - self.absorption) / s for o, s in zip(others, steps, strict=True)]
        if ground_column != NO_GROUND:
            changes.append(np.zeros_like(self.absorption))
            changes[-1][:, ground_column] = 1.0
        return replace(self, absorption_derivatives=np.stack(changes))


class Derivatives(NamedTuple):
    """Derivatives of reflected and transmitted shares.

    Attributes
    ----------
    mean : float, shape (2, parameters, rows)
    batch_deviations : float, shape (GROUPS, 2, parameters, rows)
        How far groups of rays take them off: sums over them of products are covariances.
    bias_bound : float, shape (2, parameters, rows)
        Bound on what these do not tell.
    """

    mean: np.ndarray
    batch_deviations: np.ndarray
    bias_bound: np.ndarray

    def select(self, selection: slice) -> Derivatives:
        """Return the derivatives to some of the parameters."""
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
    """Paths that serve several media and derivatives, see `PathTally`.

    Attributes
    ----------
    derivative_sums : float, shape (GROUPS, 2, parameters, rows)
        Σ derivative of weight of the rays of every group, reflected and transmitted.
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
        for level in self.strata:
            some = self.absorption[level.wavelength_mask].max(axis=0) > 0.0
            some |= (self.absorption_derivatives[:, level.wavelength_mask] != 0.0).any(axis=(0, 1))
            level.optics = level.optics._replace(is_absorbing=some)

    def count_score_values(self) -> int:
        """Return how many numbers a tally holds."""
        return super().count_score_values() + len(self.absorption_derivatives) * len(self.rows) * (
            1 + BLOCK_SIZE
        )

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> Any:
        """Return the sums of a batch of a level, and their derivatives by block."""
        sums = super().score_chunk(stratum, first_ray, exits, crossings)
        if not len(self.absorption_derivatives):
            return sums, None
        served = self.rows[self.select_rows(stratum)]
        absorption, changes = self.absorption[served], self.absorption_derivatives[:, served]
        return sums, tally_derivatives(
            exits, crossings, absorption, changes, self.traits.ground_column
        )

    def add_scores(self, stratum: Stratum, scores: Sequence[Any]) -> None:
        """Add the tallies of batches one by one."""
        for sums, blocks in scores:
            first = stratum.n_rays // BLOCK_SIZE % N_BATCHES
            super().add_scores(stratum, [sums])
            if blocks is not None:
                self.derivative_sums[
                    first : first + len(blocks), :, :, self.select_rows(stratum)
                ] += blocks

    def compute_derivatives(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean derivatives, and how far groups take them off, as `deviations` does."""
        count = np.maximum(self.n_rays, 1.0)
        mean = self.derivative_sums.sum(axis=0) / count
        off = self.derivative_sums - self.count_rays_per_batch()[:, np.newaxis, np.newaxis] * mean
        return mean, off / count


def check_path_sharing(media: Mapping[str, Medium]) -> None:
    """Refuse media that differ in more than what they absorb.

    Raises
    ------
    ValueError
        Names the first medium that paths of the first one do not serve.
    """
    (first, base), *others = media.items()
    if not isinstance(base, GranularMedium | LayeredMedium):
        raise invalid(f"media[{first!r}]", base.kind, "a medium of grains, or a stack")
    scene = build_scene(base, 0.0, False)
    for name, medium in others:
        alike = (
            type(medium) is type(base)
            and medium.list_materials() == base.list_materials()
            and (get_reflecting_ground(medium) is None) == (get_reflecting_ground(base) is None)
            and tables_equal(scene, build_scene(medium, 0.0, False))
        )
        if not alike:
            raise invalid(
                f"media[{name!r}]", medium.kind, f"like media[{first!r}] but for what absorbs",
                "grains, depths, pores and readings must be the same; impurities, and the albedo "
                "of a ground that sends light back, may differ",
            )  # fmt: skip


def tables_equal(first: Any, second: Any) -> bool:
    """Tell whether tables of a scene hold the same numbers."""
    if isinstance(first, tuple) and hasattr(first, "_fields"):
        return all(tables_equal(a, b) for a, b in zip(first, second, strict=True))
    return np.array_equal(first, second)
