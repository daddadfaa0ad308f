"""Scenes: illuminated media in the form that kernels use."""

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
MIN_COLLISION_COEFFICIENT = 1e-12
"""Scatterings per metre of a layer without particles, so that its mean free path is finite."""


class OpticalConstants(NamedTuple):
    """Optical constants over wavelength; a ground, if there is one, follows the materials.

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
    """Return the source for an incidence: degrees of a beam, or "diffuse"."""
    if incidence_deg == "diffuse":
        return Source(1.0, 1.0)
    return Source(float(np.cos(np.radians(float(incidence_deg)))), 0.0)


def get_reflecting_ground(medium: Medium) -> Ground | None:
    """Return the ground below a medium, None where it does not reflect."""
    ground = getattr(medium, "ground", None)
    return ground if ground is not None and ground.is_reflecting else None


def make_height_fields(medium: Medium) -> HeightFields | None:
    """Return the rough surface on top of layers in the form of kernels, None where it is smooth."""
    top = medium.scene_layers[0] if isinstance(medium, LayeredMedium) else medium
    return top.make_height_fields() if isinstance(top, StackedParticleLayer) else None


def count_length_columns(medium: Medium) -> int:
    """Return the number of recorded lengths of a path: one per material, and hits of a ground."""
    return len(medium.list_materials()) + (get_reflecting_ground(medium) is not None)


def compute_optical_constants(medium: Medium, wavelength_nm: np.ndarray) -> OpticalConstants:
    """Return the optical constants of a medium and its ground at wavelengths (nm)."""
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
    """Return illuminated granular media; `analog` samples absorption at each segment."""
    media = medium.scene_layers if isinstance(medium, LayeredMedium) else (medium,)
    granular = [layer for layer in media if not isinstance(layer, StackedParticleLayer)]
    populations = [layer.make_grain_population() for layer in granular]
    n_points = populations[0].types.inverse_semi_major.shape[1] if populations else 2
    remaining = iter(populations)
    grains = [
        _make_placeholder_grains(layer.layer.extinction_per_m, n_points)
        if isinstance(layer, StackedParticleLayer)
        else next(remaining)
        for layer in media
    ]
    first_materials = np.cumsum([0, *(len(layer.list_materials()) for layer in media)])
    first_types = np.cumsum([0, *(len(layer.type_cdf) for layer in grains)])
    max_types = max(len(layer.type_cdf) for layer in grains)
    boundaries = -np.cumsum([0.0, *(float(layer.depth_m) for layer in media)])
    fields = make_height_fields(medium)
    if fields is not None:
        # Above the highest point that a realization of the surface may have.
        boundaries[0] = MAX_HEIGHT_SIGMA * np.linalg.norm(fields.rms_height)
    layers = Layers(
        boundaries=boundaries,
        collision_coefficient=np.array([layer.collision_coefficient for layer in grains]),
        wet_fraction=np.array([float(layer.wet_fraction) for layer in media]),
        type_cdf=np.array(
            [
                np.pad(layer.type_cdf, (0, max_types - len(layer.type_cdf)), "edge")
                for layer in grains
            ]
        ),
        first_type=first_types[:-1],
        first_pore_material=first_materials[:-1],
        pore_cdf=_compute_pore_cdf(media),
        particle_row=_find_particle_rows(media),
    )
    rules = (granular[0].interpretation if granular else Interpretation()).to_sampling_rules(analog)
    particles = make_particle_table(
        [layer for layer in media if isinstance(layer, StackedParticleLayer)]
    )
    ground_column = NO_GROUND if get_reflecting_ground(medium) is None else int(first_materials[-1])
    grain_types = _merge_grain_types(grains, first_materials)
    return Scene(
        make_source(incidence_deg), layers, grain_types, rules, particles, ground_column, False
    )


def _compute_pore_cdf(media: Sequence[LayerModel]) -> np.ndarray:
    """Return cumulative fractions of the pore materials other than air and water."""
    fractions = [
        [] if isinstance(layer, StackedParticleLayer) else list(layer.pores.values())
        for layer in media
    ]
    n_columns = max(len(layer_fractions) for layer_fractions in fractions)
    return np.array(
        [
            float(layer.wet_fraction)
            + np.cumsum([*layer_fractions, *[0.0] * (n_columns - len(layer_fractions))])
            for layer, layer_fractions in zip(media, fractions, strict=True)
        ]
    ).reshape(len(media), n_columns)


def add_recording_planes(scene: Scene, depths_m: Sequence[float]) -> Scene:
    """Return a scene divided at depths (m), in which crossings of boundaries are recorded.

    Dividing a layer does not change the transport in it.
    """
    layers = scene.layers
    plane_heights = -np.asarray(depths_m, dtype=float)
    boundaries = -np.unique(-np.concatenate([layers.boundaries, plane_heights]))
    # The original layer of each new one.
    original = np.searchsorted(-layers.boundaries, -boundaries[:-1], side="right") - 1
    rows = {
        name: getattr(layers, name)[original] for name in layers._fields if name != "boundaries"
    }
    return scene._replace(layers=Layers(boundaries=boundaries, **rows), record_crossings=True)


def _make_placeholder_grains(collision_coefficient: float, points: int) -> GrainPopulation:
    """Return a placeholder for the grains of a particle layer, which no ray hits."""
    ones = np.ones((1, points))
    types = GrainTypes(
        n_shells=np.ones(1, dtype=np.int64),
        material=np.zeros((1, 1), dtype=np.int64),
        coating_thickness=np.zeros((1, 1)),
        inverse_semi_major=ones,
        sphericity=ones,
        facetness=np.zeros((1, points)),
    )
    return GrainPopulation(max(collision_coefficient, MIN_COLLISION_COEFFICIENT), np.ones(1), types)


def _find_particle_rows(media: Sequence[LayerModel]) -> np.ndarray:
    """Return the row of each layer in the particle table, `NO_PARTICLES` for granular layers."""
    has_particles = np.array([isinstance(layer, StackedParticleLayer) for layer in media])
    return np.where(has_particles, np.cumsum(has_particles) - 1, NO_PARTICLES)


def make_particle_table(media: Sequence[StackedParticleLayer]) -> ParticleScattering:
    """Return the table of the particles of these layers."""
    phase_functions = [layer.layer.kernel_phase_function for layer in media]
    n_columns = max((len(layer.cosines) for layer in phase_functions), default=2)

    def pad_columns(name: str) -> np.ndarray:
        rows = [
            np.pad(row, (0, n_columns - len(row)))
            for row in (getattr(phase, name) for phase in phase_functions)
        ]
        return np.array(rows).reshape(len(phase_functions), n_columns)

    return ParticleScattering(
        albedo=np.array([layer.layer.single_scattering_albedo for layer in media], dtype=float),
        kind=np.array([layer.kind for layer in phase_functions], dtype=np.int64),
        g=np.array([layer.g for layer in phase_functions], dtype=float),
        table_size=np.array([len(layer.cosines) for layer in phase_functions], dtype=np.int64),
        cosines=pad_columns("cosines"),
        density=pad_columns("density"),
        cdf=pad_columns("cdf"),
    )


def _merge_grain_types(
    populations: Sequence[GrainPopulation], first_materials: np.ndarray
) -> GrainTypes:
    """Return one table of the grain types of all layers, given the first material of each layer."""
    if len(populations) == 1:
        return populations[0].types
    max_shells = max(population.types.material.shape[1] for population in populations)

    def pad_columns(table: np.ndarray) -> np.ndarray:
        return np.pad(table, ((0, 0), (0, max_shells - table.shape[1])))

    def concatenate(name: str) -> np.ndarray:
        rows = [
            np.broadcast_to(table, (len(population.type_cdf), table.shape[1]))
            for population in populations
            for table in [getattr(population.types, name)]
        ]
        # Kernels read tables row by row; concatenation keeps the memory order of broadcast rows.
        return np.ascontiguousarray(np.concatenate(rows))

    population_materials = zip(populations, first_materials, strict=False)
    return GrainTypes(
        n_shells=np.concatenate([population.types.n_shells for population in populations]),
        material=np.concatenate(
            [
                pad_columns(population.types.material + first_material)
                for population, first_material in population_materials
            ]
        ),
        coating_thickness=np.concatenate(
            [pad_columns(population.types.coating_thickness) for population in populations]
        ),
        inverse_semi_major=concatenate("inverse_semi_major"),
        sphericity=concatenate("sphericity"),
        facetness=concatenate("facetness"),
    )
