"""Single scattering by grains: a table for natural snow, paths through all others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from splits.core.provenance import hash_physics_sources
from splits.core.uncertainty import compute_leave_one_out_means
from splits.discrete_ordinates.adding import WET
from splits.discrete_ordinates.homogeneous_layer import TINY
from splits.io.cache import Cache, compute_digest
from splits.kernels.records import N_SCATTERING_BATCHES
from splits.kernels.scene import Scene
from splits.media.medium import GranularMedium
from splits.simulation.engine import simulate
from splits.simulation.grain_optics import (
    GRAIN_RAYS_PER_CHUNK,
    WEIGHTED_MEANS,
    SingleScatteringTally,
)
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import (
    N_PORE_MATERIALS,
    OpticalConstants,
    build_scene,
    compute_material_constants,
)
from splits.simulation.spectral_nodes import IndexNodes, choose_nodes
from splits.simulation.strata import StoppingRule

# --------------------------------------------------------------------------------------------------
# Single scattering by grains of one material, as a function of refractive index and absorption.
#
# What a grain does to light depends on its size only through the absorption of its material times
# its mean chord 1/K,
#
#     x = α/K,    q = x/(1 + x),
#
# so one table serves all sizes and wavelengths.  It holds the moments M_l of the light that leaves
# a grain,
#
#     M_l = ⟨w P_l(cosΘ)⟩,    w = exp(−α L),    M_l(x) = M_l(0) − q E_l(q),
#
# where M_0 is the single-scattering albedo and E_l is smooth for weak and for strong absorption.
# In wet snow, light enters the grain from a dry or a wet pore and leaves into one of the two, and
# M_l depends on both and on the saturation.  Interpolation is polynomial, between the nodes of
# Chebyshev.

MAX_ABSORPTION = 200.0
"""Largest x; about that of ice at 2000 nm for a specific surface area of 0.25 m²/kg."""


class Axis(NamedTuple):
    """Axis of a table: nodes of Chebyshev, at both ends and between.

    Attributes
    ----------
    nodes : float, shape (nodes,)
        Increasing.
    """

    nodes: np.ndarray

    @classmethod
    def from_limits(cls, low: float, high: float, number: int) -> Axis:
        """Return an axis of a number of nodes."""
        position = 0.5 - 0.5 * np.cos(np.pi * np.arange(number) / (number - 1))
        return cls(low + (high - low) * position)

    def contains(self, values: np.ndarray) -> np.ndarray:
        """Return whether values are on the axis."""
        return (values >= self.nodes[0]) & (values <= self.nodes[-1])

    def compute_weights(self, values: np.ndarray) -> np.ndarray:
        """Return the weights of the nodes in polynomial interpolation, shape (values, nodes).

        Barycentric formula (Berrut & Trefethen 2004, SIAM Review 46, 501).
        """
        if self.nodes.size == 1:
            return np.ones((values.size, 1))
        signs = (-1.0) ** np.arange(self.nodes.size)
        signs[[0, -1]] *= 0.5
        difference = values[:, np.newaxis] - self.nodes
        exact = difference == 0.0
        weights = signs / np.where(exact, 1.0, difference)
        hits = exact.any(axis=1)
        weights[hits] = exact[hits]
        return weights / weights.sum(axis=1, keepdims=True)


class GrainTable(NamedTuple):
    """Moments of the light that grains scatter, over contrast, saturation and absorption.

    Attributes
    ----------
    contrast : Axis
        n − 1, with the refractive index n of the grains relative to air.
    saturation : Axis
        Fraction of wet pores; one node, 0, for dry grains.
    absorption : Axis
        q.
    moments : float, shape (contrasts, saturations, 2, 2, orders)
        M_l(0) for light from a dry or wet pore: into any pore, and into a wet pore per saturation;
        of dry grains (contrasts, 1, 1, 1, orders), into any pore.
    slopes : float, shape (contrasts, saturations, 2, 2, absorptions, orders)
        E_l, likewise.
    stderr : float, shape (contrasts, absorptions)
        Standard error of a reflectance due to that of the moments, see `grain_tabulation`.
    water : float, shape (contrasts,)
        Refractive index of water in wet pores.
    """

    contrast: Axis
    saturation: Axis
    absorption: Axis
    moments: np.ndarray
    slopes: np.ndarray
    stderr: np.ndarray
    water: np.ndarray

    @property
    def n_orders(self) -> int:
        """Number of known moments."""
        return self.moments.shape[-1]

    @property
    def n_states(self) -> int:
        """Number of kinds of pores: 2 with wet ones."""
        return self.moments.shape[2]

    def select(self, wavelengths: object) -> GrainTable:
        """Return the table, which holds for all wavelengths."""
        return self

    def compute_moments(
        self, contrast: np.ndarray, absorption: np.ndarray, saturation: float, orders: int
    ) -> np.ndarray:
        """Return the moments M_l, shape (..., values, pores, pores, orders).

        Parameters
        ----------
        contrast : float, shape (values,)
            n − 1, within the table.
        absorption : float, shape (..., values)
            x, within the table.
        saturation : float
            Fraction of wet pores; not used for dry grains.
        orders : int
            Number of moments, which are 0 beyond those of the table.
        """
        by_contrast = self.contrast.compute_weights(contrast)
        by_saturation = self.saturation.compute_weights(np.array([saturation]))[0]
        q = absorption / (1.0 + absorption)
        by_absorption = self.absorption.compute_weights(q.ravel()).reshape(*q.shape, -1)
        n_known, n_pores = min(orders, self.moments.shape[-1]), self.moments.shape[2]
        without, slopes = (
            np.tensordot(by_saturation, values[..., :n_known], (0, 1))
            for values in (self.moments, self.slopes)
        )
        slopes = np.moveaxis(slopes, 3, 1).reshape(len(slopes), by_absorption.shape[-1], -1)
        # The contrast is common to the leading dimensions: first a table for each contrast.
        by_value = np.tensordot(by_contrast, slopes, 1)
        by_value = (by_absorption[..., np.newaxis, :] @ by_value)[..., 0, :]
        known = by_contrast @ without.reshape(len(without), -1) - q[..., np.newaxis] * by_value
        moments = np.zeros((*q.shape, n_pores, n_pores, orders))
        moments[..., :n_known] = known.reshape(*q.shape, n_pores, n_pores, n_known)
        return moments

    def interpolate_stderr(self, contrast: np.ndarray, absorption: np.ndarray) -> np.ndarray:
        """Return the standard errors of a reflectance, shape (..., values), at the next nodes.

        A half-space of grains without absorption reflects all light, whatever their moments.  The
        error at this node is therefore that of no other layer, and not used.
        """
        q = absorption / (1.0 + absorption)
        row, column = (
            np.searchsorted(axis.nodes, values).clip(first, axis.nodes.size - 1)
            for first, axis, values in ((0, self.contrast, contrast), (1, self.absorption, q))
        )
        return self.stderr[row, column]

    def to_dataset(self) -> xr.Dataset:
        """Return the table as a dataset."""
        variables = {
            "moment": (("contrast", "saturation", "pore", "exit_pore", "order"), self.moments),
            "slope": (
                ("contrast", "saturation", "pore", "exit_pore", "absorption", "order"),
                self.slopes,
            ),
            "reflectance_stderr": (("contrast", "absorption"), self.stderr),
            "water_index": ("contrast", self.water),
        }
        names = ("contrast", "saturation", "absorption")
        return xr.Dataset(variables, {name: getattr(self, name).nodes for name in names})

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset) -> GrainTable:
        """Return the table in a dataset."""
        contrast, saturation, absorption = (
            Axis(dataset[name].values) for name in ("contrast", "saturation", "absorption")
        )
        names = ("moment", "slope", "reflectance_stderr", "water_index")
        arrays = (dataset[name].values.astype(float) for name in names)
        return cls(contrast, saturation, absorption, *arrays)


# --------------------------------------------------------------------------------------------------
# Single scattering by the grains of one layer at given wavelengths, from paths through them.
#
# Grains of several types, with coatings, of any shape and with any rules within a grain have the
# moments
#
#     M_l = ⟨w P_l(cosΘ)⟩,    w = exp(−∑ α_m L_m),
#
# of the path lengths L_m in the materials m.  The rays of a type of grain are in proportion to the
# root of its fraction, so that rare types, which may absorb most light, have small errors, too.
# The moments without one batch of the rays each are kept, and the error of any result follows from
# results with each of these (jackknife).

N_TRACED_ORDERS = 33
N_DISPLACEMENTS = len(WEIGHTED_MEANS) - 1
ERROR_PER_RAY = 0.4
"""About the error of a reflectance, times the square root of the rays of all types of grains."""
INTERPOLATION_ERROR_PER_RAY = 0.15
"""Bound on the error of interpolation between refractive indices, in the same unit."""
ERROR_PER_THINNESS = 0.1
"""Bound on the error of fluxes of a layer, times its thickness over the rms displacement of light
in a grain."""
MIN_RAYS, MAX_RAYS = 2**15, 2**23
"""Limits of the rays of all types of grains, for each refractive index and pore."""


GRAIN_DIMS = {
    "moments": ("replicate", "wavelength", "source_pore", "next_pore", "order"),
    "displacements": ("replicate", "mean", "wavelength"),
    "interpolation_bound": ("wavelength",),
}
"""Dimensions of the arrays of `TracedGrains` in a dataset."""
MAX_CACHE_BYTES = 2**29
"""Size of all kept grains above which those that are unused for the longest time are removed."""


def load_grains(
    layer: GranularMedium, wavelength_nm: np.ndarray, rays: int, threads: int
) -> TracedGrains:
    """Return the moments of the grains of a layer, from paths that are traced once.

    They are kept beside the compiled kernels.  Without space or permission, they are traced again
    in the next call.

    Parameters
    ----------
    layer : GranularMedium
        Its depth, density and ground have no effect.
    wavelength_nm : float, shape (wavelengths,)
    rays : int
        See `choose_rays`.
    threads : int
    """
    from splits.kernels.compiler.cache import find_cache_folder

    index, absorption = compute_material_constants(layer, wavelength_nm)
    # Paths in grains do not depend on the absorption by pores, which may contain impurities.
    absorption[:, :N_PORE_MATERIALS] = 0.0
    constants = OpticalConstants(index, absorption)
    tolerance = INTERPOLATION_ERROR_PER_RAY / np.sqrt(rays)
    nodes = choose_nodes(index, layer.list_interfaces(), tolerance)
    scene = build_scene(layer, 0.0, False)
    inputs = (
        rays, scene.rules, scene.types, scene.layers.type_cdf, scene.layers.wet_fraction,
        constants, nodes.index, nodes.weights, nodes.interpolation_bound,
    )  # fmt: skip
    digest = compute_digest(inputs)
    cache = Cache(find_cache_folder(), "grains", max_bytes=MAX_CACHE_BYTES, is_optional=True)
    dataset = cache.get(
        [hash_physics_sources(), inputs],
        lambda: trace_grains(scene, constants, nodes, rays, digest, threads).to_dataset(),
    )
    return TracedGrains.from_dataset(dataset, digest)


def choose_rays(max_error: float) -> int:
    """Return the rays for an error of a reflectance of about half of `max_error`."""
    needed = (2.0 * ERROR_PER_RAY / max_error) ** 2
    return int(np.clip(needed, MIN_RAYS, MAX_RAYS))


class TracedGrains(NamedTuple):
    """Moments of the light that the grains of a layer scatter, at several wavelengths.

    Attributes
    ----------
    moments : float, shape (replicates, wavelengths, pores, pores, orders)
        M_l for light from a dry or wet pore: into any pore, and into a wet pore per fraction of wet
        pores; of dry grains (…, 1, 1, orders), into any pore.  Replicate 0 is from all rays, each
        of the others from all batches but one.
    displacements : float, shape (replicates, 5, wavelengths)
        ⟨w⟩, ⟨w cosΘ⟩, ⟨w δ·d⟩ and ⟨w δ·d'⟩ (m), and ⟨w δ²⟩ (m²) for light from all pores, with the
        displacement δ from entry to exit and the directions d and d' before and after; δ is 0 for
        point grains.
    interpolation_bound : float, shape (wavelengths,)
        Bound on the error of a reflectance from interpolation between refractive indices.
    digest : str
        Identifies the grains.
    replicate : int
        The replicate in use.
    """

    moments: np.ndarray
    displacements: np.ndarray
    interpolation_bound: np.ndarray
    digest: str
    replicate: int = 0

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset, digest: str) -> TracedGrains:
        """Return the grains of the dataset of `to_dataset`."""
        moments, displacements, bound = (dataset[name].values for name in GRAIN_DIMS)
        return cls(moments, displacements, bound, digest)

    def to_dataset(self) -> xr.Dataset:
        """Return the moments of all replicates."""
        return xr.Dataset({
            name: (dims, values)
            for (name, dims), values in zip(GRAIN_DIMS.items(), self[:3], strict=True)
        })  # fmt: skip

    @property
    def n_orders(self) -> int:
        """Number of known moments."""
        return self.moments.shape[-1]

    @property
    def n_states(self) -> int:
        """Number of kinds of pores: 2 with wet ones."""
        return self.moments.shape[2]

    def select(self, wavelengths: np.ndarray) -> TracedGrains:
        """Return the grains at some of the wavelengths."""
        return self._replace(
            moments=self.moments[:, wavelengths],
            displacements=self.displacements[..., wavelengths],
            interpolation_bound=self.interpolation_bound[wavelengths],
        )

    def get_moments(self, orders: int) -> np.ndarray:
        """Return the moments, shape (wavelengths, pores, pores, orders), 0 beyond known ones."""
        known = self.moments[self.replicate, ..., :orders]
        return np.pad(known, [(0, 0)] * 3 + [(0, orders - known.shape[-1])])

    def add_wet_pores(self) -> TracedGrains:
        """Return dry grains as those of a layer with a negligible fraction of wet pores."""
        moments = np.repeat(np.repeat(self.moments, 2, axis=2), 2, axis=3)
        moments[..., WET, 1, :] = 0.0
        return self._replace(moments=moments)

    def compute_packing_ratio(self, extinction_per_m: np.ndarray) -> np.ndarray:
        """Return the optical thickness relative to that of points, shape (wavelengths,).

        Light advances in grains, too: see `splits.simulation.deep_medium.effective_mean_free_path`.

        Parameters
        ----------
        extinction_per_m : float, shape (wavelengths,)
            Of path between grains (1/m).
        """
        weighted = self.displacements[self.replicate]
        cosine, incident, leaving, square = weighted[1:] / np.maximum(weighted[0], TINY)
        spread = 0.5 * (1.0 - cosine) * square
        free = 1.0 / extinction_per_m
        return free / np.sqrt((free + incident) * (free + leaving) + spread)

    def compute_thinness_error(self, depth_m: np.ndarray) -> np.ndarray:
        """Return the bound on the error of fluxes of a layer not much thicker than its grains.

        Parameters
        ----------
        depth_m : float
            Thickness (m).

        Returns
        -------
        float, shape (wavelengths,)
            0 for point grains.
        """
        weighted = self.displacements[0]
        displacement = np.sqrt(weighted[-1] / np.maximum(weighted[0], TINY))
        return ERROR_PER_THINNESS * displacement / depth_m


def trace_grains(
    scene: Scene, constants: OpticalConstants, nodes: IndexNodes, rays: int, digest: str,
    threads: int,
) -> TracedGrains:  # fmt: skip
    """Trace all types of grains, with random numbers that follow from the digest.

    Parameters
    ----------
    scene : Scene
    constants : OpticalConstants
        Of the materials, at every wavelength.
    nodes : IndexNodes
    rays : int
        Of all types of grains, for each refractive index and pore.
    digest : str
        Hexadecimal.
    threads : int
    """
    run = RunOptions.start(int(digest[:8], 16), threads)
    wet_fraction = float(scene.layers.wet_fraction[0])
    pores = (0.0, 1.0) if wet_fraction > 0.0 else (0.0,)
    n_replicates, n_pores = 1 + N_SCATTERING_BATCHES, len(pores)
    n_wavelengths = len(constants.indices)
    moments = np.zeros((n_replicates, n_wavelengths, n_pores, n_pores, N_TRACED_ORDERS))
    displacements = np.zeros((n_replicates, 2 + N_DISPLACEMENTS, n_wavelengths))
    fractions = np.diff(scene.layers.type_cdf[0], prepend=0.0)
    shares = np.sqrt(fractions.clip(0.0))
    n_chunks = np.ceil(rays / GRAIN_RAYS_PER_CHUNK * shares / shares.sum()).astype(int)
    in_pores = (1.0 - wet_fraction, wet_fraction)
    for source, is_wet in enumerate(pores):
        lost = np.zeros(moments.shape[:2])
        for grain_type in np.flatnonzero(fractions > 0.0):
            n_rays = GRAIN_RAYS_PER_CHUNK * int(n_chunks[grain_type])
            means = _trace_type(scene, constants, nodes, int(grain_type), is_wet, n_rays, run)
            every, rest = np.split(means, [N_TRACED_ORDERS], axis=-1)
            moved, wet = np.split(rest, [N_DISPLACEMENTS], axis=-1)
            lost += fractions[grain_type] * (1.0 - every[..., 0])
            moments[..., source, 0, :] += fractions[grain_type] * every
            weighted = np.concatenate([every[..., :2], moved], axis=-1)
            share = fractions[grain_type] * in_pores[source]
            displacements += share * np.moveaxis(weighted, -1, 1)
            if wet_fraction > 0.0:
                share = fractions[grain_type] / wet_fraction
                moments[..., source, 1, :] += share * wet
        # From the loss, so that grains that absorb nothing lose exactly nothing.
        moments[..., source, 0, 0] = 1.0 - np.maximum(lost, 0.0)
    return TracedGrains(moments, displacements, nodes.interpolation_bound, digest)


def _trace_type(
    scene: Scene, constants: OpticalConstants, nodes: IndexNodes, grain_type: int, is_wet: float,
    n_rays: int, run: RunOptions,
) -> np.ndarray:  # fmt: skip
    """Return the means of all scores, shape (replicates, wavelengths, scores)."""
    n_nodes = len(nodes.index)
    type_cdf = (np.arange(scene.layers.type_cdf.shape[1]) >= grain_type).astype(float)
    single_type = scene._replace(layers=scene.layers._replace(type_cdf=type_cdf[np.newaxis]))
    tally = SingleScatteringTally(
        nodes, constants.absorption, np.full(n_nodes, is_wet), N_TRACED_ORDERS,
        n_rays, N_TRACED_ORDERS if scene.layers.wet_fraction[0] > 0.0 else 1,
    )  # fmt: skip
    stop = StoppingRule(0.0, n_rays * n_nodes, fixed=True)
    simulate(single_type, tally, stop, run._replace(seed=run.seed + grain_type))
    scale = N_SCATTERING_BATCHES / tally.count_rays()
    batches = tally.combine_nodes(tally.batch_sums * scale)
    every = batches.mean(axis=0, keepdims=True)
    return np.moveaxis(np.concatenate([every, compute_leave_one_out_means(batches)]), 1, -1)
