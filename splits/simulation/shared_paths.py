"""Media that share paths: how they are found, and the rows of their spectra."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.kernels.scene import NO_GROUND
from splits.media.medium import Interface, Medium
from splits.simulation.scene import (
    OpticalConstants,
    build_scene,
    compute_material_constants,
    compute_optical_constants,
)

# --------------------------------------------------------------------------------------------------
# Media that share paths, and the rows of their spectra.
#
# The lengths of a path in the materials give its weight for any absorption (SPLITSnow Eqs 5-6), so
# that one ensemble of paths gives results for every medium with the same grains and layers.

GROUND_DERIVATIVE = -1
"""Position of the derivative to the absorption of a ground, after those to parameters."""


class PathSharingMedia(NamedTuple):
    """Media that share paths, see `group_by_shared_paths`.

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


# --------------------------------------------------------------------------------------------------
# Detection of media that share paths: of the same scene, except for the scale of its lengths.
#
# The refractive indices of grains and pores, impurities, and the albedo of a reflecting ground may
# differ, because a scene does not contain them.  Particles and their matrix must be the same.
#
# Where all lengths of a medium are s times those of another (grains, the distances between them,
# the depths of boundaries), light takes the same paths in both, s times as long.  A semi-infinite
# medium has no depth that fixes the scale.  The scenes themselves are compared, so that sets of
# media that share paths are found whichever parameters differ.

MAX_SHARED_ROWS = 200_000
"""Largest number of rows (wavelengths of different media) of one tally: this limits its memory."""
_COMPARED_BITS = 36
"""Binary digits to which numbers of two scenes must agree."""


class MediaGroup(NamedTuple):
    """Media that share paths, by their positions among all media.

    Attributes
    ----------
    path_sharing : PathSharingMedia
        Each distinct medium once.
    positions : int, shape (members,)
    media_indices : int, shape (members,)
        Of the media in `path_sharing`.
    """

    path_sharing: PathSharingMedia
    positions: np.ndarray
    media_indices: np.ndarray


def group_by_shared_paths(
    media: Sequence[Medium], wavelength_nm: np.ndarray, max_rows: int = MAX_SHARED_ROWS
) -> list[MediaGroup]:
    """Return media in sets that share paths, each in order of size.

    Parameters
    ----------
    media : sequence of Medium
    wavelength_nm : float, shape (wavelengths,)
    max_rows : int
        Largest number of rows of one tally.
    """
    by_signature: dict[bytes, list[tuple[float, int]]] = {}
    for position, medium in enumerate(media):
        key, unit = compute_path_signature(medium)
        by_signature.setdefault(key, []).append((unit, position))
    max_media = max(1, max_rows // wavelength_nm.size)
    groups = []
    for members in by_signature.values():
        # Positions of each distinct medium, in order of size.
        positions: dict[tuple[float, bytes], list[int]] = {}
        for unit, position in sorted(members):
            absorption_key = compute_absorption_signature(media[position], wavelength_nm)
            positions.setdefault((unit, absorption_key), []).append(position)
        distinct = list(positions.items())
        for first in range(0, len(distinct), max_media):
            part = distinct[first : first + max_media]
            smallest = part[0][0][0]
            path_sharing = PathSharingMedia(
                tuple(media[one[0]] for _, one in part),
                np.array([unit / smallest for (unit, _), _ in part]),
            )
            media_indices = [number for number, (_, one) in enumerate(part) for _ in one]
            all_positions = [position for _, one in part for position in one]
            groups.append(
                MediaGroup(path_sharing, np.array(all_positions), np.array(media_indices))
            )
    return groups


def check_path_sharing(media: Mapping[str, Medium]) -> None:
    """Check that media share paths and have the same size.

    Raises
    ------
    ValueError
        Names the first medium that cannot share the paths of the first one.
    """
    (first, base), *others = media.items()
    signature, unit = compute_path_signature(base)
    for name, medium in others:
        other_signature, other_unit = compute_path_signature(medium)
        if other_signature != signature or not math.isclose(other_unit, unit):
            raise invalid(
                f"medium[{name!r}]", medium.kind,
                f"a medium that shares the paths of medium[{first!r}]",
                "only refractive indices of grains and pores, impurities, and the albedo of a "
                "reflecting ground may differ",
            )  # fmt: skip


def compute_absorption_signature(medium: Medium, wavelength_nm: np.ndarray) -> bytes:
    """Return a hash of the optical constants of a medium and of a ground at finite depth."""
    has_ground = not medium.is_semi_infinite
    compute = compute_optical_constants if has_ground else compute_material_constants
    constants = compute(medium, wavelength_nm)
    return hashlib.sha256(constants.indices.tobytes() + constants.absorption.tobytes()).digest()


def compute_path_signature(medium: Medium) -> tuple[bytes, float]:
    """Return a hash common to media that share paths, and the length unit of this one (m).

    It covers every field of the scene, with lengths in that unit, except the ground below an
    infinite layer: no light reaches it.

    Parameters
    ----------
    medium : Medium
    """
    scene = build_scene(medium, 0.0, False)
    layers, types = scene.layers, scene.types
    # A rough surface has a length scale of its own.
    unit = float(1.0 / layers.collision_coefficient[0]) if scene.height_fields is None else 1.0
    scaled_scene = scene._replace(
        layers=layers._replace(
            boundaries=layers.boundaries / unit,
            collision_coefficient=unit * layers.collision_coefficient,
        ),
        types=types and types._replace(inverse_semi_major=unit * types.inverse_semi_major),
        ground_column=NO_GROUND if medium.is_semi_infinite else scene.ground_column,
    )
    # The matrix of particles has one index at all wavelengths and appears in no interface.
    matrices = [layer.refractive_index for layer in medium.scene_layers if not layer.has_grains]
    interfaces = zip(*medium.list_interfaces(), strict=True)
    parts = (type(medium).__name__, len(medium.list_materials()), scaled_scene)
    encoded = map(_encode, (*parts, matrices, *interfaces))
    return hashlib.sha256(b"".join(itertools.chain.from_iterable(encoded))).digest(), unit


def _encode(value: Any) -> Iterator[bytes]:
    """Yield the class and the fields of a named tuple, numbers with their last digits rounded."""
    if hasattr(value, "_fields"):
        yield type(value).__name__.encode()
        for item in value:
            yield from _encode(item)
        return
    table = np.asarray(value)
    yield repr(table.shape).encode()
    if table.dtype.kind not in "biuf":
        yield repr(table.tolist()).encode()
        return
    # Scaled lengths are often whole numbers, where rounding is discontinuous: with a small offset.
    mantissa, exponent = np.frexp(table * (1.0 + 1e-6 * 2.0 ** (-_COMPARED_BITS / 2)))
    whole = np.where(np.isfinite(table), np.round(mantissa * 2.0**_COMPARED_BITS), table)
    yield np.stack([whole, exponent.astype(float)]).tobytes()
