"""Grains of a medium: size, shape and materials of the grains that a ray hits."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class GrainTypes(NamedTuple):
    """Grain types; distributions are quantile functions (`rng.make_table_probabilities`).

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
