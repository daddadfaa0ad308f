"""Scene of the kernels: plain numbers and arrays, in SI units.

These named tuples are the interface between media and kernels.  Materials are rows of the arrays of
optical constants.  Each layer has its own block of rows from `Layers.first_pore_material`: dry
pores, wet pores or matrix, further pore media, then cores and coatings.  A reflecting ground adds a
last row.  Features that a scene lacks are None, and their code is compiled away.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from splits.kernels.base.sampling_rules import SamplingRules
from splits.kernels.optics.source import Source
from splits.kernels.optics.stokes import Stokes

DRY_PORE = 0
WET_PORE = 1
MATRIX = WET_PORE
"""Materials of the pores of a layer, from its first one on.  A layer of particles is traced as one
that is all wet, with its matrix in place of the wet pores."""

NO_PARTICLES = -1
"""Value of `Layers.particle_row` for a layer of grains."""

NO_GROUND = -1
"""Value of `Scene.ground_column` without a reflecting ground."""


class Layers(NamedTuple):
    """Media between horizontal boundaries, top first.

    Attributes
    ----------
    boundaries : float64[layers + 1]
        Heights of the boundaries (m).  The first is 0; with a rough top, whose mean height is 0, it
        is a height that no point of the surface exceeds.  The last may be −inf below particles.
    collision_coefficient : float64[layers]
        Expected number of collisions per metre of path in the pore space; the extinction
        coefficient in a layer of particles.
    wet_fraction : float64[layers]
        Probability that a path segment in the pore space is in the wet medium.
    type_cdf : float64[layers, types]
        Cumulative probability that the grain hit is of type 0…i of the layer.
    first_type : int64[layers]
        Row of the first type of the layer.
    first_pore_material : int64[layers]
        Material of the dry pores, which is also that outside the sample, followed by those of the
        wet pores, or of the matrix of particles, and of further pore media.
    pore_cdf : float64[layers, media]
        Cumulative probabilities, starting from the wet fraction, of the further pore media.
    particle_row : int64[layers]
        Row of `ParticleScattering` for a layer of particles, `NO_PARTICLES` for a layer of grains.
    """

    boundaries: np.ndarray
    collision_coefficient: np.ndarray
    wet_fraction: np.ndarray
    type_cdf: np.ndarray
    first_type: np.ndarray
    first_pore_material: np.ndarray
    pore_cdf: np.ndarray
    particle_row: np.ndarray


class ParticleScattering(NamedTuple):
    """Single scattering by small particles, see `splits.kernels.optics.phase_function`.

    Attributes
    ----------
    albedo : float64[rows]
        Single-scattering albedo.
    absorption_depth : float64[rows]
        Optical depth of absorption at a collision, −ln(albedo).
    kind : int64[rows]
    g : float64[rows]
    dipole_fraction, circular_ratio : float64[rows]
    table_size : int64[rows]
        Length of the table.
    cosines, density, cdf : float64[rows, m]
    elements : float64[rows, m, 5]
        See `PhaseFunction`.
    """

    albedo: np.ndarray
    absorption_depth: np.ndarray
    kind: np.ndarray
    g: np.ndarray
    dipole_fraction: np.ndarray
    circular_ratio: np.ndarray
    table_size: np.ndarray
    cosines: np.ndarray
    density: np.ndarray
    cdf: np.ndarray
    elements: np.ndarray


class Scene(NamedTuple):
    """Light source, layers, grains, particles and ground, with the sampling rules.

    Attributes
    ----------
    source : Source
    layers : Layers
    types : GrainTypes, the types of another shape, or None
        None without layers of grains.
    rules : SamplingRules
    particles : ParticleScattering or None
        None without layers of particles.
    ground_column : int
        Column of the path lengths that counts the hits of the ground, whose "absorption" is −ln of
        its albedo; `NO_GROUND` without a reflecting ground.
    record_crossings : bool
        Whether crossings of boundaries between layers are recorded.
    ground_contact : True or None
        Whether the ground is in contact with the matrix of the lowest layer; otherwise the lower
        boundary of the sample is an interface.
    bottom_albedo : float or None
        Albedo of a Lambertian bottom whose absorption is analog; it replaces the ground.
    stokes : Stokes or None
        Polarization of the incident light; None without polarization.
    height_fields : HeightFields or None
        The rough surface on top, of which every ray has its own realization; None for a smooth top.
    opaque : True or None
        Whether the top layer absorbs all light that enters.
    detectors : Detectors or None
        Detectors of next-event estimation, see `splits.kernels.transport.next_event`.
    """

    source: Source
    layers: Layers
    types: Any
    rules: SamplingRules
    particles: ParticleScattering | None
    ground_column: int
    record_crossings: bool
    ground_contact: bool | None = None
    bottom_albedo: float | None = None
    stokes: Stokes | None = None
    height_fields: Any = None
    opaque: bool | None = None
    detectors: Any = None


class Optics(NamedTuple):
    """Optical constants of the materials for the paths of one stream.

    Attributes
    ----------
    n, k : float64[materials]
        Complex refractive index n + i k for reflection and refraction.
    absorption : float64[materials]
        Absorption coefficients (1/m).  An analog run samples absorption with them; in a weighted
        run they are lower bounds over the wavelengths that use the paths, for Russian roulette.
    """

    n: np.ndarray
    k: np.ndarray
    absorption: np.ndarray


def make_bounding_optics(index: np.ndarray, absorption: np.ndarray) -> Optics:
    """Return `Optics` with the smallest absorption over the wavelengths that use the paths.

    Parameters
    ----------
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Absorption coefficients (1/m), of which roulette uses the minimum over wavelengths.
    """
    return Optics(index.real.copy(), index.imag.copy(), absorption.min(axis=0))
