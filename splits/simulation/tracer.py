"""What traces the rays of a medium: kernels for grains, or for a layer of small particles.

A runner knows batches, jobs and threads; a tracer knows the kernel that a scene takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

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

KERNELS = ("auto", "vectorized", "scalar")
"""What traces: lanes where they serve the scene, lanes or an error, or always the scalar kernel."""


class TraceResult(NamedTuple):
    """What pieces of levels yielded besides their exits.

    Attributes
    ----------
    n_segments : int, shape (pieces,)
    crossings : list of float, shape (notes, columns)
        Of each piece, ray by ray, rays counted from its first; see
        `splits.kernels.tallies.exits.Notes`.
    lost : str
        Why a ray was lost, or nothing.
    """

    n_segments: np.ndarray
    crossings: list[np.ndarray]
    lost: str


class Tracer(Protocol):
    """The kernel of a scene.

    Attributes
    ----------
    traits : TransportTraits
    normal_incidence : bool
        Whether light comes along the normal, so that nothing tells azimuths apart.
    diffuse : bool
        Whether light comes from everywhere.
    boundary_depths_m : float, shape (faces,)
        Depths (m) of all faces of the scene; of a rough top, a height above it.
    stokes_columns : tuple of int
        Columns of exits that hold Q, U, V over I, or nothing.
    """

    traits: TransportTraits
    normal_incidence: bool
    diffuse: bool
    boundary_depths_m: np.ndarray
    stokes_columns: tuple[int, ...]

    def get_features(self, stratum: Stratum) -> Features | None:
        """Return the lane kernel's features for a level, or None for a scalar kernel."""
        ...

    def share_kernel(self, strata: Sequence[Stratum]) -> None:
        """Let levels share a kernel, if they can."""
        ...

    def allocate_exits(self, n_rays: int) -> np.ndarray:
        """Return room for the exits of so many rays."""
        ...

    def trace(self, work: np.ndarray, strata: Sequence[Stratum], exits: np.ndarray) -> TraceResult:
        """Trace pieces of levels that share features.

        Parameters
        ----------
        work : int64, shape (pieces, 4)
            See `splits.kernels.grains.history.trace_batch`.
        strata : sequence of Stratum
            One for each piece.
        exits : float, shape (rays, columns)
            Of all pieces together.

        Returns
        -------
        Followed
        """
        ...


class GrainTracer:
    """Traces rays among grains, on lanes where they serve.

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
    incidence_deg : float or "diffuse"
    seed : int
    analog : bool
        Absorption by coin toss.
    kernel : {"auto", "vectorized", "scalar"}
    planes_m : sequence of float
        Depths (m) of planes to listen at, besides all faces between layers; with none, nobody
        listens at these.
    """

    LOST_MESSAGE = (
        "a ray found no grain that fits between the boundaries, or its way at a rough surface: the "
        "sample is barely thicker than its grains, or the incidence too close to 90 degrees"
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
        densest = float(self.scene.layers.attenuation.max())
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
        """Let levels share a kernel, if that is all that parts them.

        Reflection with extinction also serves where extinction does not show, and rays of all
        levels then share the lanes.
        """
        found = [self.get_features(level) for level in strata]
        if any(one is not None and one.absorbing for one in found):
            for level, one in zip(strata, found, strict=True):
                if one is not None and not one.mixed:
                    self._features[level] = one._replace(absorbing=True)

    def get_features(self, stratum: Stratum) -> Features | None:
        """Return the lane kernel's features for a level, or None for the scalar kernel.

        Raises
        ------
        ValueError
            If lanes are asked for and cannot serve the scene.
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
                "lanes know no layers of particles, coin tosses, stacked coatings, extreme inputs",
            )
        return features

    def allocate_exits(self, n_rays: int) -> np.ndarray:
        """Return room for the exits of so many rays."""
        return allocate_exits(n_rays, self.n_columns)

    def trace(self, work: np.ndarray, strata: Sequence[Stratum], exits: np.ndarray) -> TraceResult:
        """Trace pieces of levels that share features, see `Tracer`."""
        features = self.get_features(strata[0])
        if features is None:
            parts = np.split(exits, np.cumsum(work[:, 2])[:-1])
            fields = self.height_fields
            room = None if fields is None else allocate_realization(fields)
            told = [
                history.trace_batch(self.seed, item, self.scene, level.optics, part, fields, room)
                for item, part, level in zip(work, parts, strata, strict=True)
            ]
            return TraceResult(
                np.array([one.n_segments for one in told]),
                [one.crossings for one in told],
                self.LOST_MESSAGE if any(one.lost for one in told) else "",
            )
        optics = Optics(*map(np.stack, zip(*(level.optics for level in strata), strict=True)))
        told = vectorized.trace_batch(self.seed, work, self.scene, optics, exits, features)
        # Of each ray in the order of time, as they were taken.
        notes = told.crossings[np.argsort(told.crossings[:, CROSSING_RAY], kind="stable")]
        last = np.cumsum(work[:, 2])
        parts = np.split(notes, np.searchsorted(notes[:, CROSSING_RAY], last[:-1]))
        for part, first in zip(parts[1:], last[:-1], strict=True):
            part[:, CROSSING_RAY] -= first
        return TraceResult(told.n_segments, parts, self.LOST_MESSAGE if told.lost else "")


class LayerTracer:
    """Traces rays in a layer of small particles.

    Parameters
    ----------
    medium : ParticleMedium
    light : Source
    seed, analog, kernel
        As in `GrainTracer`.
    """

    LOST_MESSAGE = (
        "a ray lost its way at the rough surface: please report this with the configuration"
    )

    def __init__(
        self,
        medium: ParticleMedium,
        source: Source,
        seed: int,
        analog: bool,
        kernel: str,
    ) -> None:
        if kernel == "vectorized":
            raise invalid("kernel", kernel, "'auto' or 'scalar' for a layer", "lanes know grains")
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
        """Return room for the exits of so many rays."""
        return allocate_exits(n_rays, self.n_materials, len(self.stokes_columns))

    def trace(self, work: np.ndarray, strata: Sequence[Stratum], exits: np.ndarray) -> TraceResult:
        """Trace pieces of levels, see `Tracer`."""
        room = None if self.scene.fields is None else allocate_realization(self.scene.fields)
        parts = np.split(exits, np.cumsum(work[:, particle_history.N_RAYS])[:-1])
        results = [
            particle_history.trace_batch(
                self.seed, item, self.scene, room, self.first_stokes_column, part
            )
            for item, part in zip(work, parts, strict=True)
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
    """Return what traces the rays of a medium; see `GrainTracer` for the parameters."""
    if isinstance(medium, ParticleMedium):
        return LayerTracer(medium, make_source(incidence_deg), seed, analog, kernel)
    return GrainTracer(medium, incidence_deg, seed, analog, kernel, planes_m)
