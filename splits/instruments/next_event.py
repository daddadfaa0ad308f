"""Next-event estimation: every scattering contributes to each view direction.

Budak & Grimailo 2020, Eqs 4-5 (local estimation): the radiance on a circle above the layer,
without collectors of finite size.  Errors come from the scatter of batches of rays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from splits.core.validation import invalid
from splits.kernels.base.scene import Scene
from splits.kernels.optics.forward_peak import separate_peak
from splits.kernels.optics.polarized_interface import compute_fresnel_mueller
from splits.kernels.transport.history import trace_to_detectors
from splits.kernels.transport.next_event import Detectors
from splits.media.medium import Medium
from splits.media.particle_layer import ParticleLayer
from splits.simulation.scene import build_scene
from splits.simulation.tally import Stratum, Tally
from splits.simulation.tracer import Tracer

NEGLIGIBLE_PROBABILITY = 1e-16
"""Probability of more successive scatterings into a peak than are stored."""
MAX_PEAK_FRACTION = 0.99
"""Largest probability of scattering into a peak: above it, light needs hundreds of scatterings to
change its direction."""


def get_detected_layers(medium: Medium) -> tuple[ParticleLayer, ...]:
    """Return the particle layers of a medium whose light reaches detectors along a single path.

    Raises
    ------
    ValueError
        For grains, for a rough surface, for layers of different refractive indices or with narrow
        phase functions in a stack, and for a phase function that is nearly all peak.
    """
    layers, allowed = medium.scene_layers, "expansion or bins"
    if any(layer.has_grains for layer in layers):
        raise invalid("estimator", "next_event", f"{allowed} for grains")
    if layers[0].make_height_fields() is not None:
        raise invalid(
            "estimator", "next_event", f"{allowed} under a rough surface",
            "no single path leads through it to a given direction; bins have Stokes parameters",
        )  # fmt: skip
    peaks = [separate_peak(layer.kernel_phase_function) for layer in layers]
    if any(peak is not None and peak.fraction > MAX_PEAK_FRACTION for peak in peaks):
        raise invalid(
            "estimator", "next_event", f"{allowed} for this phase_function",
            f"more than {MAX_PEAK_FRACTION:.0%} of the scattered light goes into a narrow peak",
        )  # fmt: skip
    if len(layers) > 1:
        if len({layer.refractive_index for layer in layers}) > 1:
            raise invalid("estimator", "next_event", f"{allowed} for layers of different indices")
        if any(peak is not None for peak in peaks):
            hint = "narrow peaks require a single layer"
            raise invalid("estimator", "next_event", f"{allowed} for this phase_function", hint)
    if medium.reflecting_ground is not None:
        raise invalid("estimator", "next_event", f"{allowed} over the ground of a stack")
    return layers


def make_detectors(
    layers: Sequence[ParticleLayer], scene: Scene, polar: np.ndarray, azimuth: np.ndarray
) -> Detectors:
    """Return detectors on a grid of directions, azimuth running fastest.

    Parameters
    ----------
    layers : sequence of ParticleLayer
        See `get_detected_layers`.
    scene : Scene
    polar, azimuth : float
        Degrees, of the directions outside.
    """
    n, lowest = layers[0].refractive_index, layers[-1]
    outer_polar, azimuth_rad = np.radians(np.meshgrid(polar, azimuth, indexing="ij")).reshape(2, -1)
    sine = np.sin(outer_polar) / n
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    interfaces = [compute_fresnel_mueller(n, 1.0, c) for c in cosine]
    reflection = np.array([interface.reflection for interface in interfaces])
    transmission = np.array([interface.transmission for interface in interfaces])
    if scene.stokes is None:
        reflection = reflection * [1.0, 0.0, 0.0, 0.0]
        transmission = transmission * [1.0, 0.0, 0.0]
    thickness = float((-np.diff(scene.layers.boundaries)) @ scene.layers.collision_coefficient)
    is_open = scene.bottom_albedo is None and scene.opaque is None
    peak = separate_peak(lowest.kernel_phase_function)
    orders = 0 if peak is None else math.log(NEGLIGIBLE_PROBABILITY) / math.log(peak.fraction)
    return Detectors(
        np.stack([sine * np.cos(azimuth_rad), sine * np.sin(azimuth_rad), cosine], axis=1),
        np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=1),
        # dΩ inside/dΩ outside = cosθ/(n² cosθ'); a BRDF is per outer cosine.
        transmission / (n**2 * cosine[:, np.newaxis]),
        reflection,
        np.exp(-thickness / cosine),
        n,
        thickness,
        is_open and math.isfinite(thickness),
        np.zeros((2, len(cosine), 4)),
        lowest.kernel_phase_function,
        peak,
        0.0 if peak is None else peak.fraction * lowest.single_scattering_albedo,
        np.zeros((1 + math.ceil(orders), 3)),
    )


class DetectorTracer(Tracer):
    """Tracer of rays in layers of particles under a smooth surface that contribute to detectors.

    Parameters
    ----------
    medium : Medium
    incidence_deg : float
    polar, azimuth : float
        Degrees, see `make_detectors`.
    side : int
        0 reflected, 1 transmitted, to which the requested error applies.

    Raises
    ------
    ValueError
        See `get_detected_layers`.
    """

    def __init__(
        self,
        medium: Any,
        incidence_deg: float,
        polar: np.ndarray,
        azimuth: np.ndarray,
        side: int,
    ) -> None:
        self.layers = get_detected_layers(medium)
        self.index = medium.compute_refractive_indices(np.zeros(1))
        scene = build_scene(medium, incidence_deg, False)
        self.detectors = make_detectors(self.layers, scene, polar, azimuth)
        self.scene = scene
        if side == 1 and not self.detectors.has_lower_side:
            allowed = "brdf with estimator = next_event"
            raise invalid("target", "btdf", allowed, "the lower boundary is not open")

    def trace_chunk(
        self, seed: int, tally: Tally, stratum: Stratum, first_ray: int
    ) -> tuple[np.ndarray, int]:
        """Trace a chunk of rays, and return its mean contributions and the segments traced."""
        detectors = self.detectors._replace(
            sums=np.zeros_like(self.detectors.sums),
            peak_directions=np.zeros_like(self.detectors.peak_directions),
        )
        totals = np.zeros((2, 2))
        work = np.array([stratum.stream, first_ray, tally.rays_per_chunk, stratum.max_order])
        scene = self.scene._replace(detectors=detectors)
        n_segments = trace_to_detectors(seed, work, scene, stratum.optics, totals)
        sums = np.concatenate([detectors.sums.ravel(), totals.ravel()])
        return sums / tally.rays_per_chunk, n_segments
