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
from splits.kernels.optics.forward_peak import PhaseFunctionPeak, separate_peak
from splits.kernels.optics.polarized_interface import compute_fresnel_mueller
from splits.kernels.transport.history import trace_to_detectors
from splits.kernels.transport.next_event import Detectors
from splits.media.particle_layer import ParticleLayer
from splits.simulation.scene import build_scene
from splits.simulation.tally import Tally
from splits.simulation.tracer import ItemScores, Tracer, WorkItem

NEGLIGIBLE_PROBABILITY = 1e-16
"""Probability of more successive scatterings into a peak than are stored."""
MAX_PEAK_FRACTION = 0.99
"""Largest probability of scattering into a peak: above it, light needs hundreds of scatterings to
change its direction."""


def make_detectors(medium: ParticleLayer, polar: np.ndarray, azimuth: np.ndarray) -> Detectors:
    """Return detectors on a grid of directions, azimuth running fastest.

    Parameters
    ----------
    medium : ParticleLayer
    polar, azimuth : float
        Degrees, of the directions outside.
    """
    n, bottom = medium.refractive_index, medium.scene_bottom
    outer_polar, azimuth_rad = np.radians(np.meshgrid(polar, azimuth, indexing="ij")).reshape(2, -1)
    sine = np.sin(outer_polar) / n
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    directions = np.stack([sine * np.cos(azimuth_rad), sine * np.sin(azimuth_rad), cosine], axis=1)
    interfaces = [compute_fresnel_mueller(n, 1.0, c) for c in cosine]
    reflection = np.array([interface.reflection for interface in interfaces])
    transmission = np.array([interface.transmission for interface in interfaces])
    if not medium.polarized:
        reflection = reflection * [1.0, 0.0, 0.0, 0.0]
        transmission = transmission * [1.0, 0.0, 0.0]
    # dΩ inside/dΩ outside = cosθ/(n² cosθ'); a BRDF is per outer cosine.
    transmission = transmission / (n**2 * cosine[:, np.newaxis])
    has_lower_side = bottom.albedo is None and np.isfinite(bottom.depth_m) and not medium.opaque
    sums = np.zeros((2, len(directions), 4))
    plane = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=1)
    peak = _check_forward_peak(medium)
    orders = (
        0 if peak is None else math.ceil(math.log(NEGLIGIBLE_PROBABILITY) / math.log(peak.fraction))
    )
    peak_directions = np.zeros((1 + orders, 3))
    return Detectors(
        directions,
        plane,
        transmission,
        reflection,
        n,
        medium.extinction_per_m * bottom.depth_m,
        bool(has_lower_side),
        sums,
        medium.kernel_phase_function,
        peak,
        0.0 if peak is None else peak.fraction * medium.single_scattering_albedo,
        peak_directions,
    )


def _check_forward_peak(medium: ParticleLayer) -> PhaseFunctionPeak | None:
    """Return the narrow peak of the phase function, which must not hold nearly all light."""
    peak = separate_peak(medium.kernel_phase_function)
    if peak is not None and peak.fraction > MAX_PEAK_FRACTION:
        raise invalid(
            "estimator", "next_event", "expansion or bins for this phase_function",
            f"more than {MAX_PEAK_FRACTION:.0%} of the scattered light goes into a narrow peak",
        )  # fmt: skip
    return peak


class DetectorTracer(Tracer):
    """Tracer of rays in a layer of particles under a smooth surface that contribute to detectors.

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
        For grains, for a rough surface, and for a phase function that is nearly all peak.
    """

    def __init__(
        self,
        medium: Any,
        incidence_deg: float,
        polar: np.ndarray,
        azimuth: np.ndarray,
        side: int,
    ) -> None:
        if medium.has_grains or len(medium.scene_layers) > 1 or medium.ground is not None:
            raise invalid("estimator", "next_event", "expansion or bins for grains and stacks")
        if medium.make_height_fields() is not None:
            raise invalid(
                "estimator", "next_event", "expansion or bins under a rough surface",
                "no single path leads through it to a given direction; bins have Stokes parameters",
            )  # fmt: skip
        self.medium = medium
        self.detectors = make_detectors(medium, polar, azimuth)
        self.scene = build_scene(medium, incidence_deg, False)
        if side == 1 and not self.detectors.has_lower_side:
            allowed = "brdf with estimator = next_event"
            raise invalid("target", "btdf", allowed, "the layer has no open lower boundary")

    def trace_job(self, seed: int, tally: Tally, job: Sequence[WorkItem]) -> list[ItemScores]:
        """Return the mean contributions of each batch of rays, and the segments traced."""
        results = []
        for stratum, first_ray, n_rays in job:
            n_segments, scores = 0, []
            for first in range(first_ray, first_ray + n_rays, tally.rays_per_chunk):
                detectors = self.detectors._replace(
                    sums=np.zeros_like(self.detectors.sums),
                    peak_directions=np.zeros_like(self.detectors.peak_directions),
                )
                totals = np.zeros((2, 2))
                work = np.array([stratum.stream, first, tally.rays_per_chunk, stratum.max_order])
                scene = self.scene._replace(detectors=detectors)
                n_segments += trace_to_detectors(seed, work, scene, stratum.optics, totals)
                sums = np.concatenate([detectors.sums.ravel(), totals.ravel()])
                scores.append(sums / tally.rays_per_chunk)
            results.append((scores, n_segments))
        return results
