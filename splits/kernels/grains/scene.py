"""Scene of the kernels: plain numbers and arrays, in SI units.

These named tuples are the interface between media and kernels.  Materials are rows of the arrays of
optical constants.  Each layer has its own block of rows from `Layers.first_pore_material`: dry
pores, wet pores, further pore media, then cores and coatings.  A reflecting ground adds a last row.
Features that a scene lacks are None, and their code is compiled away.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from splits.kernels.grains import microfacet, spheroid
from splits.kernels.optics.source import Source
from splits.kernels.optics.stokes import Stokes

DRY_PORE = 0
WET_PORE = 1

NO_PARTICLES = -1
"""Value of `Layers.particle_row` for a layer of grains."""

NO_GROUND = -1
"""Value of `Scene.ground_column` without a reflecting ground."""

NO_MAX_ORDER = 2**31 - 1
"""Largest order of scattering if it is unlimited."""

MAX_REJECTIONS = 10_000_000
"""Successive rejections after which a ray counts as lost.

At grazing incidence few grains fit below the boundary: 3e5 are rejected on average at 89.9999
degrees.
"""

WRONG_SIDE_LOBE = 0
"""A direction on the wrong side of the macroscopic surface is replaced by a cosine lobe."""
WRONG_SIDE_MIRROR = 1
"""A direction on the wrong side of the macroscopic surface is mirrored in that surface."""

OVERLAP_KEEP = 0
"""An overlapping grain is accepted."""
OVERLAP_REJECT = 1
"""An overlapping grain is rejected; distance and grain are sampled again from the segment start."""
OVERLAP_SKIP = 2
"""An overlapping grain is skipped: the next distance starts from it."""

GRAIN_EXTENT = {"finite": False, "point": True}
"""Whether the path through a grain displaces the ray, or the grain is a point scatterer."""

ENTRY_SAMPLING = {"uniform": spheroid.UNIFORM_ENTRY, "projected": spheroid.PROJECTED_ENTRY}
FACET_SAMPLING = {
    "projected": microfacet.PROJECTED_FACETS,
    "unweighted": microfacet.UNWEIGHTED_FACETS,
    "any": microfacet.ANY_FACETS,
}
WRONG_SIDE_RULE = {"cosine_lobe": WRONG_SIDE_LOBE, "mirror": WRONG_SIDE_MIRROR}
OVERLAP_RULE = {"reject": OVERLAP_REJECT, "keep": OVERLAP_KEEP, "skip": OVERLAP_SKIP}


class GrainTypes(NamedTuple):
    """Grain types; distributions are quantile functions (`rng.make_table_probabilities`).

    A table of distributions has one row per type, or a single row that holds for all of them.

    Attributes
    ----------
    n_shells : int64[types]
        Number of coatings plus one, the core.
    material : int64[types, shells]
        Rows of the materials from the outermost coating to the core.
    coating_thickness : float64[types, shells]
        Thickness of the coatings as a fraction of the major axis; unused for the core.
    inverse_semi_major : float64[rows, m]
        Inverse semi-major axis of the grains hit (1/m).  Weighting with the cross section makes the
        inverse uniform, so that a table of it is exact for any range of sizes.
    sphericity : float64[rows, m]
        Inscribed-circle sphericity of the grains hit.
    facetness : float64[rows, m]
        Facetness of the grains hit.
    """

    n_shells: np.ndarray
    material: np.ndarray
    coating_thickness: np.ndarray
    inverse_semi_major: np.ndarray
    sphericity: np.ndarray
    facetness: np.ndarray


class GrainPopulation(NamedTuple):
    """Grains of a medium.

    Attributes
    ----------
    collision_coefficient : float
        Expected number of grains hit per metre of path in the pore space, all types together.
    type_cdf : float64[types]
        Cumulative probability that the grain hit is of type 0…i; the last entry is 1.
    types : GrainTypes
    """

    collision_coefficient: float
    type_cdf: np.ndarray
    types: GrainTypes


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
        wet pores and of further pore media.  A layer of particles is all wet: its matrix is the
        second.
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
    max_polarization : float64[rows]
    table_size : int64[rows]
        Length of the table.
    cosines, density, cdf : float64[rows, m]
        See `PhaseFunction`.
    """

    albedo: np.ndarray
    absorption_depth: np.ndarray
    kind: np.ndarray
    g: np.ndarray
    max_polarization: np.ndarray
    table_size: np.ndarray
    cosines: np.ndarray
    density: np.ndarray
    cdf: np.ndarray


class SamplingRules(NamedTuple):
    """Sampling options of the kernels, as integer codes; they implement the interpretations.

    With `analog`, absorption is sampled on each segment; otherwise path lengths are recorded and
    converted to weights at the exit.  Without `boundary_fresnel`, wet pores at boundaries refract
    and reflect nothing.  With `point_grains`, grains are point scatterers: a ray leaves a grain at
    the point at which it entered.
    """

    entry_sampling: int
    facet_sampling: int
    wrong_side: int
    boundary_fresnel: bool
    segment_overlap: int
    boundary_overlap: int
    analog: bool
    point_grains: bool


class Scene(NamedTuple):
    """Light source, layers, grains, particles and ground, with the sampling rules.

    Attributes
    ----------
    source : Source
    layers : Layers
    types : GrainTypes or None
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
    opaque: bool | None = None
    detectors: Any = None


class Optics(NamedTuple):
    """Optical constants of the materials for one ensemble of paths.

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
