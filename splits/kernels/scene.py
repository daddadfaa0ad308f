"""Data of the kernels: scenes with their grains and light source, rays, and the work of a call.

Nothing here is compiled, so that media and other solvers use these types without the compiler.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

# --------------------------------------------------------------------------------------------------
# Vectors, and the polarization of a ray.
#
# Kernels pass rays as named tuples, which the compiler dissolves: a `Vector` costs as much as three
# numbers.


class Vector(NamedTuple):
    """Point (m) or direction (unit length)."""

    x: float
    y: float
    z: float


UP = Vector(0.0, 0.0, 1.0)


ORIGIN = Vector(0.0, 0.0, 0.0)


class Stokes(NamedTuple):
    """Polarization of a ray: the reference e, and Q, U and V over I.

    `None` in its place disables polarization at compile time.
    """

    e: Vector
    q: float
    u: float
    v: float


UNPOLARIZED = Stokes(Vector(1.0, 0.0, 0.0), 0.0, 0.0, 0.0)
"""Unpolarized light, with an arbitrary reference."""


# --------------------------------------------------------------------------------------------------
# Sampling rules: options of the kernels as integer codes, and the names of the codes.

UNIFORM_ENTRY = 0
"""Entry point uniform over the surface facing the ray (SPLITS 4.3.3, SPLITSnow 3.2)."""
PROJECTED_ENTRY = 1
"""Entry point and orientation weighted by area projected along the ray, the geometric law."""

PROJECTED_FACETS = 0
"""Facets facing the ray, sampled in proportion to their projected area (SPLITS 4.3.4)."""
UNWEIGHTED_FACETS = 1
"""Facets facing the ray, sampled with equal probability."""
ANY_FACETS = 2
"""Any facet; one that faces away acts with its back side."""

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

ENTRY_SAMPLING = {"uniform": UNIFORM_ENTRY, "projected": PROJECTED_ENTRY}
FACET_SAMPLING = {
    "projected": PROJECTED_FACETS,
    "unweighted": UNWEIGHTED_FACETS,
    "any": ANY_FACETS,
}
WRONG_SIDE_RULE = {"cosine_lobe": WRONG_SIDE_LOBE, "mirror": WRONG_SIDE_MIRROR}
OVERLAP_RULE = {"reject": OVERLAP_REJECT, "keep": OVERLAP_KEEP, "skip": OVERLAP_SKIP}


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


# --------------------------------------------------------------------------------------------------
# Features of a scene for which kernels are specialized at compile time.
#
# Code of absent features is compiled away.  Features that cost no measurable time are always
# compiled (benchmarks/kernels.py): the interpretations of the papers, horizontal positions, and the
# order of scattering.


class Features(NamedTuple):
    """Features of a scene, each True or None.

    The two values differ in type, so that branches on them are decided at compile time.

    Attributes
    ----------
    wet : True or None
        Some path segments run through wet pores.
    faceted : True or None
        Some grains are rough.
    absorbing : True or None
        Extinction coefficients affect reflection.
    mixed : True or None
        There are several grain types, or coatings; includes `absorbing`.
    layered : True or None
        There are several layers; includes `mixed`.
    """

    wet: bool | None
    faceted: bool | None
    absorbing: bool | None
    mixed: bool | None
    layered: bool | None


ALL_FEATURES = Features(*[True] * len(Features._fields))
"""Features of the scalar kernel."""


# --------------------------------------------------------------------------------------------------
# Grains of a medium: size, shape and materials of the grains that a ray hits.


class GrainTypes(NamedTuple):
    """Grain types; distributions are quantile functions (`make_table_probabilities`).

    A table of distributions has one row per type, or a single row that holds for all of them.
    Another shape has a class of its own, with the first four fields and further such tables.

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
    types : GrainTypes, or the types of another shape
    """

    collision_coefficient: float
    type_cdf: np.ndarray
    types: Any


def make_table_probabilities(n_points):
    """Return the probabilities of a quantile table, float64[points], dense at both ends.

    u = 2x² below one half and its mirror image above, x equidistant: the outermost interval of 1025
    points holds 2e-6 of the probability, so that the tails of distributions are resolved.
    """
    x = np.linspace(0.0, 1.0, n_points)
    return np.where(x < 0.5, 2.0 * x**2, 1.0 - 2.0 * (1.0 - x) ** 2)


# --------------------------------------------------------------------------------------------------
# Randomly rough surfaces on top of layers.

EXPONENTIAL_AS_PRINTED, EXPONENTIAL, GAUSSIAN, TABULATED = range(4)
"""Distributions of the wave number, see `wave_number_quantile`."""


class HeightFields(NamedTuple):
    """Superposed random fields, one entry each.

    Attributes
    ----------
    rms_height : float64[fields]
        σ (m).
    n_waves : int64[fields]
        M.
    law : int64[fields]
        `EXPONENTIAL_AS_PRINTED`, `EXPONENTIAL`, `GAUSSIAN` or `TABULATED`.
    wave_number : float64[fields]
        k0 (1/m); unused with a table.
    band_fraction : float64[fields]
        Cumulative probability of the distribution at the band limit; 1 without one.
    quantiles : float64[fields, m]
        Quantile functions of λ (1/m) of fields with a table
        (`make_table_probabilities`).
    """

    rms_height: np.ndarray
    n_waves: np.ndarray
    law: np.ndarray
    wave_number: np.ndarray
    band_fraction: np.ndarray
    quantiles: np.ndarray


MAX_HEIGHT_SIGMA = 50.0
"""Bound of the height of realizations in standard deviations.

`bands.BOUND_SIGMA` times the root of −ln u, with u the smallest random number, is below it.
"""


# --------------------------------------------------------------------------------------------------
# Light sources: a collimated beam and diffuse light from above.


class Source(NamedTuple):
    """Collimated beam, isotropic radiance from the upper hemisphere, or a mixture of both.

    Attributes
    ----------
    cos_incidence : float
        Cosine of the beam's angle of incidence, in (0, 1].
    diffuse_fraction : float
        Fraction of the incident flux that is diffuse, with isotropic radiance, 0 to 1.
    """

    cos_incidence: float
    diffuse_fraction: float


# --------------------------------------------------------------------------------------------------
# Scene of the kernels: plain numbers and arrays, in SI units.
#
# These named tuples are the interface between media and kernels.  Materials are rows of the arrays
# of optical constants.  Each layer has its own block of rows from `Layers.first_pore_material`: dry
# pores, wet pores or matrix, further pore media, then cores and coatings.  A reflecting ground adds
# a last row.  Features that a scene lacks are None, and their code is compiled away.

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
    """Single scattering by small particles, see `splits.kernels.phase_function`.

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
    ground_albedo : float or None
        Albedo of a ground whose absorption is analog, for the directions of the light that it
        absorbs; it replaces the column of the ground.
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
    ground_albedo: float | None = None
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


# --------------------------------------------------------------------------------------------------
# State of a ray between grains, or at its end.

ABSORBED = 0
"""The history ended without an exit: by absorption, roulette, or the maximum order of
scattering."""
REFLECTED = 1
TRANSMITTED = 2
LOST = 3
"""Lost ray: no grain was accepted, no intersection with a surface was found, or a rough surface
extends below the top layer.  This should not happen and is reported."""
ALIVE = 4
TO_GROUND = 5
"""The ray reached the ground, or the Lambertian bottom in contact with the lowest layer."""


class Segment(NamedTuple):
    """Path segment: its end, its direction towards that end, and its length (m), −1 for none."""

    end: Vector
    direction: Vector
    length: float


NO_SEGMENT = Segment(ORIGIN, Vector(0.0, 0.0, -1.0), -1.0)
"""Previous segment of a ray that starts."""


class Ray(NamedTuple):
    """State of a ray.

    Attributes
    ----------
    status : int
        `ALIVE`, `TO_GROUND`, or the way it ended.
    position : Vector
        Point of the last event (m): the start, a boundary, a facet, a particle, or the entry point
        of a grain.
    exit_offset : Vector
        Vector from there to the exit point of the grain (m); zero except after a grain.  The ray is
        at the sum of both.
    direction : Vector
        Direction of travel.
    previous_segment : Segment
        Segment that ended at `position`; its end is unused.
    start_distance : float
        Distance at which the sampling of the next grain starts (m): that of the last skipped grain,
        or of the boundary through which the ray entered its layer.
    layer : int
        Layer of the scene in which the ray is.
    pore_variate : float
        Random number that selects the pore medium, see `grain_path.pore_material`.
    weight : float
        Statistical weight without absorption in materials: the inverse probability of survival,
        times the single-scattering albedos of the particles hit and the reflectances of an opaque
        surface.
    optical_depth : float
        Lower bound, over the wavelengths that use the path, of the optical depth of absorption so
        far, including −ln of the albedos of particles and of the ground; for roulette only.
    next_roulette : float
        Optical depth at which Russian roulette is next played.
    n_segments : int
        Path segments in the sample, a measure of the cost.
    order : int
        Order of scattering: collisions with grains and particles, and hits of a rough surface and
        of the ground.
    max_order : int
        Order after which the ray counts as absorbed.
    stokes : Stokes or None
        Polarization; None in scenes without polarization.
    """

    status: int
    position: Vector
    exit_offset: Vector
    direction: Vector
    previous_segment: Segment
    start_distance: float
    layer: int
    pore_variate: float
    weight: float
    optical_depth: float
    next_roulette: float
    n_segments: int
    order: int
    max_order: int
    stokes: Any


# --------------------------------------------------------------------------------------------------
# Work of a kernel call: the rays that it traces, one integer in each column.

STREAM, FIRST_RAY, N_RAYS, MAX_ORDER = range(4)
"""Columns of the work: stream, first ray, number of rays, and order of scattering after which a ray
counts as absorbed.

Seed, stream and ray determine the random numbers of a ray, so that results do not depend on the
division of rays into calls.  All wavelengths that share paths use one stream.
"""

NO_MAX_ORDER = 2**31 - 1
"""Largest order of scattering if it is unlimited."""
