"""Tracer: the kernel of a scene.

A runner handles chunks, jobs and threads; a tracer calls the kernel that suits a scene.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.core.validation import invalid
from splits.kernels import vectorized
from splits.kernels.compiler.features import Features
from splits.kernels.grains.scene import Optics
from splits.kernels.rough_surface.realization import allocate_realization
from splits.kernels.tallies.crossings import CROSSING_RAY
from splits.kernels.tallies.exits import EXIT_LENGTH, allocate_exits
from splits.kernels.transport import history
from splits.kernels.vectorized.eligibility import select_features
from splits.media.medium import Medium
from splits.simulation.scene import (
    add_recording_planes,
    build_scene,
    count_length_columns,
    make_height_fields,
)
from splits.simulation.tally import Stratum, TransportTraits
from splits.simulation.tracer_interface import TraceResult

KERNELS = ("auto", "vectorized", "scalar")
"""Choices of kernel: vectorized where the scene allows it, vectorized or an error, or scalar."""


class SceneTracer:
    """Tracer of rays in a medium, vectorized where possible.

    Parameters
    ----------
    medium : Medium
    incidence_deg : float or "diffuse"
    seed : int
    analog : bool
        Whether absorption is analog, sampled at each segment.
    kernel : {"auto", "vectorized", "scalar"}
    planes_m : sequence of float
        Depths (m) of recording planes, besides all boundaries between layers; without any,
        crossings are not recorded.
    """

    LOST_MESSAGE = (
        "no grain fits between the boundaries along a ray, or a ray is lost at a rough surface: "
        "the sample is barely thicker than its grains, or the incidence too close to 90 degrees"
    )

    def __init__(
        self,
        medium: Medium,
        incidence_deg: float | str,
        seed: int,
        analog: bool,
        kernel: str,
        planes_m: Sequence[float],
    ) -> None:
        self.scene = build_scene(medium, incidence_deg, analog)
        if planes_m:
            self.scene = add_recording_planes(self.scene, planes_m)
        self.height_fields = make_height_fields(medium)
        self.boundary_depths_m = -self.scene.layers.boundaries
        densest = float(self.scene.layers.collision_coefficient.max())
        particles = self.scene.particles
        fading = particles is not None and bool((particles.albedo < 1.0).any())
        self.traits = TransportTraits(densest, self.scene.ground_column, fading, analog)
        self.normal_incidence = self.scene.source == (1.0, 0.0)
        self.diffuse = self.scene.source.diffuse_fraction > 0.0
        self.n_columns = count_length_columns(medium)
        first = EXIT_LENGTH + self.n_columns
        is_polarized = self.scene.stokes is not None
        self.stokes_columns = tuple(range(first, first + 3)) if is_polarized else ()
        self.seed = seed
        self.kernel = kernel
        self._features: dict[Stratum, Features | None] = {}

    def share_kernel(self, strata: Sequence[Stratum]) -> None:
        """Let strata use one kernel, if they differ only in extinction.

        The kernel for reflection with extinction also handles negligible extinction, and rays of
        all strata then fill the lanes together.
        """
        all_features = [self.get_features(stratum) for stratum in strata]
        if any(features is not None and features.absorbing for features in all_features):
            for stratum, features in zip(strata, all_features, strict=True):
                if features is not None and not features.mixed:
                    self._features[stratum] = features._replace(absorbing=True)

    def get_features(self, stratum: Stratum) -> Features | None:
        """Return the vectorized kernel's features for a stratum, or None for the scalar kernel.

        Raises
        ------
        ValueError
            If the vectorized kernel is requested and does not support the scene.
        """
        if self.kernel == "scalar":
            return None
        if stratum not in self._features:
            self._features[stratum] = select_features(self.scene, stratum.optics)
        features = self._features[stratum]
        if features is None and self.kernel == "vectorized":
            raise invalid(
                "kernel",
                "vectorized",
                "'auto' or 'scalar' for this sample",
                "not for particle layers, analog absorption, stacked coatings, extreme inputs",
            )
        return features

    def allocate_exits(self, n_rays: int) -> np.ndarray:
        """Return an array for the exits of `n_rays` rays."""
        return allocate_exits(n_rays, self.n_columns, len(self.stokes_columns))

    def trace(self, work: np.ndarray, strata: Sequence[Stratum], exits: np.ndarray) -> TraceResult:
        """Trace items of strata that share features, see `Tracer`."""
        features = self.get_features(strata[0])
        if features is None:
            item_parts = np.split(exits, np.cumsum(work[:, 2])[:-1])
            fields = self.height_fields
            realization = None if fields is None else allocate_realization(fields)
            result = [
                history.trace_batch(
                    self.seed, item, self.scene, stratum.optics, item_part, fields, realization
                )
                for item, item_part, stratum in zip(work, item_parts, strata, strict=True)
            ]
            return TraceResult(
                np.array([item_result.n_segments for item_result in result]),
                [item_result.crossings for item_result in result],
                self.LOST_MESSAGE if any(item_result.lost for item_result in result) else "",
            )
        optics = Optics(*map(np.stack, zip(*(stratum.optics for stratum in strata), strict=True)))
        result = vectorized.trace_batch(self.seed, work, self.scene, optics, exits, features)
        # Stable, so that the crossings of each ray remain in order of time.
        crossings = result.crossings[np.argsort(result.crossings[:, CROSSING_RAY], kind="stable")]
        end_rays = np.cumsum(work[:, 2])
        item_parts = np.split(crossings, np.searchsorted(crossings[:, CROSSING_RAY], end_rays[:-1]))
        for item_part, first_ray in zip(item_parts[1:], end_rays[:-1], strict=True):
            item_part[:, CROSSING_RAY] -= first_ray
        return TraceResult(result.n_segments, item_parts, self.LOST_MESSAGE if result.lost else "")
