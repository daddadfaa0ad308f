"""Which media share paths: those alike but for what absorbs, for the ground, and for size.

Where all lengths of a medium are s times those of another (grains, the distances between them, the
depths of faces), light takes the same paths in both, s times as long.  In a pack without end no
depth is left to tell sizes apart.  Nothing is assumed about parameters: the scenes themselves are
compared, so a family is found whatever the names of what its members differ in.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.media.medium import GranularMedium, LayeredMedium, compute_absorption
from splits.media.stack import Stack
from splits.media.stacked_particle_layer import StackedParticleLayer
from splits.simulation.path_tally import PathSharingMedia
from splits.simulation.scene import (
    OpticalConstants,
    build_scene,
    compute_optical_constants,
    get_reflecting_ground,
    make_height_fields,
)

MAX_SHARED_ROWS = 200_000
"""Wavelengths of different media that one ensemble serves: what bounds its memory."""
_COMPARED_BITS = 36
"""Binary digits to which numbers of two scenes must agree."""


class MediaGroup(NamedTuple):
    """Media that share paths, by their places among all.

    Attributes
    ----------
    path_sharing : PathSharingMedia
        Each that is different, once.
    positions : int, shape (members,)
    media_indices : int, shape (members,)
        Of the family's media.
    """

    path_sharing: PathSharingMedia
    positions: np.ndarray
    media_indices: np.ndarray


def group_by_shared_paths(media: Sequence[Any], wavelength_nm: np.ndarray) -> list[MediaGroup]:
    """Return media in families that share paths, each in order of size.

    Parameters
    ----------
    media : sequence of GranularMedium or LayeredMedium
    wavelength_nm : float, shape (wavelengths,)

    Raises
    ------
    ValueError
        For a medium that is not made of grains.
    """
    found: dict[bytes, list[tuple[float, int]]] = {}
    for place, medium in enumerate(media):
        if not isinstance(medium, GranularMedium | LayeredMedium):
            raise invalid("medium", medium.kind, "a medium of grains, or a stack")
        key, unit = compute_path_signature(medium)
        found.setdefault(key, []).append((unit, place))
    most = max(1, MAX_SHARED_ROWS // wavelength_nm.size)
    grouped = []
    for alike in found.values():
        # Places of each medium that is different, in order of size.
        places: dict[tuple[float, bytes], list[int]] = {}
        for unit, place in sorted(alike):
            light = compute_absorption_signature(media[place], wavelength_nm)
            places.setdefault((unit, light), []).append(place)
        different = list(places.items())
        for first in range(0, len(different), most):
            part = different[first : first + most]
            smallest = part[0][0][0]
            family = PathSharingMedia(
                tuple(media[one[0]] for _, one in part),
                np.array([unit / smallest for (unit, _), _ in part]),
            )
            which = [number for number, (_, one) in enumerate(part) for _ in one]
            all_places = [place for _, one in part for place in one]
            grouped.append(MediaGroup(family, np.array(all_places), np.array(which)))
    return grouped


def compute_absorption_signature(medium: Any, wavelength_nm: np.ndarray) -> bytes:
    """Return what a medium is to light, and its ground but below a pack without end, as bytes."""
    if math.isinf(medium.depth_m):
        index = medium.compute_refractive_indices(wavelength_nm)
        found = OpticalConstants(index, compute_absorption(medium, index, wavelength_nm))
    else:
        found = compute_optical_constants(medium, wavelength_nm)
    return hashlib.sha256(found.indices.tobytes() + found.absorption.tobytes()).digest()


def compute_path_signature(medium: Any) -> tuple[bytes, float]:
    """Return what media that share paths have in common, as bytes, and the unit of its lengths (m).

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
    """
    endless = math.isinf(medium.depth_m)
    scene = build_scene(_make_finite(medium) if endless else medium, 0.0, False)
    layers, types = scene.layers, scene.types
    # A rough surface has a scale of its own.
    unit = 1.0 if make_height_fields(medium) is not None else float(1.0 / layers.attenuation[0])
    face = layers.boundaries / unit
    if endless:
        face[-1] = -math.inf
    digest = hashlib.sha256()
    for table in (
        face,
        unit * layers.attenuation,
        unit * types.curvature,
        *(
            t
            for t, n in zip(layers, layers._fields, strict=True)
            if n not in ("boundaries", "attenuation")
        ),
        *(t for t, n in zip(types, types._fields, strict=True) if n != "curvature"),
        *scene.particles,
        np.array(scene.rules, dtype=float),
        np.array(
            [
                (i.fraction, i.outer_material, i.inner_material, i.layer)
                for i in medium.list_interfaces()
            ],
            dtype=float,
        ),
        np.array(
            [
                len(medium.list_materials()),
                not endless and get_reflecting_ground(medium) is not None,
            ]
        ),
    ):
        digest.update(repr(np.shape(table)).encode())
        digest.update(_round_significands(np.asarray(table, dtype=float)).tobytes())
    names = [type(medium).__name__, *(i.location for i in medium.list_interfaces())]
    # What particles lie in has one index at all wavelengths, so no interface speaks of it.
    matrices = [
        float(part.layer.refractive_index)
        for part in (medium.scene_layers if isinstance(medium, LayeredMedium) else ())
        if isinstance(part, StackedParticleLayer)
    ]
    digest.update(repr([names, matrices]).encode())
    for table in make_height_fields(medium) or ():
        digest.update(np.ascontiguousarray(table, dtype=float).tobytes())
    return digest.digest(), unit


def _round_significands(values: np.ndarray) -> np.ndarray:
    """Return numbers without their last digits.

    A little is added, as those that a unit has made whole numbers lie where rounding turns.
    """
    mantissa, exponent = np.frexp(values * (1.0 + 1e-6 * 2.0 ** (-_COMPARED_BITS / 2)))
    finite = np.isfinite(values)
    whole = np.where(
        finite, np.round(np.where(finite, mantissa, 0.0) * 2.0**_COMPARED_BITS), values
    )
    return np.stack([whole, exponent.astype(float)])


def _make_finite(medium: Any) -> Any:
    """Return a pack without end with an end somewhere, as scenes need one."""
    if isinstance(medium, Stack):
        return replace(medium, layers=(*medium.layers[:-1], _make_finite(medium.layers[-1])))
    return replace(medium, depth_m=1.0)
