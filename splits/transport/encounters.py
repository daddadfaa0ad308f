"""What a ray meets in a layer: faces and particles, with and without polarization."""

from __future__ import annotations

from splits.transport.frames import dot, mirrored
from splits.transport.fresnel import interface, refracted
from splits.transport.jit import kernel
from splits.transport.phase import scattered
from splits.transport.rng import uniform
from splits.transport.stokes import (
    any_reference,
    reflect_or_refract_polarized,
    reflected_polarized,
    scatter_polarized,
)


@kernel
def meet_face(state, dx, dy, dz, nx, ny, nz, n1, n2, polar):
    """Reflect or refract a ray at a facet whose normal n is against it.

    Parameters
    ----------
    n1, n2 : float
        Refractive index on the side of incidence and beyond.
    polar : float64[6] or None
        Reference direction and Q, U, V over I of the ray, changed in place.

    Returns
    -------
    passed : bool
    d : 3 float
    """
    if polar is not None:
        passed, dx, dy, dz, e1, e2, e3, q, u, v = reflect_or_refract_polarized(
            state, dx, dy, dz, polar[0], polar[1], polar[2], polar[3], polar[4], polar[5],
            nx, ny, nz, n1, n2,
        )  # fmt: skip
        _keep(polar, e1, e2, e3, q, u, v)
        return passed, dx, dy, dz
    cos_i = min(max(-dot(dx, dy, dz, nx, ny, nz), 1e-12), 1.0)
    reflectance, ratio, cos_t = interface(n1, n2, 0.0, cos_i)
    if uniform(state) < reflectance:
        dx, dy, dz = mirrored(dx, dy, dz, nx, ny, nz)
        return False, dx, dy, dz
    if n1 != n2:
        dx, dy, dz = refracted(dx, dy, dz, nx, ny, nz, cos_i, ratio, cos_t)
    return True, dx, dy, dz


@kernel
def only_reflected(dx, dy, dz, nx, ny, nz, n2, polar):
    """Reflect a ray from outside at a facet whose normal n is against it.

    Returns
    -------
    share : float
        Of the light that is reflected.
    d : 3 float
    """
    if polar is not None:
        share, dx, dy, dz, e1, e2, e3, q, u, v = reflected_polarized(
            dx, dy, dz, polar[0], polar[1], polar[2], polar[3], polar[4], polar[5],
            nx, ny, nz, 1.0, n2,
        )  # fmt: skip
        _keep(polar, e1, e2, e3, q, u, v)
        return share, dx, dy, dz
    cos_i = min(max(-dot(dx, dy, dz, nx, ny, nz), 1e-12), 1.0)
    share, _, _ = interface(1.0, n2, 0.0, cos_i)
    dx, dy, dz = mirrored(dx, dy, dz, nx, ny, nz)
    return share, dx, dy, dz


@kernel
def _keep(polar, e1, e2, e3, q, u, v):
    polar[0], polar[1], polar[2] = e1, e2, e3
    polar[3], polar[4], polar[5] = q, u, v


@kernel
def scatter(state, dx, dy, dz, phase, polar):
    """Return the direction after scattering by a particle."""
    if polar is not None:
        dx, dy, dz, e1, e2, e3, q, u, v = scatter_polarized(
            state, phase, dx, dy, dz, polar[0], polar[1], polar[2], polar[3], polar[4], polar[5]
        )
        _keep(polar, e1, e2, e3, q, u, v)
        return dx, dy, dz
    return scattered(state, phase, dx, dy, dz)


@kernel
def depolarize(dx, dy, dz, polar):
    """Forget a ray's polarization: what the source sends and the bottom reflects has none."""
    if polar is not None:
        e1, e2, e3 = any_reference(dx, dy, dz)
        _keep(polar, e1, e2, e3, 0.0, 0.0, 0.0)
