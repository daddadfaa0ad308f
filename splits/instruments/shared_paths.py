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

from splits.checks import refuse
from splits.instruments.ensemble import GROUPS, Ensemble, Level, Manner
from splits.instruments.scenes import Constants, constants_of, granular_scene, ground_of
from splits.media.granular import GranularMedium, Interface, LayeredMedium
from splits.media.turbid import Medium
from splits.transport.grains.scene import NO_GROUND
from splits.transport.sums.slopes import slopes
from splits.transport.sums.tally import BLOCK


class Family(NamedTuple):
    """Media that share paths: alike but for what absorbs, for the ground, and for size.

    Where all lengths of a medium are s times those of another, light takes the same paths in both,
    s times as long; it is as if the other one absorbed s times as much per metre.

    Attributes
    ----------
    media : tuple of Medium
        Rays are traced in the first.
    scales : float, shape (media,)
        Sizes in units of the first's.
    """

    media: tuple[Medium, ...]
    scales: np.ndarray

    @classmethod
    def of_one_size(cls, media: Sequence[Medium]) -> Family:
        """Return the family of media that are of one size."""
        return cls(tuple(media), np.ones(len(media)))

    def part(self, some: slice) -> Family:
        """Return some of it."""
        return Family(self.media[some], self.scales[some])

    def constants(self, wavelength_nm: np.ndarray) -> list[Constants]:
        """Return what each is to light at wavelengths (nm), lengths in units of the first's size.

        Meetings with a ground are no lengths.
        """
        found = []
        for medium, scale in zip(*self, strict=True):
            one = constants_of(medium, wavelength_nm)
            absorption = scale * one.absorption
            if ground_of(medium) is not None:
                absorption[:, -1] = one.absorption[:, -1]
            found.append(one._replace(absorption=absorption))
        return found


@dataclass(frozen=True)
class Rows:
    """What a few ensembles of paths are to tell: a row for every wavelength of every medium.

    Attributes
    ----------
    index : complex, shape (rows, columns)
        Refractive indices.
    absorption : float, shape (rows, columns)
        Absorption coefficients (1/m); of the ground, −ln of its albedo.
    weakest : float, shape (rows, columns)
        The least of those among the media of one size at a row's wavelength.  It alone decides on
        roulette and on the rays that a row listens to: so these media listen to the same.
    changes : float, shape (parameters, rows, columns)
        Derivatives of absorption.
    interfaces : sequence of Interface
    """

    index: np.ndarray
    absorption: np.ndarray
    weakest: np.ndarray
    changes: np.ndarray
    interfaces: Sequence[Interface]

    @classmethod
    def of(cls, family: Family, wavelength_nm: np.ndarray) -> Rows:
        """Return the rows of media that share paths, medium after medium."""
        found = family.constants(wavelength_nm)
        absorption = np.stack([one.absorption for one in found])
        weakest = np.empty_like(absorption)
        for scale in np.unique(family.scales):
            alike = family.scales == scale
            weakest[alike] = absorption[alike].min(axis=0)
        columns = absorption.shape[-1]
        return cls(
            np.concatenate([one.indices for one in found]),
            absorption.reshape(-1, columns),
            weakest.reshape(-1, columns),
            np.zeros((0, absorption[..., 0].size, columns)),
            family.media[0].interfaces(),
        )

    def changing(
        self, moved: Family, steps: np.ndarray, wavelength_nm: np.ndarray, column: int
    ) -> Rows:
        """Return these rows, of one medium, with the derivatives that moved ones tell.

        Parameters
        ----------
        moved : Family
            The medium with one parameter after the other moved.
        steps : float, shape (media,)
            By so much.
        wavelength_nm : float, shape (rows,)
        column : int
            Column of a ground to whose own absorption the last derivative is, or `NO_GROUND`.
        """
        others = [one.absorption for one in moved.constants(wavelength_nm)]
        changes = [(o - self.absorption) / s for o, s in zip(others, steps, strict=True)]
        if column != NO_GROUND:
            changes.append(np.zeros_like(self.absorption))
            changes[-1][:, column] = 1.0
        return replace(self, changes=np.stack(changes))


class Slopes(NamedTuple):
    """Derivatives of reflected and transmitted shares.

    Attributes
    ----------
    mean : float, shape (2, parameters, rows)
    groups : float, shape (GROUPS, 2, parameters, rows)
        How far groups of rays take them off: sums over them of products are covariances.
    missed : float, shape (2, parameters, rows)
        Bound on what these do not tell.
    """

    mean: np.ndarray
    groups: np.ndarray
    missed: np.ndarray

    def of(self, some: slice) -> Slopes:
        """Return the derivatives to some of the parameters."""
        return Slopes(self.mean[:, some], self.groups[:, :, some], self.missed[:, some])

    @property
    def stderr(self) -> np.ndarray:
        """Standard errors, shaped like the means."""
        return np.sqrt((self.groups**2).sum(axis=0) + self.missed**2)


class SharedPaths(Ensemble):
    """Paths that serve several media and derivatives, see `Ensemble`.

    Attributes
    ----------
    slopes : float, shape (GROUPS, 2, parameters, rows)
        Σ derivative of weight of the rays of every group, reflected and transmitted.
    """

    def __init__(
        self, number: int, index: np.ndarray, rows: Rows, served: np.ndarray, manner: Manner
    ) -> None:
        super().__init__(number, index, rows.weakest, served, manner)
        self.absorption, self.changes = rows.absorption, rows.changes
        self.slopes = np.zeros((GROUPS, 2, len(rows.changes), len(self.rows)))
        for level in self.levels:
            some = self.absorption[level.served].max(axis=0) > 0.0
            some |= (self.changes[:, level.served] != 0.0).any(axis=(0, 1))
            level.optics = level.optics._replace(absorbs=some)

    def size(self) -> int:
        """Return how many numbers a tally holds."""
        return super().size() + len(self.changes) * len(self.rows) * (1 + BLOCK)

    def tally(self, level: Level, first: int, exits: np.ndarray, notes: np.ndarray) -> Any:
        """Return the sums of a batch of a level, and their derivatives by block."""
        sums = super().tally(level, first, exits, notes)
        if not len(self.changes):
            return sums, None
        served = self.rows[self.part(level)]
        absorption, changes = self.absorption[served], self.changes[:, served]
        return sums, slopes(exits, notes, absorption, changes, self.manner.ground)

    def add(self, level: Level, tallies: Sequence[Any]) -> None:
        """Add the tallies of batches one by one."""
        for sums, blocks in tallies:
            first = level.rays // BLOCK % GROUPS
            super().add(level, [sums])
            if blocks is not None:
                self.slopes[first : first + len(blocks), :, :, self.part(level)] += blocks

    def slope_deviations(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean derivatives, and how far groups take them off, as `deviations` does."""
        count = np.maximum(self.count, 1.0)
        mean = self.slopes.sum(axis=0) / count
        off = self.slopes - self.rays_of_groups()[:, np.newaxis, np.newaxis] * mean
        return mean, off / count


def check_shared(media: Mapping[str, Medium]) -> None:
    """Refuse media that differ in more than what they absorb.

    Raises
    ------
    ValueError
        Names the first medium that paths of the first one do not serve.
    """
    (first, base), *others = media.items()
    if not isinstance(base, GranularMedium | LayeredMedium):
        raise refuse(f"media[{first!r}]", base.kind, "a medium of grains, or a stack")
    scene = granular_scene(base, 0.0, False)
    for name, medium in others:
        alike = (
            type(medium) is type(base)
            and medium.materials() == base.materials()
            and (ground_of(medium) is None) == (ground_of(base) is None)
            and same(scene, granular_scene(medium, 0.0, False))
        )
        if not alike:
            raise refuse(
                f"media[{name!r}]", medium.kind, f"like media[{first!r}] but for what absorbs",
                "grains, depths, pores and readings must be the same; impurities, and the albedo "
                "of a ground that sends light back, may differ",
            )  # fmt: skip


def same(one: Any, other: Any) -> bool:
    """Tell whether tables of a scene hold the same numbers."""
    if isinstance(one, tuple) and hasattr(one, "_fields"):
        return all(same(a, b) for a, b in zip(one, other, strict=True))
    return np.array_equal(one, other)
