"""Light: where rays come from.  Media know nothing of it."""

from __future__ import annotations

from typing import NamedTuple

from splits.transport.compiling.jit import kernel
from splits.transport.numerics.arithmetic import root
from splits.transport.numerics.vectors import Vector


class Light(NamedTuple):
    """A beam, equal radiance from the whole hemisphere above, or a mixture of both.

    Attributes
    ----------
    cos : float
        Cosine of the beam's angle of incidence, in (0, 1].
    diffuse : float
        Share of the incident flux that comes from everywhere with equal radiance, 0 to 1.
    """

    cos_incidence: float
    diffuse_fraction: float


@kernel
def launched(source, u):
    """Return the direction in which a ray comes from above.

    Parameters
    ----------
    light : Light
    u : float
        A uniform random number; not looked at where there is a beam only.
    """
    mu = source.cos_incidence
    if u < source.diffuse_fraction:
        # Lambert's law; what is left of u once it has chosen is uniform again.
        mu = root(u / source.diffuse_fraction)
    return Vector(root(max((1.0 - mu) * (1.0 + mu), 0.0)), 0.0, -mu)
