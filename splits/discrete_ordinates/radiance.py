"""Radiance that plane layers reflect and transmit between two directions, by azimuthal modes.

By reciprocity, the light that reaches the direction of a beam from the direction of a view has the
BRDF, or the BTDF, of a beam that is seen from there.  Beams along the views enter at the top and at
the bottom; what a layer scatters out of them rises and falls on both of its sides, and leaves along
the beams at the top.  Light scattered once is left out of the modes and computed at the scattering
angle, with the phase function before truncation (TMS, Nakajima & Tanaka 1988, Journal of
Quantitative Spectroscopy and Radiative Transfer 40, 51).
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legval

from splits.discrete_ordinates.adding import Faces, add_above, make_outlet, reflect_at_bottom
from splits.discrete_ordinates.direct_light import (
    DirectLight,
    PhaseFunction,
    scatter_once,
    trace_direct_light,
)
from splits.discrete_ordinates.geometry import Geometry, PlaneLayers
from splits.discrete_ordinates.layer_radiance import LayerRadiance, solve_layer_radiance
from splits.discrete_ordinates.streams import Streams


def compute_bidirectional(
    layers: PlaneLayers,
    streams: Streams,
    geometry: Geometry,
    evaluate: PhaseFunction | None = None,
    tolerance: float = 1e-6,
) -> np.ndarray:
    """Return the BRDF and the BTDF of scattered light, in 1/sr.

    Parameters
    ----------
    layers : PlaneLayers
        With all moments that are known: they are truncated here.
    streams : Streams
    geometry : Geometry
    evaluate : callable, optional
        Phase function; by default the Legendre series of all moments.
    tolerance : float
        Modes are added until two in succession are below this fraction of both everywhere.

    Returns
    -------
    float, shape (2, ..., beams, views, azimuths)
        The BTDF over a ground is that of the light that falls on the ground.
    """
    n = 2 * streams.cosines.size
    truncated = layers.truncate(n)
    scattering = layers.optics.scattering
    evaluate = evaluate or (lambda a, b, cosines: sum_legendre(scattering[..., a, b, :], cosines))
    values = scatter_once(truncated, geometry, evaluate)
    faces = layers.make_faces(streams, geometry.beams)
    views = trace_direct_light(truncated, geometry.views)
    successive = 0
    for mode in range(n):
        multiple = _solve_mode(truncated, faces, streams, geometry, views, mode) / (2.0 * np.pi)
        factor = np.cos(mode * geometry.azimuths) * (1.0 if mode == 0 else 2.0)
        values = values + multiple[..., np.newaxis] * factor
        small = (2.0 * np.abs(multiple) <= tolerance * np.abs(values).min(axis=-1)).all()
        successive = successive + 1 if small else 0
        if mode > 0 and successive >= 2:
            break
    return values


def sum_legendre(moments: np.ndarray, cosines: np.ndarray) -> np.ndarray:
    """Return ∑ (2l + 1) χ_l P_l of moments (layers, ..., orders).

    Cosines have the shape (..., beams, views, azimuths), and so has the sum of each layer.
    """
    factors = (2.0 * np.arange(moments.shape[-1]) + 1.0) * moments
    coefficients = np.moveaxis(factors, -1, 0)[..., np.newaxis, np.newaxis, np.newaxis]
    return legval(cosines, coefficients, tensor=False)


def _solve_mode(
    layers: PlaneLayers, faces: Faces, streams: Streams, geometry: Geometry,
    views: tuple[DirectLight, DirectLight], mode: int,
) -> np.ndarray:  # fmt: skip
    """Return 2π times the contribution of a mode, without light scattered only once.

    The shape is (2, ..., beams, views).
    """
    n_beams, n_views = geometry.beams.size, geometry.views.size
    beam, view = layers.refract(geometry.beams), layers.refract(geometry.views)
    solved = solve_layer_radiance(layers.optics, streams, beam, view, mode)
    n_streams = solved.isotropic.shape[-1] - n_beams * layers.optics.extinction.shape[-1]
    top, bottom = faces.boundaries
    # A Lambertian ground reflects into mode 0 only.
    ground = layers.ground if mode == 0 else np.zeros_like(layers.ground)
    reflection, _ = reflect_at_bottom(bottom, solved.isotropic[-1], ground, n_streams)
    upward, downward = _scatter_views(solved, views)
    rising = np.zeros(upward.shape[1:])
    rising[..., :n_views] = _reflect_views(faces, solved.isotropic[-1], ground, views[0])
    for layer in reversed(range(len(solved.elements))):
        interface = faces.interfaces[layer] if layer < len(solved.elements) - 1 else None
        if interface is not None:
            reflection, passage = add_above(interface, reflection)
            rising = passage @ rising
        below, (reflection, passage) = reflection, add_above(solved.elements[layer], reflection)
        rising = upward[layer] + passage @ (rising + below @ downward[layer])
    outlet = make_outlet(reflection, top, solved.isotropic[0], n_streams)[..., :-1, :]
    leaving = outlet @ rising
    return np.stack([leaving[..., :n_views], leaving[..., n_views:]])


def _scatter_views(
    solved: LayerRadiance, views: tuple[DirectLight, DirectLight]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the light that layers scatter upwards and downwards out of the beams of the views.

    The shape is (layers, ..., radiances, 2 × views): beams from the top, then those from the
    bottom.
    """
    both = []
    for one in views:
        falling, rising = (np.swapaxes(values, -1, -2) for values in (one.falling, one.rising))
        both.append([
            np.einsum("...rsv,...sv->...rv", solved.reflection, a)
            + np.einsum("...rsv,...sv->...rv", solved.transmission, b)
            for a, b in ((falling, rising), (rising, falling))
        ])  # fmt: skip
    upward, downward = (np.concatenate(parts, axis=-1) for parts in zip(*both, strict=True))
    return upward, downward


def _reflect_views(
    faces: Faces, isotropic: np.ndarray, ground: np.ndarray, views: DirectLight
) -> np.ndarray:
    """Return the light of the beams of the views that a ground reflects."""
    bottom = faces.boundaries[1]
    gain = ground / (1.0 - ground * bottom.outer_reflectance[..., -1])
    passing = (bottom.transmission * isotropic)[..., :, np.newaxis]
    reflected: np.ndarray = (
        2.0 * gain[..., np.newaxis, np.newaxis] * passing * views.transmitted[..., np.newaxis, :]
    )
    return reflected
