"""Tracers: the kernel of a scene, for grains or for a layer of small particles.

A runner handles chunks, jobs and threads; a tracer calls the kernel that suits a scene.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.core.validation import invalid
from splits.kernels import vectorized
from splits.kernels.compiler.features import Features
from splits.kernels.grains import history
from splits.kernels.grains.scene import Optics
from splits.kernels.optics.source import Source
from splits.kernels.optics.stokes import UNPOLARIZED
from splits.kernels.particle_layer import particle_history
from splits.kernels.particle_layer.scene import LayerScene
from splits.kernels.rough_surface.realization import allocate_realization
from splits.kernels.tallies.crossings import CROSSING_RAY
from splits.kernels.tallies.exits import EXIT_LENGTH, allocate_exits
from splits.kernels.vectorized.eligibility import select_features
from splits.media.medium import GranularMedium, LayeredMedium, Medium, ParticleMedium
from splits.simulation.scene import (
    add_recording_planes,
    build_scene,
    count_length_columns,
    make_height_fields,
    make_source,
)
from splits.simulation.tally import Stratum, TransportTraits
from splits.simulation.tracer_interface import Tracer, TraceResult

KERNELS = ("auto", "vectorized", "scalar")
"""Choices of kernel: vectorized where the scene allows it, vectorized or an error, or scalar."""


class GrainTracer:
    """Tracer of rays among grains, vectorized where possible.

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
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
        medium: GranularMedium | LayeredMedium,
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
        fading = bool((self.scene.particles.albedo < 1.0).any())
        self.traits = TransportTraits(densest, self.scene.ground_column, fading, analog)
        self.normal_incidence = self.scene.source == (1.0, 0.0)
        self.diffuse = self.scene.source.diffuse_fraction > 0.0
        self.stokes_columns: tuple[int, ...] = ()
        self.n_columns = count_length_columns(medium)
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
        return allocate_exits(n_rays, self.n_columns)

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


class ParticleLayerTracer:
    """Tracer of rays in a layer of small particles.

    Parameters
    ----------
    medium : ParticleMedium
    source : Source
    seed, analog, kernel
        As in `GrainTracer`.
    """

    LOST_MESSAGE = "a ray was lost at the rough surface: please report this with the configuration"

    def __init__(
        self,
        medium: ParticleMedium,
        source: Source,
        seed: int,
        analog: bool,
        kernel: str,
    ) -> None:
        if kernel == "vectorized":
            hint = "the vectorized kernel supports grains only"
            raise invalid("kernel", kernel, "'auto' or 'scalar' for a particle layer", hint)
        stokes = UNPOLARIZED if medium.polarized else None
        self.scene = LayerScene(
            source,
            medium.make_scattering_layer(analog),
            medium.kernel_phase_function,
            medium.make_height_fields(),
            stokes,
        )
        self.boundary_depths_m = np.array([0.0, self.scene.layer.depth])
        extinction = float(np.clip(medium.extinction_per_m, 1e-300, 1e300))
        fading = self.scene.layer.albedo < 1.0
        self.traits = TransportTraits(extinction, extra_absorption=fading, analog=analog)
        self.normal_incidence = source.diffuse_fraction == 0.0 and source.cos_incidence == 1.0
        self.diffuse = source.diffuse_fraction > 0.0
        self.n_materials = len(medium.list_materials())
        # After the path lengths in all materials.
        self.first_stokes_column = EXIT_LENGTH + self.n_materials
        self.stokes_columns: tuple[int, ...] = ()
        if medium.polarized:
            self.stokes_columns = tuple(
                range(self.first_stokes_column, self.first_stokes_column + 3)
            )
        self.seed = seed

    def share_kernel(self, strata: Sequence[Stratum]) -> None:
        """Do nothing: there is one kernel."""

    def get_features(self, stratum: Stratum) -> None:
        """Return None: the kernel is scalar."""
        return None

    def allocate_exits(self, n_rays: int) -> np.ndarray:
        """Return an array for the exits of `n_rays` rays."""
        return allocate_exits(n_rays, self.n_materials, len(self.stokes_columns))

    def trace(self, work: np.ndarray, strata: Sequence[Stratum], exits: np.ndarray) -> TraceResult:
        """Trace items of strata, see `Tracer`."""
        realization = None if self.scene.fields is None else allocate_realization(self.scene.fields)
        exits_by_item = np.split(exits, np.cumsum(work[:, particle_history.N_RAYS])[:-1])
        results = [
            particle_history.trace_batch(
                self.seed, item, self.scene, realization, self.first_stokes_column, item_exits
            )
            for item, item_exits in zip(work, exits_by_item, strict=True)
        ]
        return TraceResult(
            np.array([one.n_segments for one in results]),
            [allocate_exits(0, self.n_materials)] * len(results),
            self.LOST_MESSAGE if any(one.lost for one in results) else "",
        )


def make_tracer(
    medium: Medium,
    incidence_deg: float | str,
    seed: int,
    analog: bool,
    kernel: str,
    planes_m: Sequence[float],
) -> Tracer:
    """Return the tracer of a medium; see `GrainTracer` for the parameters."""
    if isinstance(medium, ParticleMedium):
        return ParticleLayerTracer(medium, make_source(incidence_deg), seed, analog, kernel)
    return GrainTracer(medium, incidence_deg, seed, analog, kernel, planes_m)
