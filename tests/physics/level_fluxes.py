"""Fluxes at the levels of layers, by reciprocity from isotropic sources at these levels.

By reciprocity, the flux at a level under a beam is the radiance in the direction of the beam from
an isotropic source at this level: the downward flux from a source that radiates upwards, the upward
flux from one that radiates downwards, whose light rises after reflection by what lies below.  The
direct flux is that of a source in the directions of the beams only, and the actinic flux that of a
source on both sides with a radiance of 1/μ.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.adding import Boundary, Element, apply_rows, iterate_levels
from splits.discrete_ordinates.homogeneous_layer import Streams


class Profile(NamedTuple):
    """Fluxes at the levels, for the beams and for diffuse light (last).

    All are of shape (levels, ..., directions + 1), for an irradiance of 1 on the horizontal, and
    sums over the states.

    Attributes
    ----------
    direct : float
        Downward flux of the beams that is not scattered; after truncation of the phase function
        (`LayerOptics.truncate`) with the forward peak.  0 for diffuse light.
    downward, upward : float
        Flux, with the direct one.
    actinic : float
        Radiance integrated over the sphere.
    """

    direct: np.ndarray
    downward: np.ndarray
    upward: np.ndarray
    actinic: np.ndarray


def join_cosines(streams: Streams, directions: np.ndarray) -> np.ndarray:
    """Return the cosines of the radiances: the streams and the directions of all states.

    Parameters
    ----------
    streams : Streams
    directions : float, shape (..., states, directions)
    """
    *batch, n_states, n_directions = directions.shape
    n = streams.cosines.size
    own = np.broadcast_to(np.tile(streams.cosines, n_states), (*batch, n_states * n))
    joined = directions.reshape(*batch, n_states * n_directions)
    return np.concatenate([own, joined], axis=-1)


def compute_profile(
    elements: Sequence[Element], isotropic: Sequence[np.ndarray], cosines: np.ndarray,
    boundaries: Sequence[Boundary], ground: np.ndarray, n_streams: int,
) -> Profile:  # fmt: skip
    """Return the fluxes above each element, and below the last one, within the boundaries.

    The caller divides layers at the depths of interest: with the same optics, results do not
    change.

    Parameters
    ----------
    elements : sequence of Element
        Layers and the interfaces between them, top first.
    isotropic : sequence of arrays, shape (..., radiances)
        Isotropic radiance at each level, of the layer in which the level is.
    cosines : float, shape (..., radiances)
        See `join_cosines`.
    boundaries, ground, n_streams
        As in `compute_budget`.
    """
    beams = np.arange(cosines.shape[-1]) >= n_streams
    fluxes = []
    levels = iterate_levels(elements, isotropic, boundaries, ground, n_streams)
    for (outlet, reflection), radiance in zip(levels, isotropic, strict=True):
        reflected = outlet @ reflection
        fluxes.append(
            (
                apply_rows(outlet, beams * radiance),
                apply_rows(outlet, radiance),
                apply_rows(reflected, radiance),
                apply_rows(outlet + reflected, radiance / cosines),
            )
        )
    return Profile(*(np.stack(values) for values in zip(*fluxes, strict=True)))
