"""Reflected radiance of dry layers over a Lambertian ground, by azimuthal modes.

The radiance in a direction e under a beam from a direction o follows from invariance (Ambartsumian;
Chandrasekhar 1950, Radiative Transfer): a thin layer on top of a homogeneous slab has the same
effect as a thin layer below it.  With the reflection r and the transmission t between directions
and streams, the direct transmission δ, the extinction σ, and the scattering s within a hemisphere
and p between both,

    σ (μ_e + μ_o) G_eo = ½ p_eo (1 − δ_e δ_o) + X_eo + X_oe,
    X_eo = μ_e r_e (s_o + ½ μ_o p r_o)ᵀ − μ_e t_e (δ_o p_o + ½ μ_o p t_o)ᵀ,

which is reciprocal by its form.  The first term is light scattered once.  It is left out of the
modes and computed at the scattering angle, with the phase function before truncation (TMS, Nakajima
& Tanaka 1988, Journal of Quantitative Spectroscopy and Radiative Transfer 40, 51).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.slab import LayerOptics, Slab, compute_scattering, solve_slab
from splits.discrete_ordinates.streams import Streams, compute_legendre


class Geometry(NamedTuple):
    """Directions of light and of observation.

    Attributes
    ----------
    beams, views : float, shape (beams,) and (views,)
        Cosines with the normal.
    azimuths : float, shape (azimuths,)
        Between the horizontal directions in which the light travels before and after reflection, in
        radians: 0 is forward, π backward.
    """

    beams: np.ndarray
    views: np.ndarray
    azimuths: np.ndarray

    def compute_scattering_cosines(self) -> np.ndarray:
        """Return the cosines of the scattering angle, shape (beams, views, azimuths)."""
        beam, view = self.beams[:, np.newaxis], self.views
        sines = np.sqrt((1.0 - beam**2) * (1.0 - view**2))
        cosines = sines[..., np.newaxis] * np.cos(self.azimuths) - (beam * view)[..., np.newaxis]
        clipped: np.ndarray = np.clip(cosines, -1.0, 1.0)
        return clipped

    def list_directions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the cosines of all directions, and the indices of the beams and of the views."""
        both = np.concatenate([self.beams, self.views])
        cosines, indices = np.unique(both, return_inverse=True)
        return cosines, indices[: self.beams.size], indices[self.beams.size :]


class _Reflection(NamedTuple):
    """Reflection of what lies below a level, for one azimuthal mode.

    Attributes
    ----------
    streams : float, shape (..., streams, streams)
    beams : float, shape (..., directions, streams)
        As `Slab.beam_reflection`.
    between : float, shape (..., directions, directions)
        G, 2π times the contribution of the mode to the BRDF, without light scattered only once.
    """

    streams: np.ndarray
    beams: np.ndarray
    between: np.ndarray


def compute_brdf(
    optics: LayerOptics,
    ground: np.ndarray,
    streams: Streams,
    geometry: Geometry,
    phase_function: np.ndarray | None = None,
    tolerance: float = 1e-6,
) -> np.ndarray:
    """Return the bidirectional reflectance distribution function, in 1/sr.

    Parameters
    ----------
    optics : LayerOptics
        Layers of one state, top first, along the first dimension, with all moments that are known:
        they are truncated here.
    ground : float, shape (...)
        Albedo of the Lambertian ground.
    streams : Streams
    geometry : Geometry
    phase_function : float, shape (layers, ..., beams, views, azimuths), optional
        At the scattering angles (`Geometry.compute_scattering_cosines`), with a mean of 1 over the
        sphere.  By default the Legendre series of all moments.
    tolerance : float
        Modes are added until two in succession are below this fraction of the BRDF everywhere.

    Returns
    -------
    float, shape (..., beams, views, azimuths)
    """
    moments = optics.scattering[..., 0, 0, :]
    if phase_function is None:
        scattering = sum_legendre(moments, geometry.compute_scattering_cosines())
    else:
        scattering = moments[..., :1, np.newaxis, np.newaxis] * phase_function
    n = 2 * streams.cosines.size
    truncated = truncate_known_moments(optics, n)
    brdf = scatter_once(truncated, scattering, geometry)
    directions, beams, views = geometry.list_directions()
    successive = 0
    for mode in range(n):
        multiple = _reflect_mode(truncated, ground, streams, directions, mode).between
        selected = multiple[..., beams[:, np.newaxis], views] / (2.0 * np.pi)
        factor = np.cos(mode * geometry.azimuths) * (1.0 if mode == 0 else 2.0)
        brdf = brdf + selected[..., np.newaxis] * factor
        small = (2.0 * np.abs(selected) <= tolerance * np.abs(brdf).min(axis=-1)).all()
        successive = successive + 1 if small else 0
        if mode > 0 and successive >= 2:
            break
    return brdf


def truncate_known_moments(optics: LayerOptics, streams: int) -> LayerOptics:
    """Return truncated optics (`LayerOptics.truncate`), with moments of 0 beyond those known."""
    missing = max(streams + 1 - optics.scattering.shape[-1], 0)
    padding = [(0, 0)] * (optics.scattering.ndim - 1) + [(0, missing)]
    return optics._replace(scattering=np.pad(optics.scattering, padding)).truncate(streams)


def sum_legendre(moments: np.ndarray, cosines: np.ndarray) -> np.ndarray:
    """Return ∑ (2l + 1) χ_l P_l of moments (..., orders), shape (..., *cosines.shape)."""
    orders = np.arange(moments.shape[-1])
    functions = compute_legendre(cosines.ravel(), 0, orders.size)
    values = ((2.0 * orders + 1.0) * moments) @ functions
    return values.reshape(*moments.shape[:-1], *cosines.shape)


def scatter_once(optics: LayerOptics, scattering: np.ndarray, geometry: Geometry) -> np.ndarray:
    """Return the BRDF of light scattered once, ∑ b p (e^(−mτ) − e^(−m(τ + Δτ))) / 4π σ (μ_e + μ_o).

    Parameters
    ----------
    optics : LayerOptics
        Truncated, with the extinction σ.
    scattering : float, shape (layers, ..., beams, views, azimuths)
        Scattering coefficients times the phase function before truncation, b p.
    geometry : Geometry
    """
    beam, view = geometry.beams[:, np.newaxis], geometry.views
    air_mass = 1.0 / beam + 1.0 / view
    extinction = optics.extinction[..., np.newaxis]
    thickness = optics.thickness[..., np.newaxis, np.newaxis] * extinction
    depth = np.zeros_like(thickness[0])
    brdf = np.zeros(scattering.shape[1:])
    for own, sigma, source in zip(thickness, extinction, scattering, strict=True):
        factor = np.exp(-depth * air_mass) * -np.expm1(-own * air_mass)
        factor = factor / (4.0 * np.pi * sigma * (beam + view))
        brdf = brdf + factor[..., np.newaxis] * source
        depth = depth + own
    return brdf


def _reflect_mode(
    optics: LayerOptics, ground: np.ndarray, streams: Streams, cosines: np.ndarray, mode: int
) -> _Reflection:
    """Return the reflection of a stack of layers of truncated optics for one azimuthal mode."""
    directions = cosines[np.newaxis]
    slabs = solve_slab(optics, streams, directions, mode)
    scattering = compute_scattering(optics, streams, directions, mode)
    between = _scatter_repeatedly(slabs, scattering, optics.extinction[..., np.newaxis], cosines)
    n_layers = optics.thickness.shape[0]
    bottom = slabs.select(n_layers - 1)
    # A Lambertian ground reflects into mode 0 only.
    if mode == 0:
        albedo = np.broadcast_to(ground, optics.thickness.shape[1:])
        reflection = _add_layer(bottom, between[-1], _reflect_ground(albedo, streams, cosines.size))
    else:
        reflection = _Reflection(bottom.reflection, bottom.beam_reflection, between[-1])
    for layer in reversed(range(n_layers - 1)):
        reflection = _add_layer(slabs.select(layer), between[layer], reflection)
    return reflection


def _scatter_repeatedly(
    slab: Slab, scattering: list[tuple[np.ndarray, np.ndarray]], extinction: np.ndarray,
    cosines: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return G between directions without the light scattered once, see the module.

    Parameters
    ----------
    slab : Slab
    scattering : pairs of float
        See `compute_scattering`.
    extinction : float, shape (..., 1, 1)
    cosines : float, shape (directions,)
    """
    even, odd = scattering
    across_streams, across = (0.5 * (a - b) for a, b in zip(even, odd, strict=True))
    within = 0.5 * (even[1] + odd[1])
    reflected = cosines[:, np.newaxis] * slab.beam_reflection
    transmitted = cosines[:, np.newaxis] * slab.beam_transmission
    at_top = within + 0.5 * reflected @ across_streams
    at_bottom = slab.direct[..., np.newaxis] * across + 0.5 * transmitted @ across_streams
    half = reflected @ _transpose(at_top) - transmitted @ _transpose(at_bottom)
    between: np.ndarray = half + _transpose(half)
    return between / (extinction * (cosines[:, np.newaxis] + cosines))


def _reflect_ground(albedo: np.ndarray, streams: Streams, n_directions: int) -> _Reflection:
    doubled = 2.0 * albedo[..., np.newaxis, np.newaxis]
    lambertian, directions = streams.flux_vector, np.ones(n_directions)
    return _Reflection(
        doubled * np.outer(lambertian, lambertian),
        doubled * np.outer(directions, lambertian),
        doubled * np.outer(directions, directions),
    )


def _add_layer(slab: Slab, between: np.ndarray, below: _Reflection) -> _Reflection:
    """Return the reflection of a layer with a direction-to-direction reflection, and of all below.

    With the reflections R, B and G of what lies below, and those of the layer in lower case, the
    radiance that rises between both is (1 − R r)⁻¹ (R tᵀ + Bᵀ δ).
    """
    direct = slab.direct[..., np.newaxis]
    inverse = np.linalg.inv(np.eye(slab.reflection.shape[-1]) - slab.reflection @ below.streams)
    from_direct = direct * below.beams
    rising = (slab.beam_transmission @ below.streams + from_direct) @ inverse
    leaving = slab.beam_transmission + from_direct @ slab.reflection
    return _Reflection(
        slab.reflection + slab.transmission @ below.streams @ inverse @ slab.transmission,
        slab.beam_reflection + rising @ slab.transmission,
        between
        + rising @ _transpose(leaving)
        + slab.beam_transmission @ _transpose(from_direct)
        + direct * below.between * _transpose(direct),
    )


def _transpose(matrix: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrix, -1, -2)
