"""Light: where rays come from.  Media know nothing of it."""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.compiler.jit import inline
from splits.kernels.math.arithmetic import sqrt
from splits.kernels.math.vectors import Vector


class Source(NamedTuple):
    """A beam, equal radiance from the whole hemisphere above, or a mixture of both.

    Attributes
    ----------
    cos_incidence : float
        Cosine of the beam's angle of incidence, in (0, 1].
    diffuse_fraction : float
        Share of the incident flux that comes from everywhere with equal radiance, 0 to 1.
    """

    cos_incidence: float
    diffuse_fraction: float


@inline
def sample_source_direction(source, u):
    """Return the direction in which a ray comes from above.

    Parameters
    ----------
    source : Source
    u : float
        A uniform random number; not looked at where there is a beam only.
    """
    mu = source.cos_incidence
    if u < source.diffuse_fraction:
        # Lambert's law; what is left of u once it has chosen is uniform again.
        mu = sqrt(u / source.diffuse_fraction)
    return Vector(sqrt(max((1.0 - mu) * (1.0 + mu), 0.0)), 0.0, -mu)
