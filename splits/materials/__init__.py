"""What matter is: complex refractive indices with range and source, and densities."""

from splits.materials.density import ice_density
from splits.materials.refractive_index import (
    Constant,
    RefractiveIndex,
    Tabulated,
    dataset_names,
    refractive_index,
)

__all__ = [
    "Constant",
    "RefractiveIndex",
    "Tabulated",
    "dataset_names",
    "ice_density",
    "refractive_index",
]
