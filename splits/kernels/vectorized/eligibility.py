"""Choice of the kernel for a scene, and the features for which it is compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import config

from splits.kernels.base.scene import DRY_PORE, NO_PARTICLES, WET_PORE, Optics, Scene
from splits.kernels.compiler.features import Features
from splits.kernels.compiler.jit import entry_point_no_refcount
from splits.kernels.grains.population import GrainTypes
from splits.kernels.optics.fresnel import fresnel

EXTINCTION_TOLERANCE = 1e-5
"""Largest change of the diffuse reflectance for which extinction coefficients are neglected in
reflection.  Their effect is largest for an absorbing medium of lower index."""

MIN_FIRST_DEPTH = 1e-6
"""Smallest mean depth of the first grain in a beam for single precision, in semi-major axes of the
largest grain.

It decides whether the grain fits below the boundary.  Relative to the grains that fit, 1 % of the
decisions differ at this depth from double precision, in both directions alike.
"""

MAX_INDEX = 1e3
"""Largest refractive index and extinction coefficient whose powers single precision can hold."""

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(96)

MAX_DEPTH_MFP = 1e5
"""Largest depth in mean free paths for single precision.

Rounding of positions is then below 1 % of the mean free path.
"""


def select_features(scene: Scene, optics: Optics) -> Features | None:
    """Return the features of a scene, or None if only the scalar kernel supports it.

    The vectorized kernel does not support polarization, layers of particles, grains other than
    spheroids, pores of more than two media, analog absorption, more than one coating, samples
    deeper than `MAX_DEPTH_MFP` mean free paths, beams with their first grain above
    `MIN_FIRST_DEPTH`, and indices above `MAX_INDEX` or below its inverse; and it needs the
    compiler.

    Parameters
    ----------
    scene, optics
        See `splits.kernels.base.scene`.
    """
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return None
    source, layers, types, rules, *_ = scene
    depth = layers.boundaries[0] - layers.boundaries[-1]
    if (layers.particle_row != NO_PARTICLES).any() or layers.pore_cdf.shape[1] > 0:
        return None
    if type(types) is not GrainTypes or scene.stokes is not None:
        return None
    if (
        rules.analog
        or types.n_shells.max() > 2
        or depth * layers.collision_coefficient.max() > MAX_DEPTH_MFP
    ):
        return None
    first_depth = (
        source.cos_incidence / layers.collision_coefficient[0] * types.inverse_semi_major.min()
    )
    if source.diffuse_fraction < 1.0 and first_depth < MIN_FIRST_DEPTH:
        return None
    if max(optics.n.max(), optics.k.max()) > MAX_INDEX or optics.n.min() < 1.0 / MAX_INDEX:
        return None
    layered = layers.collision_coefficient.size > 1
    mixed = layered or types.n_shells.size > 1 or types.n_shells.max() > 1
    absorbing = False
    if not mixed:
        core = types.material[0, 0]
        pores = [DRY_PORE, WET_PORE] if layers.wet_fraction.max() > 0.0 else [DRY_PORE]
        pairs = [(pore, core) for pore in pores] + [(core, pore) for pore in pores]
        absorbing = any(
            compute_extinction_effect(optics, near, far) > EXTINCTION_TOLERANCE
            for near, far in pairs
        )
    return Features(
        wet=_to_feature(layers.wet_fraction.max() > 0.0),
        faceted=_to_feature(bool((types.facetness > 0.0).any())),
        absorbing=_to_feature(absorbing),
        mixed=_to_feature(bool(mixed)),
        layered=_to_feature(layered),
    )


def compute_extinction_effect(optics: Optics, near: int, far: int) -> float:
    """Return the effect of the extinction of the far side on the diffuse reflectance.

    The integral of 2μ |R(n, k) − R(n, 0)| over the cosine of incidence μ.

    Parameters
    ----------
    optics : Optics
    near, far : int
        Materials on the side of incidence and on the far side.
    """
    n1, n2, k2 = float(optics.n[near]), float(optics.n[far]), float(optics.k[far])
    return float(_integrate_extinction_effect(n1, n2, k2)) if k2 > 0.0 else 0.0


@entry_point_no_refcount
def _integrate_extinction_effect(n1, n2, k2):
    """Integrate the effect on both sides of the critical angle, where the difference peaks.

    Nodes are quadratically denser towards that angle, where the reflectance has a square root.
    """
    critical = math.sqrt(max(1.0 - (n2 / n1) ** 2, 0.0)) if n2 < n1 else 0.0
    total = 0.0
    for i in range(_GAUSS_NODES.size):
        t = 0.5 * (_GAUSS_NODES[i] + 1.0)
        for span in (critical - 1.0, critical):
            # A fraction t² of the interval from the critical cosine to 1 or to 0.
            mu = critical - span * t * t
            if span != 0.0:
                effect = fresnel(n1, n2, k2, mu)[0] - fresnel(n1, n2, 0.0, mu)[0]
                total += _GAUSS_WEIGHTS[i] * t * abs(span) * 2.0 * mu * abs(effect)
    return total


def _to_feature(present: bool) -> bool | None:
    return True if present else None
