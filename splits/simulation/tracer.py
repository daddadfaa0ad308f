"""Tracers of media: the kernel of a scene, for grains or for a layer of small particles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.kernels import vectorized
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
from splits.simulation.tracer_interface import ExitTracer, TraceResult


class GrainTracer(ExitTracer):
    """Tracer of rays among grains, vectorized where possible.

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
    incidence_deg : float or "diffuse"
    analog : bool
        Whether absorption is analog, sampled at each segment.
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
        analog: bool = False,
        planes_m: Sequence[float] = (),
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
        self.n_length_columns = count_length_columns(medium)

    def select_kernel(self, strata: Sequence[Stratum], kernel: str, share: bool) -> None:
        """Set the features of the vectorized kernel of each stratum, None for the scalar kernel.

        The kernel for reflection with extinction also handles negligible extinction, so that strata
        that differ only in extinction can share it.
        """
        if kernel == "scalar":
            return
        for stratum in strata:
            stratum.features = select_features(self.scene, stratum.optics)
            if stratum.features is None:
                super().select_kernel(strata, kernel, share)
        if share and any(one.features and one.features.absorbing for one in strata):
            for stratum in strata:
                if stratum.features and not stratum.features.mixed:
                    stratum.features = stratum.features._replace(absorbing=True)

    def trace(
        self, seed: int, work: np.ndarray, strata: Sequence[Stratum], exits: np.ndarray
    ) -> TraceResult:
        """Trace items of strata that share features."""
        features = strata[0].features
        end_rays = np.cumsum(work[:, 2])
        if features is None:
            fields = self.height_fields
            realization = None if fields is None else allocate_realization(fields)
            results = [
                history.trace_batch(
                    seed, item, self.scene, stratum.optics, item_exits, fields, realization
                )
                for item, item_exits, stratum in zip(
                    work, np.split(exits, end_rays[:-1]), strata, strict=True
                )
            ]
            n_segments, lost, crossings = zip(*results, strict=True)
            return TraceResult(n_segments, list(crossings), any(lost))
        optics = Optics(*map(np.stack, zip(*(stratum.optics for stratum in strata), strict=True)))
        result = vectorized.trace_batch(seed, work, self.scene, optics, exits, features)
        # Stable, so that the crossings of each ray remain in order of time.
        sorted_crossings = result.crossings[
            np.argsort(result.crossings[:, CROSSING_RAY], kind="stable")
        ]
        starts = np.searchsorted(sorted_crossings[:, CROSSING_RAY], end_rays[:-1])
        by_item = np.split(sorted_crossings, starts)
        for item_crossings, first_ray in zip(by_item[1:], end_rays[:-1], strict=True):
            item_crossings[:, CROSSING_RAY] -= first_ray
        return TraceResult(result.n_segments, by_item, result.lost)


class ParticleLayerTracer(ExitTracer):
    """Tracer of rays in a layer of small particles.

    Parameters
    ----------
    medium : ParticleMedium
    source : Source
    analog : bool
        As in `GrainTracer`.
    """

    LOST_MESSAGE = "a ray was lost at the rough surface: please report this with the configuration"

    def __init__(self, medium: ParticleMedium, source: Source, analog: bool) -> None:
        self.scene = LayerScene(
            source,
            medium.make_scattering_layer(analog),
            medium.kernel_phase_function,
            medium.make_height_fields(),
            UNPOLARIZED if medium.polarized else None,
        )
        self.boundary_depths_m = np.array([0.0, self.scene.layer.depth])
        extinction = float(np.clip(medium.extinction_per_m, 1e-300, 1e300))
        fading = self.scene.layer.albedo < 1.0
        self.traits = TransportTraits(extinction, extra_absorption=fading, analog=analog)
        self.normal_incidence = source.diffuse_fraction == 0.0 and source.cos_incidence == 1.0
        self.diffuse = source.diffuse_fraction > 0.0
        self.n_length_columns = len(medium.list_materials())
        # After the path lengths in all materials.
        first = EXIT_LENGTH + self.n_length_columns
        self.stokes_columns = (first, first + 1, first + 2) if medium.polarized else ()

    def trace(
        self, seed: int, work: np.ndarray, strata: Sequence[Stratum], exits: np.ndarray
    ) -> TraceResult:
        """Trace items of strata."""
        realization = None if self.scene.fields is None else allocate_realization(self.scene.fields)
        stokes_column = EXIT_LENGTH + self.n_length_columns
        results = [
            particle_history.trace_batch(
                seed, item, self.scene, realization, stokes_column, item_exits
            )
            for item, item_exits in zip(
                work, np.split(exits, np.cumsum(work[:, 2])[:-1]), strict=True
            )
        ]
        n_segments, lost = zip(*results, strict=True)
        no_crossings = [allocate_exits(0, self.n_length_columns)] * len(results)
        return TraceResult(n_segments, no_crossings, any(lost))


def make_tracer(
    medium: Medium,
    incidence_deg: float | str,
    *,
    analog: bool = False,
    planes_m: Sequence[float] = (),
) -> ExitTracer:
    """Return the tracer of a medium; see `GrainTracer` for the parameters."""
    if isinstance(medium, ParticleMedium):
        return ParticleLayerTracer(medium, make_source(incidence_deg), analog)
    return GrainTracer(medium, incidence_deg, analog, planes_m)
