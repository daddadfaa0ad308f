"""Scenes: a light on media, as kernels take them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.kernels.grains.rough_top import MAX_HEIGHT_SIGMA
from splits.kernels.grains.scene import (
    NO_GROUND,
    NO_PARTICLES,
    GrainPopulation,
    GrainTypes,
    Layers,
    ParticleScattering,
    Scene,
)
from splits.kernels.optics.source import Source
from splits.kernels.rough_surface.realization import HeightFields
from splits.media.ground import Ground
from splits.media.interpretations import Interpretation
from splits.media.medium import GranularMedium, LayeredMedium, Medium, compute_absorption
from splits.media.stacked_particle_layer import StackedParticleLayer

LayerModel = GranularMedium | StackedParticleLayer
MIN_ATTENUATION_PER_M = 1e-12
"""Scatterings per metre of a layer without particles, whose mean free path must be a number."""


class OpticalConstants(NamedTuple):
    """Optical constants over wavelength; a ground, if there is one, comes after the materials.

    Attributes
    ----------
    indices : complex, shape (wavelengths, columns)
        Refractive indices.
    absorption : float, shape (wavelengths, columns)
        Absorption coefficients (1/m); of the ground, −ln of its albedo.
    """

    indices: np.ndarray
    absorption: np.ndarray


def make_source(incidence_deg: float | str) -> Source:
    """Return the light of an incidence: degrees of a beam, or "diffuse"."""
    if incidence_deg == "diffuse":
        return Source(1.0, 1.0)
    return Source(float(np.cos(np.radians(float(incidence_deg)))), 0.0)


def get_reflecting_ground(medium: Medium) -> Ground | None:
    """Return the ground below a medium, None where nothing comes back from there."""
    ground = getattr(medium, "ground", None)
    return ground if ground is not None and ground.is_reflecting else None


def make_height_fields(medium: Medium) -> HeightFields | None:
    """Return the rough surface on top of layers as kernels take it, None where it is smooth."""
    top = medium.scene_layers[0] if isinstance(medium, LayeredMedium) else medium
    return top.make_height_fields() if isinstance(top, StackedParticleLayer) else None


def count_length_columns(medium: Medium) -> int:
    """Return how many lengths a path has: one in each material, and meetings with a ground."""
    return len(medium.list_materials()) + (get_reflecting_ground(medium) is not None)


def compute_optical_constants(medium: Medium, wavelength_nm: np.ndarray) -> OpticalConstants:
    """Return what a medium and its ground are to light at wavelengths (nm)."""
    index = medium.compute_refractive_indices(wavelength_nm)
    absorption = compute_absorption(medium, index, wavelength_nm)
    ground = get_reflecting_ground(medium)
    if ground is None:
        return OpticalConstants(index, absorption)
    return OpticalConstants(
        np.pad(index, ((0, 0), (0, 1)), constant_values=1.0),
        np.column_stack([absorption, ground.optical_depth(wavelength_nm)]),
    )


def build_scene(
    medium: GranularMedium | LayeredMedium, incidence_deg: float | str, analog: bool
) -> Scene:
    """Return granular media under a light; `analog` is absorption by coin toss."""
    media = medium.scene_layers if isinstance(medium, LayeredMedium) else (medium,)
    granular = [one for one in media if not isinstance(one, StackedParticleLayer)]
    tables = [one.make_grain_population() for one in granular]
    points = tables[0].types.curvature.shape[1] if tables else 2
    given = iter(tables)
    grains = [
        _make_placeholder_grains(one.layer.extinction_per_m, points)
        if isinstance(one, StackedParticleLayer)
        else next(given)
        for one in media
    ]
    materials = np.cumsum([0, *(len(one.list_materials()) for one in media)])
    types = np.cumsum([0, *(len(one.type_cdf) for one in grains)])
    most = max(len(one.type_cdf) for one in grains)
    face = -np.cumsum([0.0, *(float(one.depth_m) for one in media)])
    fields = make_height_fields(medium)
    if fields is not None:
        # Above the surface: nothing of a realisation may reach there.
        face[0] = MAX_HEIGHT_SIGMA * np.linalg.norm(fields.rms_height)
    layers = Layers(
        boundaries=face,
        attenuation=np.array([one.attenuation for one in grains]),
        saturation=np.array([float(one.wet_fraction) for one in media]),
        type_cdf=np.array(
            [np.pad(one.type_cdf, (0, most - len(one.type_cdf)), "edge") for one in grains]
        ),
        first_type=types[:-1],
        pore=materials[:-1],
        pore_cdf=_compute_pore_cdf(media),
        particle_row=_find_particle_rows(media),
    )
    rules = (granular[0].interpretation if granular else Interpretation()).to_sampling_rules(analog)
    particles = make_particle_table([one for one in media if isinstance(one, StackedParticleLayer)])
    column = NO_GROUND if get_reflecting_ground(medium) is None else int(materials[-1])
    table = _merge_grain_types(grains, materials)
    return Scene(make_source(incidence_deg), layers, table, rules, particles, column, False)


def _compute_pore_cdf(media: Sequence[LayerModel]) -> np.ndarray:
    """Return cumulative shares of what fills pores besides air and water."""
    shares = [
        [] if isinstance(one, StackedParticleLayer) else list(one.pores.values()) for one in media
    ]
    most = max(len(row) for row in shares)
    return np.array(
        [
            float(one.wet_fraction) + np.cumsum([*row, *[0.0] * (most - len(row))])
            for one, row in zip(media, shares, strict=True)
        ]
    ).reshape(len(media), most)


def add_recording_planes(scene: Scene, depths_m: Sequence[float]) -> Scene:
    """Return a scene cut at depths (m), in which rays that pass faces between layers are noted.

    Cutting a layer changes nothing for the light in it.
    """
    layers = scene.layers
    cut = -np.asarray(depths_m, dtype=float)
    face = -np.unique(-np.concatenate([layers.boundaries, cut]))
    # The layer that each of the new ones is a piece of.
    piece = np.searchsorted(-layers.boundaries, -face[:-1], side="right") - 1
    rows = {name: getattr(layers, name)[piece] for name in layers._fields if name != "boundaries"}
    return scene._replace(layers=Layers(boundaries=face, **rows), record_crossings=True)


def _make_placeholder_grains(attenuation: float, points: int) -> GrainPopulation:
    """Return for a layer of particles what stands in place of its grains, and is never met."""
    one = np.ones((1, points))
    types = GrainTypes(
        n_shells=np.ones(1, dtype=np.int64),
        material=np.zeros((1, 1), dtype=np.int64),
        coating_thickness=np.zeros((1, 1)),
        curvature=one,
        sphericity=one,
        facetness=np.zeros((1, points)),
    )
    return GrainPopulation(max(attenuation, MIN_ATTENUATION_PER_M), np.ones(1), types)


def _find_particle_rows(media: Sequence[LayerModel]) -> np.ndarray:
    """Return the row of its particles for every layer, `NO_PARTICLES` for one of grains."""
    has = np.array([isinstance(one, StackedParticleLayer) for one in media])
    return np.where(has, np.cumsum(has) - 1, NO_PARTICLES)


def make_particle_table(media: Sequence[StackedParticleLayer]) -> ParticleScattering:
    """Return the table of the particles of these layers."""
    phases = [one.layer.kernel_phase_function for one in media]
    longest = max((len(one.cosines) for one in phases), default=2)

    def table(name: str) -> np.ndarray:
        rows = [np.pad(row, (0, longest - len(row))) for row in (getattr(p, name) for p in phases)]
        return np.array(rows).reshape(len(phases), longest)

    return ParticleScattering(
        albedo=np.array([one.layer.single_scattering_albedo for one in media], dtype=float),
        kind=np.array([one.kind for one in phases], dtype=np.int64),
        g=np.array([one.g for one in phases], dtype=float),
        table_size=np.array([len(one.cosines) for one in phases], dtype=np.int64),
        cosines=table("cosines"),
        density=table("density"),
        cdf=table("cdf"),
    )


def _merge_grain_types(
    populations: Sequence[GrainPopulation], first_materials: np.ndarray
) -> GrainTypes:
    """Return one table of the types of all layers, whose materials begin at given rows."""
    if len(populations) == 1:
        return populations[0].types
    deepest = max(one.types.material.shape[1] for one in populations)

    def wide(table: np.ndarray) -> np.ndarray:
        return np.pad(table, ((0, 0), (0, deepest - table.shape[1])))

    def every(name: str) -> np.ndarray:
        rows = [
            np.broadcast_to(table, (len(one.type_cdf), table.shape[1]))
            for one in populations
            for table in [getattr(one.types, name)]
        ]
        # Kernels read tables row by row, and concatenation keeps the order of what is broadcast.
        return np.ascontiguousarray(np.concatenate(rows))

    shift = zip(populations, first_materials, strict=False)
    return GrainTypes(
        n_shells=np.concatenate([one.types.n_shells for one in populations]),
        material=np.concatenate([wide(one.types.material + first) for one, first in shift]),
        coating_thickness=np.concatenate(
            [wide(one.types.coating_thickness) for one in populations]
        ),
        curvature=every("curvature"),
        sphericity=every("sphericity"),
        facetness=every("facetness"),
    )
