"""Next-event estimation: every scattering contributes to each view direction.

Budak & Grimailo 2020, Eqs 4-5 (local estimation): the radiance on a circle above the layer,
without collectors of finite size.  Errors come from the scatter of batches of rays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from splits.core.validation import invalid
from splits.kernels.interface import compute_fresnel_mueller
from splits.kernels.phase_function import separate_peak
from splits.kernels.scene import Scene
from splits.kernels.transport.next_event import ABOVE, BELOW, Detectors
from splits.media.medium import Medium, ParticleMedium

NEGLIGIBLE_PROBABILITY = 1e-16
"""Probability of more successive scatterings into a peak than are stored."""
MAX_PEAK_FRACTION = 0.99
"""Largest probability of scattering into a peak: above it, light needs hundreds of scatterings to
change its direction."""


def get_detected_layers(medium: Medium) -> tuple[ParticleMedium, ...]:
    """Return the particle layers of a medium whose light reaches detectors along known paths.

    Raises
    ------
    ValueError
        For grains, for a rough surface, for the ground of a stack, for narrow phase functions in a
        stack, and for a phase function that is nearly all peak.
    """
    layers = tuple(layer for layer in medium.scene_layers if not layer.has_grains)
    if len(layers) < len(medium.scene_layers):
        raise _reject_estimator("for grains")
    if layers[0].make_height_fields() is not None:
        hint = "no single path leads through it to a given direction; bins have Stokes parameters"
        raise _reject_estimator("under a rough surface", hint)
    peaks = [separate_peak(layer.kernel_phase_function) for layer in layers]
    if any(peak is not None and peak.fraction > MAX_PEAK_FRACTION for peak in peaks):
        hint = f"more than {MAX_PEAK_FRACTION:.0%} of the scattered light goes into a narrow peak"
        raise _reject_estimator("for this phase_function", hint)
    if len(layers) > 1 and any(peak is not None for peak in peaks):
        raise _reject_estimator("for this phase_function", "narrow peaks require a single layer")
    if medium.reflecting_ground is not None:
        raise _reject_estimator("over the ground of a stack")
    return layers


def _reject_estimator(circumstances: str, hint: str = "") -> Exception:
    """Return the error that this estimator is not possible in some circumstances."""
    return invalid("estimator", "next_event", f"expansion or bins {circumstances}", hint)


def make_detectors(
    layers: Sequence[ParticleMedium], scene: Scene, polar: np.ndarray, azimuth: np.ndarray
) -> Detectors:
    """Return detectors on a grid of directions, azimuth running fastest.

    Parameters
    ----------
    layers : sequence of ParticleMedium
        See `get_detected_layers`.
    scene : Scene
    polar, azimuth : float
        Degrees, of the directions outside.
    """
    index, lowest = np.array([layer.refractive_index for layer in layers]), layers[-1]
    outer_polar, azimuth_rad = np.radians(np.meshgrid(polar, azimuth, indexing="ij")).reshape(2, -1)
    plane = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=1)
    sine = (np.sin(outer_polar) / index[:, np.newaxis])[..., np.newaxis]
    cosine = compute_refracted_cosines(index, outer_polar)[..., np.newaxis]
    thickness = -np.diff(scene.layers.boundaries) * scene.layers.collision_coefficient
    is_open = scene.bottom_albedo is None and scene.opaque is None
    has_lower_side = is_open and math.isfinite(thickness[-1])
    transmission = compute_transmission(
        index, thickness, outer_polar, has_lower_side, scene.stokes is not None
    )
    peak = separate_peak(lowest.kernel_phase_function)
    orders = 0 if peak is None else math.log(NEGLIGIBLE_PROBABILITY) / math.log(peak.fraction)
    return Detectors(
        np.concatenate([sine * plane, cosine], axis=2),
        plane,
        transmission,
        lowest.refractive_index,
        float(thickness[-1]),
        has_lower_side,
        np.zeros((2, len(plane), 4)),
        lowest.kernel_phase_function,
        peak,
        0.0 if peak is None else peak.fraction * lowest.single_scattering_albedo,
        np.zeros((1 + math.ceil(orders), 3)),
    )


def compute_refracted_cosines(index: np.ndarray, outer_polar: np.ndarray) -> np.ndarray:
    """Return the cosines in media of indices, at least 1, of directions outside (rad).

    The sum has no cancellation at grazing directions.

    Returns
    -------
    float, shape (media, detectors)
    """
    squared = (index[:, np.newaxis] ** 2 - 1.0) + np.cos(outer_polar) ** 2
    return np.sqrt(squared) / index[:, np.newaxis]


def compute_transmission(
    index: np.ndarray,
    thickness: np.ndarray,
    outer_polar: np.ndarray,
    has_lower_side: bool,
    polarized: bool,
) -> np.ndarray:
    """Return the transmission from the boundaries of layers to directions outside.

    At an interface, light that is parallel and perpendicular to the plane of incidence, and U and
    V, are reflected and refracted independently.  Light that arrives upwards at the upper boundary
    of layer l, or downwards at the lower one, is transmitted to the detectors as

        u_l = R_l t_l d_l + T_l t_(l−1) u_(l−1),    d_l = R_(l+1) t_l u_l + T_(l+1) t_(l+1) d_(l+1),

    with the direct transmittance t of a layer, and T_0 in place of the second term for detectors
    above (T of the lowest interface for those below).  The solution sums all reflections.

    Parameters
    ----------
    index, thickness : float, shape (layers,)
        Refractive indices, at least 1, and vertical optical thicknesses.
    outer_polar : float, shape (detectors,)
        Polar angles of the directions outside (rad).
    has_lower_side : bool
        Whether the lowest interface transmits and reflects; otherwise it does neither.
    polarized : bool
        Otherwise all light is reflected like unpolarized light.

    Returns
    -------
    float, shape (2, 2, layers, detectors, 3)
        See `splits.kernels.transport.next_event.Detectors`.
    """
    n_layers = len(index)
    # No light from a direction outside is totally reflected, as no index is less than 1.
    media = np.array([1.0, *index, 1.0])
    cosine = compute_refracted_cosines(media, outer_polar)
    reflectance, transmittance = np.zeros((2, n_layers + 1, len(outer_polar), 3))
    for j, k in np.ndindex(n_layers + has_lower_side, len(outer_polar)):
        mueller = compute_fresnel_mueller(media[j], media[j + 1], cosine[j, k])
        plus, minus, real, _ = mueller.reflection
        reflectance[j, k] = [plus + minus, plus - minus, real] if polarized else plus
        plus, minus, root, _ = mueller.transmission
        transmittance[j, k] = [plus + minus, plus - minus, root] if polarized else plus
    direct = np.exp(-thickness[:, np.newaxis] / cosine[1:-1])[..., np.newaxis]
    up, down = range(n_layers), range(n_layers, 2 * n_layers)
    system = np.zeros((len(outer_polar), 3, 2 * n_layers, 2 * n_layers)) + np.eye(2 * n_layers)
    source = np.zeros((len(outer_polar), 3, 2 * n_layers, 2))
    system[..., up, down] = np.moveaxis(-reflectance[:-1] * direct, 0, -1)
    system[..., down, up] = np.moveaxis(-reflectance[1:] * direct, 0, -1)
    inner = transmittance[1:-1]
    system[..., up[1:], up[:-1]] = np.moveaxis(-inner * direct[:-1], 0, -1)
    system[..., down[:-1], down[1:]] = np.moveaxis(-inner * direct[1:], 0, -1)
    source[..., up[0], ABOVE] = transmittance[0]
    source[..., down[-1], BELOW] = transmittance[-1]
    solution = np.linalg.solve(system, source).reshape(-1, 3, 2, n_layers, 2)
    # dΩ inside/dΩ outside = cosθ/(n² cosθ'); a BRDF is per outer cosine.
    solid_angle_ratio = 1.0 / (media**2 * cosine.T)[:, 1:-1].T
    return np.transpose(solution, (4, 2, 3, 0, 1)) * solid_angle_ratio[..., np.newaxis]
