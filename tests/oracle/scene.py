"""What a kernel is told: plain numbers and arrays, in SI units.

These named tuples are the contract between media and kernels.  Materials are rows of the index
arrays: row 0 fills the dry pores, row 1 the wet ones, the following rows are cores and coatings.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oracle import facets, spheroid

DRY_PORE = 0
WET_PORE = 1

UNLIMITED = 2**31 - 1
"""Grains met after which a ray is given up, where it may meet any number."""

LOBE = 0
"""A ray sent to the wrong side of the macroscopic surface leaves in a cosine lobe."""
MIRRORED = 1
"""A ray sent to the wrong side of the macroscopic surface is mirrored in that surface."""

KEPT = 0
"""A grain that does not fit is taken as it is."""
REDRAWN = 1
"""A grain that does not fit is drawn again from the ray's origin, distance included."""
SKIPPED = 2
"""A grain that does not fit is left out: the next distance counts from its place."""

ENTRY = {"uniform": spheroid.UNIFORM, "projected": spheroid.PROJECTED}
FACETS = {"projected": facets.PROJECTED, "unweighted": facets.UNWEIGHTED, "any": facets.ANY}
WRONG_SIDE = {"cosine_lobe": LOBE, "mirror": MIRRORED}
FATE = {"reject": REDRAWN, "keep": KEPT, "skip": SKIPPED}


class Grains(NamedTuple):
    """Table of particle types; distributions are quantile functions (`rng.table_probabilities`).

    A table of distributions has one row per type, or a single row that holds for all of them.

    Attributes
    ----------
    attenuation : float
        Expected number of grains met per metre of pore-space path, all types together.
    share : float64[types]
        Cumulative probability that the grain met is of type 0…i; the last entry is 1.
    layers : int64[types]
        Number of coatings plus one, the core.
    material : int64[types, deepest]
        Rows of the materials from the outermost coating to the core.
    thickness : float64[types, deepest]
        Thickness of the coatings as a fraction of the major axis; unused for the core.
    curvature : float64[rows, m]
        Inverse semi-major axis of struck grains (1/m): the inverse, because it is what cross
        sections make uniform, and is exact in a table whatever the range of sizes.
    sphericity : float64[rows, m]
        Inscribed-circle sphericity of struck grains.
    facetness : float64[rows, m]
    """

    attenuation: float
    share: np.ndarray
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
        Probability that a leg through the pore space runs in the wet medium.
    cos_incidence : float
        Cosine of the angle of incidence, in (0, 1]; ignored under diffuse light.
    diffuse : bool
        Illumination of equal radiance from the whole hemisphere instead of a beam.
    """

    depth: float
    saturation: float
    cos_incidence: float
    diffuse: bool


class Rules(NamedTuple):
    """Named readings of the papers as the numbers that kernels branch on (see `ENTRY` etc.).

    `analog` turns absorption into a coin toss on every leg; otherwise path lengths are kept and
    turned into weights when the ray leaves.
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
        Complex refractive index n + i k that decides reflection and refraction.
    absorption : float64[materials]
        Absorption coefficients (1/m).  An analog run tosses its coins with them; a weighted run
        takes them as lower bounds over the wavelengths it serves, for Russian roulette.
    """

    n: np.ndarray
    k: np.ndarray
    absorption: np.ndarray


def shared_optics(index: np.ndarray, absorption: np.ndarray) -> Optics:
    """Return what paths take that serve several wavelengths.

    Parameters
    ----------
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Roulette may only use what holds for every wavelength that listens.
    """
    return Optics(index.real.copy(), index.imag.copy(), absorption.min(axis=0))
