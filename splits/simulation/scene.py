"""Scenes: illuminated media in the form that kernels use."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np

from splits.core.arrays import as_1d_array
from splits.core.declarations import Quantity
from splits.core.inputs import INCIDENT_STOKES, Numbers, describe_numbers
from splits.core.validation import as_scalar, invalid
from splits.kernels.scattering_matrix import PhaseFunction
from splits.kernels.scene import (
    MAX_HEIGHT_SIGMA,
    NO_GROUND,
    NO_PARTICLES,
    UNPOLARIZED,
    GrainPopulation,
    HeightFields,
    Layers,
    ParticleScattering,
    Scene,
    Source,
    Stokes,
    Vector,
)
from splits.materials.library import absorption_coefficient
from splits.media.interpretations import Interpretation
from splits.media.medium import Layer, Medium, ParticleMedium

# --------------------------------------------------------------------------------------------------
# Polarization of the incident light.

ALLOWED_STOKES = "true, false, or I, Q, U, V of the incident light"


class IncidentPolarization(NamedTuple):
    """Q, U and V over I of the incident light, for the plane of incidence as reference.

    None in its place denotes a run without polarization, which differs from unpolarized light.
    """

    q: float = 0.0
    u: float = 0.0
    v: float = 0.0

    def make_stokes(self, incidence_deg: float | str) -> Stokes:
        """Return the `Stokes` of a beam, whose reference is in the plane of incidence.

        The beam travels along (sin θ, 0, −cos θ).  At normal incidence the plane contains azimuth
        0, the x axis.  For diffuse light, whose directions are sampled, the reference is arbitrary.
        """
        if isinstance(incidence_deg, str):
            return UNPOLARIZED
        angle = math.radians(incidence_deg)
        return Stokes(Vector(math.cos(angle), 0.0, math.sin(angle)), *self)


def describe_polarization(polarization: IncidentPolarization | None) -> dict[str, list[float]]:
    """Return the attribute of a dataset: the Stokes vector of the incident light, if any."""
    return {} if polarization is None else {INCIDENT_STOKES: [1.0, *polarization]}


def _normalize_stokes(key: str, stokes: Any) -> bool | tuple[float, ...]:
    """Return whether polarization is traced, or the Stokes vector of light of intensity 1."""
    stokes = as_scalar(stokes)
    if isinstance(stokes, bool):
        return stokes
    values = as_1d_array(key, stokes, ALLOWED_STOKES)
    if values.size != 4:
        raise invalid(key, stokes, ALLOWED_STOKES)
    intensity, *polarized = values.tolist()
    total = math.hypot(*polarized)
    # Values may have been rounded to single precision.
    if not intensity > 0.0 or total > intensity * (1.0 + 1e-6):
        raise invalid(key, stokes, "I > 0 and √(Q² + U² + V²) at most I")
    intensity = max(intensity, total)
    return (1.0, *(value / intensity for value in polarized))


IncidentStokes = Annotated[
    bool | Numbers,
    Quantity(
        "whether polarization is traced, or the Stokes vector (I, Q, U, V) of the incident light; "
        "layers of particles need polarized: true",
        check=_normalize_stokes,
        schema={"anyOf": [{"type": "boolean"}, describe_numbers("I", "Q", "U", "V")]},
    ),
]


def check_stokes(
    stokes: Any, medium: Medium, incidence_deg: float | str
) -> IncidentPolarization | None:
    """Return the polarization of the incident light, None for runs without polarization.

    Parameters
    ----------
    stokes : bool or tuple of float
        An `IncidentStokes` in its final form.
    medium : Medium
        Polarized layers of particles require polarization, and other ones do not allow it.
    incidence_deg : float or "diffuse"

    Raises
    ------
    ValueError
        For polarized diffuse light, and layers that define no polarization.
    """
    if stokes is False:
        return IncidentPolarization() if medium.polarized else None
    light = IncidentPolarization() if stokes is True else IncidentPolarization(*stokes[1:])
    if isinstance(incidence_deg, str) and any(light):
        raise invalid("stokes", stokes, "true for diffuse light", "which is unpolarized")
    for number, layer in enumerate(medium.scene_layers):
        if not (layer.has_grains or layer.polarized):
            key = "polarized" if len(medium.scene_layers) == 1 else f"layers[{number}].polarized"
            raise invalid(key, False, "true with stokes")
    return light


# --------------------------------------------------------------------------------------------------
# Scenes: illuminated media in the form that kernels use.

COLLISION_COEFFICIENT_RANGE = (1e-12, 1e300)
"""Scatterings per metre of a layer without particles, so that its mean free path is finite, and of
an opaque layer."""

INDEX_RANGE, MAX_EXTINCTION_INDEX = (0.1, 15.0), 1e10
"""Refractive indices of grains and of pores, so that light leaves a grain soon enough."""

N_PORE_MATERIALS = 2
"""Number of materials for dry and wet pores; they precede those of other pore fluids."""


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


def make_height_fields(medium: Medium) -> HeightFields | None:
    """Return the rough surface on top of layers in the form of kernels, None where it is smooth."""
    return medium.scene_layers[0].make_height_fields()


def compute_material_constants(medium: Medium, wavelength_nm: np.ndarray) -> OpticalConstants:
    """Return the optical constants of a medium's materials, with impurities, at wavelengths (nm).

    The absorption applies to path lengths as recorded by the kernels.
    """
    index = medium.compute_refractive_indices(wavelength_nm)
    # In a grain of many directions light is reflected some n³ times before it leaves.
    low, high = INDEX_RANGE
    inside = (index.real >= low) & (index.real <= high) & (index.imag <= MAX_EXTINCTION_INDEX)
    if not inside.all():
        row, column = np.argwhere(~inside)[0]
        raise invalid(
            f"refractive_index[{medium.list_materials()[column]}]", complex(index[row, column]),
            f"n + kj with n from {low:g} to {high:g} and k up to {MAX_EXTINCTION_INDEX:g}",
            f"at {wavelength_nm[row]:g} nm",
        )  # fmt: skip
    absorption = absorption_coefficient(index, wavelength_nm[:, np.newaxis])
    absorption *= compute_path_fractions(medium)
    added = [layer.compute_added_absorption(wavelength_nm) for layer in medium.scene_layers]
    return OpticalConstants(index, absorption + np.concatenate(added, axis=1))


def compute_path_fractions(medium: Medium) -> np.ndarray:
    """Return the fraction of the recorded path length that lies in each material.

    Kernels record whole segments between grains.  Between point grains only a fraction of a segment
    is pore space (see `splits.media.medium.GranularMedium.pore_fraction`).
    """
    fractions = []
    for layer in medium.scene_layers:
        layer_fractions = np.ones(len(layer.list_materials()))
        layer_fractions[: N_PORE_MATERIALS + len(layer.pores)] = layer.pore_fraction
        fractions.append(layer_fractions)
    return np.concatenate(fractions)


def compute_optical_constants(medium: Medium, wavelength_nm: np.ndarray) -> OpticalConstants:
    """Return the optical constants of a medium and its ground at wavelengths (nm)."""
    index, absorption = constants = compute_material_constants(medium, wavelength_nm)
    ground = medium.reflecting_ground
    if ground is None:
        return constants
    return OpticalConstants(
        np.pad(index, ((0, 0), (0, 1)), constant_values=1.0),
        np.column_stack([absorption, ground.optical_depth(wavelength_nm)]),
    )


def get_ground_albedo(medium: Medium) -> float | None:
    """Return the albedo of a reflecting ground whose absorption may be analog, otherwise None.

    It is in contact with a layer of particles, and the same at all wavelengths.  Light that it
    absorbs is then an exit, of which tallies know the direction.
    """
    ground = medium.reflecting_ground
    in_contact = medium.lowest_layer.scene_bottom.ground is not None
    if ground is None or not in_contact or ground.wavelength_nm is not None:
        return None
    return float(ground.albedo_values[0])


def build_scene(
    medium: Medium,
    incidence_deg: float | str,
    analog: bool,
    polarization: IncidentPolarization | None = None,
    ground_albedo: float | None = None,
) -> Scene:
    """Return an illuminated medium.

    `analog` samples absorption at each segment; `polarization` is that of the incident light, None
    for runs without it.  Polarized layers of particles require it: unpolarized light by default.
    With `ground_albedo`, see `get_ground_albedo`, the absorption by the ground is analog.
    """
    media = medium.scene_layers
    if polarization is None and medium.polarized:
        polarization = IncidentPolarization()
    granular = [layer for layer in media if layer.has_grains]
    particle_layers = [layer for layer in media if not layer.has_grains]
    first_materials = np.cumsum([0, *(len(layer.list_materials()) for layer in media)])
    populations = [layer.make_grain_population() for layer in media]
    rules = (granular[0].interpretation if granular else Interpretation()).to_sampling_rules(analog)
    source = Source(1.0, 1.0)
    if incidence_deg != "diffuse":
        source = Source(float(np.cos(np.radians(float(incidence_deg)))), 0.0)
    has_ground = medium.reflecting_ground is not None and ground_albedo is None
    height_fields = make_height_fields(medium)
    return Scene(
        source,
        _make_layers(media, populations, first_materials, height_fields),
        _merge_grain_types(populations, first_materials) if granular else None,
        rules,
        make_particle_table(particle_layers) if particle_layers else None,
        int(first_materials[-1]) if has_ground else NO_GROUND,
        False,
        ground_contact=None if media[-1].scene_bottom.ground is None else True,
        ground_albedo=ground_albedo,
        stokes=None if polarization is None else polarization.make_stokes(incidence_deg),
        height_fields=height_fields,
        opaque=True if any(layer.opaque for layer in media) else None,
    )


def _make_layers(
    media: Sequence[Layer],
    populations: Sequence[GrainPopulation | None],
    first_materials: np.ndarray,
    height_fields: HeightFields | None,
) -> Layers:
    """Return the layers of a scene, with None for the grains of layers of particles."""
    type_cdfs = [np.ones(1) if grains is None else grains.type_cdf for grains in populations]
    n_types = [0 if grains is None else len(grains.type_cdf) for grains in populations]
    max_types = max(len(cdf) for cdf in type_cdfs)
    boundaries = -np.cumsum([0.0, *(layer.scene_bottom.depth_m for layer in media)])
    if height_fields is not None:
        # Above the highest point that a realization of the surface may have.
        boundaries[0] = MAX_HEIGHT_SIGMA * np.linalg.norm(height_fields.rms_height)
    n_pores = max(len(layer.pores) for layer in media)
    pore_cdfs = [
        float(layer.wet_fraction)
        + np.cumsum([*layer.pores.values(), *[0.0] * (n_pores - len(layer.pores))])
        for layer in media
    ]
    # Rows of the particle table.
    has_particles = np.array([not layer.has_grains for layer in media])
    return Layers(
        boundaries=boundaries,
        collision_coefficient=np.clip(
            [layer.extinction_per_m for layer in media], *COLLISION_COEFFICIENT_RANGE
        ),
        wet_fraction=np.array([float(layer.wet_fraction) for layer in media]),
        type_cdf=np.array([np.pad(cdf, (0, max_types - len(cdf)), "edge") for cdf in type_cdfs]),
        first_type=np.cumsum([0, *n_types])[:-1],
        first_pore_material=first_materials[:-1],
        # Cumulative fractions of the pore materials other than air and water.
        pore_cdf=np.array(pore_cdfs).reshape(len(media), n_pores),
        particle_row=np.where(has_particles, np.cumsum(has_particles) - 1, NO_PARTICLES),
    )


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


def make_particle_table(layers: Sequence[ParticleMedium]) -> ParticleScattering:
    """Return the table of the particles of these layers."""
    phase_functions = [layer.kernel_phase_function for layer in layers]
    n_columns = max(len(phase.cosines) for phase in phase_functions)

    tables = {
        name: [getattr(one, name) for one in phase_functions] for name in PhaseFunction._fields
    }
    for name in ("cosines", "density", "cdf", "elements"):
        tables[name] = [
            np.pad(row, [(0, n_columns - len(row)), *[(0, 0)] * (row.ndim - 1)])
            for row in tables[name]
        ]

    albedo = np.array(
        [0.0 if layer.opaque else float(layer.single_scattering_albedo) for layer in layers]
    )
    with np.errstate(divide="ignore"):
        absorption_depth = -np.log(albedo)
    return ParticleScattering(
        albedo=albedo,
        absorption_depth=absorption_depth,
        table_size=np.array([len(phase.cosines) for phase in phase_functions]),
        **{name: np.array(rows) for name, rows in tables.items()},
    )


def _merge_grain_types(
    all_populations: Sequence[GrainPopulation | None], all_first_materials: np.ndarray
) -> Any:
    """Return one table of the grain types of all layers, given the first material of each layer.

    The grains may have any shape, which must be the same in all layers.
    """
    by_layer = zip(all_populations, all_first_materials, strict=False)
    granular = [(grains, first) for grains, first in by_layer if grains is not None]
    populations = [grains for grains, _ in granular]
    types = populations[0].types
    if len(all_populations) == 1:
        return types
    if any(type(population.types) is not type(types) for population in populations):
        raise invalid("layers", "grains of several shapes", "grains of one shape")
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

    shells = {
        "n_shells": np.concatenate([population.types.n_shells for population in populations]),
        "material": np.concatenate(
            [
                pad_columns(population.types.material + first_material)
                for population, first_material in granular
            ]
        ),
        "coating_thickness": np.concatenate(
            [pad_columns(population.types.coating_thickness) for population in populations]
        ),
    }
    tables = {name: concatenate(name) for name in types._fields if name not in shells}
    return types._replace(**shells, **tables)
