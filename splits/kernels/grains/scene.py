"""What a kernel is told: plain numbers and arrays, in SI units.

These named tuples are the contract between media and kernels.  Materials are rows of the index
arrays: row 0 fills the dry pores, row 1 the wet ones, the following rows are cores and coatings.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.grains import microfacet, spheroid
from splits.kernels.optics.source import Source

DRY_PORE = 0
WET_PORE = 1

NO_PARTICLES = -1
"""In place of a row of particles, for a layer of grains."""

NO_GROUND = -1
"""In place of the ground's column, where nothing below sends light back."""

NO_MAX_ORDER = 2**31 - 1
"""Grains met after which a ray is given up, where it may meet any number."""

MAX_REJECTIONS = 10_000_000
"""Grains refused in a row from which a ray counts as lost.  At grazing incidence the first grain
that fits below the boundary is rare: 3e5 are refused on average at 89.9999 degrees."""

WRONG_SIDE_LOBE = 0
"""A ray sent to the wrong side of the macroscopic surface leaves in a cosine lobe."""
WRONG_SIDE_MIRROR = 1
"""A ray sent to the wrong side of the macroscopic surface is mirrored in that surface."""

OVERLAP_KEEP = 0
"""A grain that does not fit is taken as it is."""
OVERLAP_REJECT = 1
"""A grain that does not fit is drawn again from the ray's origin, distance included."""
OVERLAP_SKIP = 2
"""A grain that does not fit is left out: the next distance counts from its place."""

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
    """Table of particle types; distributions are quantile functions (`rng.table_probabilities`).

    A table of distributions has one row per type, or a single row that holds for all of them.

    Attributes
    ----------
    n_shells : int64[types]
        Number of coatings plus one, the core.
    material : int64[types, deepest]
        Rows of the materials from the outermost coating to the core.
    coating_thickness : float64[types, deepest]
        Thickness of the coatings as a fraction of the major axis; unused for the core.
    curvature : float64[rows, m]
        Inverse semi-major axis of struck grains (1/m): the inverse, because it is what cross
        sections make uniform, and is exact in a table whatever the range of sizes.
    sphericity : float64[rows, m]
        Inscribed-circle sphericity of struck grains.
    facetness : float64[rows, m]
    """

    n_shells: np.ndarray
    material: np.ndarray
    coating_thickness: np.ndarray
    curvature: np.ndarray
    sphericity: np.ndarray
    facetness: np.ndarray


class GrainPopulation(NamedTuple):
    """What a medium is made of.

    Attributes
    ----------
    attenuation : float
        Expected number of grains met per metre of pore-space path, all types together.
    type_cdf : float64[types]
        Cumulative probability that the grain met is of type 0…i; the last entry is 1.
    types : GrainTypes
    """

    attenuation: float
    type_cdf: np.ndarray
    types: GrainTypes


class Layers(NamedTuple):
    """Media between extended horizontal faces, top first.

    Attributes
    ----------
    boundaries : float64[layers + 1]
        Heights of the faces (m), 0 at the top; where that is rough, a height above all of it.
    attenuation : float64[layers]
        Expected number of grains met per metre of pore-space path.
    saturation : float64[layers]
        Probability that a leg through the pore space runs in the wet medium.
    type_cdf : float64[layers, most]
        Cumulative probability that the grain met is of the layer's type 0…i.
    first_type : int64[layers]
        Row of the layer's first type.
    pore : int64[layers]
        Material of its dry pores; that of its wet ones follows, then those of others.
    pore_cdf : float64[layers, most]
        Cumulative probabilities, from the saturation on, that a leg runs in one of the other media.
    particle_row : int64[layers]
        Row of `ParticleScattering` of a layer that has these and no grains; `NO_PARTICLES` of others.
    """

    boundaries: np.ndarray
    attenuation: np.ndarray
    saturation: np.ndarray
    type_cdf: np.ndarray
    first_type: np.ndarray
    pore: np.ndarray
    pore_cdf: np.ndarray
    particle_row: np.ndarray


class ParticleScattering(NamedTuple):
    """Single scattering by the small particles of layers, see `splits.kernels.optics.phase_function`.

    Attributes
    ----------
    albedo : float64[rows]
        Single-scattering albedo.
    kind : int64[rows]
    g : float64[rows]
    table_size : int64[rows]
        Length of the table.
    cosines, density, cdf : float64[rows, longest]
    """

    albedo: np.ndarray
    kind: np.ndarray
    g: np.ndarray
    table_size: np.ndarray
    cosines: np.ndarray
    density: np.ndarray
    cdf: np.ndarray


class SamplingRules(NamedTuple):
    """Named readings of the papers as the numbers that kernels branch on (see `ENTRY_SAMPLING` etc.).

    `analog` turns absorption into a coin toss on every leg; otherwise path lengths are kept and
    turned into weights when the ray leaves.  `point_grains` makes grains point scatterers: a ray
    leaves a grain at the point at which it entered.
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
    """Light on layers of grains over a ground, and how the papers are read.

    Attributes
    ----------
    source : Source
    layers : Layers
    types : GrainTypes
    rules : SamplingRules
    particles : ParticleScattering
    ground_column : int
        Column among the materials' lengths where meetings with the ground are counted, whose
        "absorption" is −ln of its albedo; `NO_GROUND` where light leaves below.
    record_crossings : bool
        Whether rays that pass faces between layers are noted.
    """

    source: Source
    layers: Layers
    types: GrainTypes
    rules: SamplingRules
    particles: ParticleScattering
    ground_column: int
    record_crossings: bool


class Optics(NamedTuple):
    """Optical constants of the materials for one ensemble of paths.

    Attributes
    ----------
    n, k : float64[materials]
        Complex refractive index n + i k that decides reflection and refraction.
    absorption : float64[materials]
        Absorption coefficients (1/m).  An analog run tosses its coins with them; a weighted run
        takes them as lower bounds over the wavelengths it serves, for Russian roulette.
    is_absorbing : bool[materials]
        Whether a material absorbs at any of these wavelengths.
    """

    n: np.ndarray
    k: np.ndarray
    absorption: np.ndarray
    is_absorbing: np.ndarray


def make_bounding_optics(index: np.ndarray, absorption: np.ndarray) -> Optics:
    """Return what paths take that serve several wavelengths.

    Parameters
    ----------
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Roulette may only use what holds for every wavelength that listens.
    """
    absorbs = absorption.max(axis=0) > 0.0
    return Optics(index.real.copy(), index.imag.copy(), absorption.min(axis=0), absorbs)
