"""Whether lanes can serve a scene, and with which features."""

from __future__ import annotations

import numpy as np

from splits.transport import facets, spheroid
from splits.transport.fresnel import interface
from splits.transport.jit import entry
from splits.transport.lanes.rows import Features
from splits.transport.scene import DRY_PORE, LOBE, WET_PORE, Grains, Optics, Rules, Slab

FAINT = 1e-5
"""Change of the reflectance of diffuse light up to which extinction coefficients are left out of
reflection.  They show most where light meets an absorbing medium of lower index."""

_COSINE, _WEIGHT = np.polynomial.legendre.leggauss(96)
_COSINE = 0.5 * (_COSINE + 1.0)
_WEIGHT = _WEIGHT * _COSINE

DEEPEST = 1e5
"""Depth in mean distances between grains up to which single precision places rays well: its
steps are then below 1 % of that distance."""


def features_for(
    grains: Grains, slab: Slab, rules: Rules, optics: Optics, positions: bool = False
) -> Features | None:
    """Return what a scene has, or None if only the scalar kernel serves it.

    Lanes do without absorption by coin toss, more than one coating, and samples of more than
    `DEEPEST` mean distances.

    Parameters
    ----------
    grains, slab, rules, optics
        See `splits.transport.scene`.
    positions : bool
        Whether horizontal positions of exit are wanted.
    """
    if rules.analog or grains.layers.max() > 2 or slab.depth * grains.attenuation > DEEPEST:
        return None
    mixed = grains.share.size > 1 or grains.layers.max() > 1
    if not mixed:
        core = grains.material[0, 0]
        pores = [DRY_PORE, WET_PORE] if slab.saturation > 0.0 else [DRY_PORE]
        pairs = [(pore, core) for pore in pores] + [(core, pore) for pore in pores]
        mixed = any(extinction_shows(optics, near, far) > FAINT for near, far in pairs)
    default = (rules.entry, rules.facets, rules.wrong_side) == (
        spheroid.UNIFORM,
        facets.PROJECTED,
        LOBE,
    )
    return Features(
        wet=_feature(slab.saturation > 0.0),
        faceted=_feature(bool((grains.facetness > 0.0).any())),
        mixed=_feature(bool(mixed)),
        variant=_feature(not default),
        positions=_feature(positions),
    )


def extinction_shows(optics: Optics, near: int, far: int) -> float:
    """Return by how much the far side's extinction moves the reflectance of diffuse light.

    The integral of 2μ |R(n, k) − R(n, 0)| over the cosine of incidence μ.

    Parameters
    ----------
    optics : Optics
    near, far : int
        Materials on the side of incidence and beyond.
    """
    n1, n2, k2 = float(optics.n[near]), float(optics.n[far]), float(optics.k[far])
    return float(_shift(n1, n2, k2)) if k2 > 0.0 else 0.0


@entry
def _shift(n1, n2, k2):
    total = 0.0
    for i in range(_COSINE.size):
        with_k = interface(n1, n2, k2, _COSINE[i])[0]
        total += _WEIGHT[i] * abs(with_k - interface(n1, n2, 0.0, _COSINE[i])[0])
    return total


def _feature(present: bool) -> bool | None:
    return True if present else None
