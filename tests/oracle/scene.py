"""Input of the kernel: plain numbers and arrays, in SI units.

These named tuples are the contract between media and kernels.  Materials are rows of the index
arrays: row 0 fills dry pores, row 1 wet pores; the following rows are cores and coatings.
"""

from typing import NamedTuple

import numpy as np

from oracle import spheroid

DRY_PORE = 0
WET_PORE = 1

NO_MAX_ORDER = 2**31 - 1
"""Order of scattering at which rays are ended where there is no limit."""

LOBE = 0
"""A ray on the wrong side of the macroscopic surface leaves in a cosine lobe."""
MIRROR = 1
"""A ray on the wrong side of the macroscopic surface is mirrored in that surface."""

OVERLAP_KEEP = 0
"""Overlap of a sampled grain is ignored."""
OVERLAP_REJECT = 1
"""A grain that overlaps is sampled again from the ray's origin, distance included."""
OVERLAP_SKIP = 2
"""A grain that overlaps is skipped: the next distance counts from its position."""

ENTRY_SAMPLING = {"uniform": spheroid.UNIFORM, "projected": spheroid.PROJECTED}


class Grains(NamedTuple):
    """Table of particle types; distributions are quantile functions (`rng.table_probabilities`).

    A table of distributions has one row per type, or a single row for all of them.

    Attributes
    ----------
    attenuation : float
        Expected number of collisions per metre of path through the pore space, over all types.
    type_cdf : float64[types]
        Cumulative probability that the grain hit is of type 0…i; the last entry is 1.
    layers : int64[types]
        Number of coatings plus one, the core.
    material : int64[types, deepest]
        Rows of the materials from the outermost coating to the core.
    thickness : float64[types, deepest]
        Thickness of the coatings as a fraction of the major axis; unused for the core.
    curvature : float64[rows, m]
        Inverse semi-major axis of the grains hit (1/m).  Weighted by cross section, the inverse is
        uniform, and hence exact in a table for any range of sizes.
    sphericity : float64[rows, m]
        Inscribed-circle sphericity of the grains hit.
    facetness : float64[rows, m]
    """

    attenuation: float
    type_cdf: np.ndarray
    layers: np.ndarray
    material: np.ndarray
    thickness: np.ndarray
    curvature: np.ndarray
    sphericity: np.ndarray
    facetness: np.ndarray


class Slab(NamedTuple):
    """The sample between its extended boundaries z = 0 and z = −depth, and its illumination.

    Attributes
    ----------
    depth : float
        Metres.
    saturation : float
        Probability that a segment through the pore space is in the wet medium.
    cos_incidence : float
        Cosine of the angle of incidence, in (0, 1]; ignored under diffuse light.
    diffuse : bool
        Illumination of equal radiance from the whole hemisphere instead of a collimated beam.
    """

    depth: float
    saturation: float
    cos_incidence: float
    diffuse: bool


class Rules(NamedTuple):
    """Interpretation of the papers as integers that kernels branch on (`ENTRY_SAMPLING` etc.).

    `analog` samples absorption on every segment; otherwise path lengths are kept and turned into
    weights when the ray leaves.
    """

    entry_sampling: int
    facet_sampling: int
    wrong_side: int
    boundary_fresnel: bool
    segment_overlap: int
    boundary_overlap: int
    analog: bool


class Optics(NamedTuple):
    """Optical constants of the materials for one ensemble of paths.

    Attributes
    ----------
    n, k : float64[materials]
        Complex refractive index n + i k of reflection and refraction.
    absorption : float64[materials]
        Absorption coefficients (1/m).  An analog run samples absorption with them; a weighted run
        uses them as lower bounds over the wavelengths served, for Russian roulette.
    """

    n: np.ndarray
    k: np.ndarray
    absorption: np.ndarray


def make_bounding_optics(index: np.ndarray, absorption: np.ndarray) -> Optics:
    """Return the optics of paths that serve several wavelengths.

    Parameters
    ----------
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Roulette uses the minimum over the wavelengths served.
    """
    return Optics(index.real.copy(), index.imag.copy(), absorption.min(axis=0))
